"""Three emulated CiA 402 drives on one CAN bus: python-can's serial framing over a pty, or any other bus."""

from __future__ import annotations

import threading
from collections import deque

from hil.clock import WallClock
from hil.config.rig import Turntable
from hil.drivers.board import AxisBoard
from hil.drivers.emulated_axes import STEP_S, WATCHDOG_S, EmulatedAxes
from hil.drivers.turntable import cia402_codec as codec
from hil.drivers.turntable.cia402_drive import EmulatedDrive
from hil.drivers.turntable.emulated_bus import BusStation, Frame, SerialStation, Station
from hil.errors import BadInput

BUS_BYTES_PER_S = 150e3
"""A frame of 8 data bytes is 19 bytes in python-can's serial framing and about 125 us at 1 Mbit/s."""


class _Axis:
    """One gimbal as its drive sees it: counts."""

    def __init__(self, gimbals: EmulatedAxes, axis: int, counts_per_turn: int, clock: WallClock) -> None:
        self._gimbals = gimbals
        self._axis = axis
        self._scale = counts_per_turn
        self._clock = clock

    def feedback(self) -> tuple[int, int]:
        position, rate = self._gimbals.position[self._axis], self._gimbals.rate[self._axis]
        return codec.counts_from_rad(position, self._scale), codec.counts_from_rad(rate, self._scale)

    def follow(self, target: int, velocity_offset: int, watchdog_s: float) -> None:
        position = codec.rad_from_counts(target, self._scale)
        rate = codec.rad_from_counts(velocity_offset, self._scale)
        self._gimbals.follow(self._axis, position, rate, self._clock.now_s(), watchdog_s)

    def brake(self) -> None:
        self._gimbals.brake(self._axis)


class Cia402Emulator:
    """Drives of roll, pitch, yaw on ``config.cia402.node_ids``; serve them with ``run`` in a process of their own."""

    def __init__(self, config: Turntable, clock: WallClock, board: AxisBoard) -> None:
        if config.cia402 is None:
            raise BadInput.single("rig", "turntable.cia402", "is missing")
        self._config = config.cia402
        self._clock = clock
        self.gimbals = EmulatedAxes("turntable", config, clock, board)
        self.faults = self.gimbals.faults
        self.drives = []
        for index, node_id in enumerate(config.cia402.node_ids):
            axis = _Axis(self.gimbals, index, config.cia402.counts_per_turn, clock)
            self.drives.append(EmulatedDrive(node_id, axis, WATCHDOG_S))
        self._station: Station | None = None
        self._faults: deque[tuple[int, int]] = deque()

    def start(self) -> dict[str, str]:
        """Join the bus; return the controller's address of it."""
        if self._config.interface == "serial":
            self._station = SerialStation(BUS_BYTES_PER_S, self._clock)
        else:
            self._station = BusStation(self._config, self._clock)
        self._station.send([frame for drive in self.drives for frame in drive.boot()])
        return {"turntable": self._station.address}

    def fail_axis(self, axis: int, code: int) -> None:
        """Let the drive of ``axis`` (0 to 2) report the fault ``code`` of object 0x603F. For any thread."""
        self._faults.append((axis, code))

    def run(self, stop: threading.Event) -> None:
        """Serve the bus until ``stop`` is set."""
        station = self._station
        if station is None:
            raise RuntimeError("start the emulator first")
        stepped_s = self._clock.now_s()
        while not stop.is_set():
            received = station.receive(stepped_s + STEP_S - self._clock.now_s())
            stepped_s = self._clock.now_s()
            self.gimbals.advance(stepped_s)
            frames = self._housekeep(stepped_s)
            for frame in received:
                frames += [answer for drive in self.drives for answer in drive.on_frame(*frame, stepped_s)]
            station.send(frames)

    def close(self) -> None:
        """Leave the bus."""
        if self._station is not None:
            self._station.close()
        self._station = None

    def _housekeep(self, now_s: float) -> list[Frame]:
        frames: list[Frame] = []
        while self._faults:
            axis, code = self._faults.popleft()
            frames += self.drives[axis].fail(code)
        for axis, drive in enumerate(self.drives):
            if self.gimbals.overdue[axis]:
                self.gimbals.overdue[axis] = False
                frames += drive.overdue()
            frames += drive.status(now_s)
        return frames
