"""Three emulated CiA 402 drives on one CAN bus: python-can's serial framing over a pty, or any other bus."""

from __future__ import annotations

import threading
from collections import deque

from hil.clock import WallClock
from hil.config.rig import Turntable
from hil.drivers.board import AxisBoard
from hil.drivers.lines import PtyBridge
from hil.drivers.turntable import cia402_codec as codec
from hil.drivers.turntable.can_port import CanPort
from hil.drivers.turntable.cia402_drive import EmulatedDrive, Frame
from hil.drivers.turntable.emulated import STEP_S, WATCHDOG_S, EmulatedGimbals
from hil.errors import BadInput

BUS_BYTES_PER_S = 150e3
"""A frame of 8 data bytes is 19 bytes in python-can's serial framing and about 125 us at 1 Mbit/s."""


class _Axis:
    """One gimbal as its drive sees it: counts."""

    def __init__(self, gimbals: EmulatedGimbals, axis: int, counts_per_turn: int, clock: WallClock) -> None:
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
        self.gimbals = EmulatedGimbals(config, clock, board)
        self.drives = []
        for index, node_id in enumerate(config.cia402.node_ids):
            axis = _Axis(self.gimbals, index, config.cia402.counts_per_turn, clock)
            self.drives.append(EmulatedDrive(node_id, axis, WATCHDOG_S))
        self._bridge: PtyBridge | None = None
        self._port: CanPort | None = None
        self._faults: deque[tuple[int, int]] = deque()

    def start(self) -> dict[str, str]:
        """Join the bus; return the controller's address of it."""
        config = self._config
        if config.interface == "serial":
            self._bridge = PtyBridge(BUS_BYTES_PER_S, self._clock)
            config = config.model_copy(update={"channel": self._bridge.device_path})
        self._port = CanPort("turntable", config)
        self._send([frame for drive in self.drives for frame in drive.boot()])
        return {"turntable": self._bridge.path if self._bridge else str(config.channel)}

    def fail_axis(self, axis: int, code: int) -> None:
        """Let the drive of ``axis`` (0 to 2) report the fault ``code`` of object 0x603F. For any thread."""
        self._faults.append((axis, code))

    def run(self, stop: threading.Event) -> None:
        """Serve the bus until ``stop`` is set."""
        if self._port is None:
            raise RuntimeError("start the emulator first")
        stepped_s = self._clock.now_s()
        while not stop.is_set():
            left_s = stepped_s + STEP_S - self._clock.now_s()
            frame = self._port.receive(max(0.0, self._clock.wall_s(left_s)))
            now_s = self._clock.now_s()
            if frame is None or frame[0] == codec.SYNC_ID or now_s - stepped_s >= STEP_S:
                self.gimbals.advance(now_s)
                stepped_s = now_s
            if frame is not None:
                for drive in self.drives:
                    self._send(drive.on_frame(*frame, now_s))
            self._housekeep(now_s)

    def close(self) -> None:
        """Leave the bus."""
        if self._port is not None:
            self._port.close()
        if self._bridge is not None:
            self._bridge.close()
        self._port = self._bridge = None

    def _housekeep(self, now_s: float) -> None:
        while self._faults:
            axis, code = self._faults.popleft()
            self._send(self.drives[axis].fail(code))
        for axis, drive in enumerate(self.drives):
            if self.gimbals.overdue[axis]:
                self.gimbals.overdue[axis] = False
                self._send(drive.overdue())
            self._send(drive.status(now_s))

    def _send(self, frames: list[Frame]) -> None:
        for frame in frames:
            assert self._port is not None
            self._port.send(*frame)
