"""Emulator of up to three CiA 402 drives on one CAN bus: python-can's serial framing over a pty, or any other bus."""

from __future__ import annotations

import threading

from hil.config.rig import RotaryAxes
from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.emulated_axes import STEP_S, WATCHDOG_S, EmulatedAxes, ReadChain
from hil.drivers.shared_state import SharedAxisState
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.drive import EmulatedCia402Drive
from hil.drivers.turntable.cia402.emulated_bus import BusStation, SerialStation, Station
from hil.drivers.turntable.cia402.serial_can import Frame
from hil.errors import BadInput
from hil.maths.random_streams import stream

BUS_BYTES_PER_S = 150e3
"""A frame of 8 data bytes is 19 bytes in python-can's serial framing and about 125 us at 1 Mbit/s."""


class _Axis:
    """One gimbal as its drive sees it: counts."""

    def __init__(self, gimbals: EmulatedAxes, axis: int, counts_per_turn: int, clock: BenchClock) -> None:
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

    def enable(self) -> None:
        self._gimbals.enable(self._axis)

    def disable(self) -> None:
        self._gimbals.disable(self._axis)

    def home(self) -> None:
        self._gimbals.home(self._axis)

    def homing(self) -> Homing:
        return self._gimbals.homing[self._axis]

    def moving(self) -> bool:
        return self._gimbals.moving(self._axis)

    def limit(self) -> int:
        return self._gimbals.limit[self._axis]

    def torque_off(self) -> bool:
        return self._gimbals.torque_off

    def astray(self) -> bool:
        return self._gimbals.astray[self._axis]

    def clear_astray(self) -> None:
        self._gimbals.astray[self._axis] = False

    def window(self) -> tuple[int, int]:
        window, time_s = self._gimbals.window[self._axis], self._gimbals.window_s[self._axis]
        return codec.counts_from_rad(window, self._scale), round(1e3 * time_s)

    def set_window(self, counts: float, time_out_ms: int) -> None:
        self._gimbals.window[self._axis] = counts * codec.rad_from_counts(1, self._scale)
        self._gimbals.window_s[self._axis] = 1e-3 * time_out_ms


class Cia402Emulator:
    """Drives of the axes on ``config.cia402.node_ids``."""

    def __init__(
        self,
        config: RotaryAxes,
        clock: BenchClock,
        shared: SharedAxisState,
        chain: ReadChain | None = None,
        seed: int = 0,
        name: str = "turntable",
    ) -> None:
        if config.cia402 is None:
            raise BadInput.single("rig", "turntable.cia402", "is missing")
        self._config = config.cia402
        self._clock = clock
        self.gimbals = EmulatedAxes(name, config, clock, shared, chain=chain, seed=seed)
        self.faults = self.gimbals.faults
        self.drives = []
        for index, number in enumerate(config.axis_numbers):
            axis = _Axis(self.gimbals, index, config.cia402.counts_per_turn, clock)
            self.drives.append(EmulatedCia402Drive(config.cia402.node_ids[number], axis, WATCHDOG_S))
        self._wire_noise = stream(seed, "wire")
        self._station: Station | None = None

    def start(self) -> dict[str, str]:
        """Join the bus; return its address."""
        if self._config.interface == "serial":
            self._station = SerialStation(BUS_BYTES_PER_S, self._clock, self.faults, self._wire_noise)
        else:
            self._station = BusStation(self._config, self._clock, self.faults, self._wire_noise)
        self._station.send([frame for drive in self.drives for frame in drive.boot()])
        return {self.faults.device: self._station.address}

    def run(self, stop: threading.Event) -> None:
        """Serve the bus until ``stop`` is set."""
        station = self._station
        if station is None:
            raise RuntimeError("start the emulator first")
        stepped_s, step_s = self._clock.now_s(), self._clock.paced_s(STEP_S)
        while not stop.is_set():
            received = station.receive(stepped_s + step_s - self._clock.now_s())
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
        for axis, (name, drive) in enumerate(zip(self.gimbals.names, self.drives, strict=True)):
            code = self.faults.pop("drive_fault", name)
            if code is not None:
                frames += drive.fail(round(code) or codec.OVER_CURRENT)
            if self.gimbals.overdue[axis]:
                self.gimbals.overdue[axis] = False
                frames += drive.overdue()
            frames += drive.advance(now_s)
        return frames
