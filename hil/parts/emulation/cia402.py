"""Emulator of up to six CiA 402 drives on one CAN bus: python-can's serial framing over a pty, or a bus of python-can.

Faults of the wire apply to frames that the drives send. On the serial wire damaged bytes arrive; on a real bus the CAN
controller's checksum would reject the frame, so it is lost. A dead wire transfers nothing in either direction.
"""

from __future__ import annotations

import math
import threading
from typing import Any, Protocol

import numpy as np

from hil.config.rig import Cia402, RotaryAxes
from hil.core.clock import BenchClock
from hil.drivers.can_port import CanPort, Frame, SerialFrames, encode_serial
from hil.drivers.checksums import crc16_ccitt
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.units import Units
from hil.errors import BadInput
from hil.parts.emulation.cia402_drive import EmulatedCia402Drive
from hil.parts.emulation.cia402_modes import DriveAxis
from hil.parts.emulation.cia402_objects import ObjectDictionary
from hil.parts.emulation.emulated_axes import STEP_S, WATCHDOG_S, EmulatedAxes
from hil.parts.emulation.fault_injection import Faults, FaultyChannel
from hil.parts.emulation.pty_line import PtyLine
from hil.parts.emulation.shared_state import SharedAxisState

_ALONE_AFTER_S = 1.0


class ForeignNode:
    """Node of others on the bus, in operation. touched: frames of the bench that it has acted on."""

    def __init__(self, node_id: int) -> None:
        self.node_id = node_id
        self.touched = 0

    def on_frame(self, identifier: int, data: bytes) -> list[Frame]:
        """Receive one frame of the bus; return the answer: a PDO to each SYNC."""
        is_command = identifier == codec.NMT_ID and len(data) == 2 and data[1] in (0, self.node_id)
        is_own = identifier & 0x7F == self.node_id and identifier & 0x780 in (codec.RPDO1_ID, codec.SDO_REQUEST_ID)
        self.touched += is_command or is_own or identifier == codec.SYNC_ID
        return [(codec.TPDO1_ID + self.node_id, bytes(8))] if identifier == codec.SYNC_ID else []


class Station(Protocol):
    """One end of the bus. ``address``: channel in the driver's configuration."""

    address: str

    def receive(self, timeout_s: float) -> list[Frame]:
        """Return the frames received within ``timeout_s`` of bench time."""

    def send(self, frames: list[Frame]) -> None:
        """Send frames, and delayed ones that are due."""

    def close(self) -> None:
        """Leave the bus."""


class SerialStation:
    """A node on a pty with ``bytes_per_s`` of bench time, in both directions."""

    def __init__(
        self, bytes_per_s: float, latency_s: float, clock: BenchClock, faults: Faults, generator: np.random.Generator
    ) -> None:
        self._faults = faults
        self._channel = FaultyChannel(faults, generator)
        self._line = PtyLine(round(10.0 * bytes_per_s), clock, latency_s)
        self.address = self._line.path
        self._frames = SerialFrames(takes_remote=True)
        self._clock = clock
        self._received_s = -_ALONE_AFTER_S

    def receive(self, timeout_s: float) -> list[Frame]:
        data = self._line.read(max(0.0, timeout_s))
        if not data or self._faults.value("link_down") is not None:
            return []
        self._received_s = self._clock.now_s()
        return self._frames.feed(data)

    def send(self, frames: list[Frame]) -> None:
        """Send frames; without another node on the bus none is sent, as without acknowledgement."""
        now_s = self._clock.now_s()
        if now_s - self._received_s < _ALONE_AFTER_S:
            for frame in frames:
                self._channel.put(encode_serial(frame), now_s)
        if arrived := self._channel.due(now_s):
            self._line.write(b"".join(arrived))

    def close(self) -> None:
        self._line.close()


class BusStation:
    """A node on any bus of python-can."""

    def __init__(self, config: Cia402, clock: BenchClock, faults: Faults, generator: np.random.Generator) -> None:
        self._faults = faults
        self._channel = FaultyChannel(faults, generator)
        self._port = CanPort("turntable", config, clock)
        self.address = str(config.channel)
        self._clock = clock

    def receive(self, timeout_s: float) -> list[Frame]:
        frame = self._port.receive(max(0.0, self._clock.wall_s(timeout_s)))
        return [] if frame is None or self._faults.value("link_down") is not None else [frame]

    def send(self, frames: list[Frame]) -> None:
        now_s = self._clock.now_s()
        for frame in frames:
            packet = encode_serial(frame)
            self._channel.put(packet + crc16_ccitt(packet).to_bytes(2, "big"), now_s)
        for packet in self._channel.due(now_s):
            if crc16_ccitt(packet[:-2]).to_bytes(2, "big") == packet[-2:]:
                self._port.send(*SerialFrames().feed(packet[:-2]))

    def close(self) -> None:
        self._port.close()


BUS_BYTES_PER_S = 150e3
"""A frame of 8 data bytes is 19 bytes in python-can's serial framing and about 125 us at 1 Mbit/s."""


class Cia402Emulator:
    """Drives of the axes on ``config.cia402.node_ids``."""

    def __init__(
        self, config: RotaryAxes, clock: BenchClock, shared: SharedAxisState, name: str = "turntable", **axes: Any
    ) -> None:
        if config.cia402 is None:
            raise BadInput.single("rig", "turntable.cia402", "is missing")
        self._clock = clock
        self.gimbals = EmulatedAxes(name, config, clock, shared, **axes)
        self.faults = self.gimbals.faults
        self.drives = []
        for index, node_id in enumerate(config.ids_of(config.cia402.node_ids)):
            objects = ObjectDictionary(config.cia402, node_id, round(1000.0 * WATCHDOG_S))
            units = Units(config.cia402.counts_per_turn / math.tau, objects.velocity)
            axis = DriveAxis(self.gimbals, index, units, clock)
            self.drives.append(EmulatedCia402Drive(node_id, axis, objects))
        self.foreign_nodes = [ForeignNode(node_id) for node_id in config.cia402.emulated.foreign_nodes]
        noise = self.gimbals.wire_noise
        self._station: Station
        if config.cia402.interface == "serial":
            self._station = SerialStation(BUS_BYTES_PER_S, config.cia402.adapter_latency_s, clock, self.faults, noise)
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
            station.send(self.answers(received, stepped_s))

    def answers(self, received: list[Frame], now_s: float) -> list[Frame]:
        """Advance to ``now_s`` and take the received frames; return those of the drives."""
        self.gimbals.advance(now_s)
        frames = self._housekeep(now_s)
        for frame in received:
            frames += [answer for drive in self.drives for answer in drive.on_frame(*frame, now_s)]
            frames += [answer for node in self.foreign_nodes for answer in node.on_frame(*frame)]
        return frames

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
