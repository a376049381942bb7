"""Emulator of up to six CiA 402 drives on one CAN bus: python-can's serial framing over a pty, or any other bus."""

from __future__ import annotations

import threading

from hil.config.rig import RotaryAxes
from hil.core.clock import BenchClock
from hil.drivers.emulated_axes import STEP_S, WATCHDOG_S, EmulatedAxes, ReadChain
from hil.drivers.shared_state import SharedAxisState
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.drive import EmulatedCia402Drive
from hil.drivers.turntable.cia402.emulated_bus import BusStation, SerialStation, Station
from hil.drivers.turntable.cia402.modes import DriveAxis
from hil.drivers.turntable.cia402.serial_can import Frame
from hil.errors import BadInput
from hil.maths.random_streams import stream

BUS_BYTES_PER_S = 150e3
"""A frame of 8 data bytes is 19 bytes in python-can's serial framing and about 125 us at 1 Mbit/s."""


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
        self._clock = clock
        self.gimbals = EmulatedAxes(name, config, clock, shared, chain=chain, seed=seed)
        self.faults = self.gimbals.faults
        self.drives = []
        for index, number in enumerate(config.axis_numbers):
            axis = DriveAxis(self.gimbals, index, config.cia402.counts_per_turn, clock)
            self.drives.append(EmulatedCia402Drive(config.cia402.node_ids[number], axis, WATCHDOG_S))
        noise = stream(seed, "wire")
        self._station: Station
        if config.cia402.interface == "serial":
            self._station = SerialStation(BUS_BYTES_PER_S, clock, self.faults, noise)
        else:
            self._station = BusStation(config.cia402, clock, self.faults, noise)

    def start(self) -> dict[str, str]:
        """Announce the drives on the bus; return its address."""
        self._station.send([frame for drive in self.drives for frame in drive.boot()])
        return {self.faults.device: self._station.address}

    def run(self, stop: threading.Event) -> None:
        """Serve the bus until ``stop`` is set."""
        station = self._station
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
        self._station.close()

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
