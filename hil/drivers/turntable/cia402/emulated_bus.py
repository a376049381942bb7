"""CAN bus of the emulated drives: python-can's serial framing on a pty with line timing, or a bus of python-can.

Faults of the wire apply to frames that the drives send. On the serial wire damaged bytes arrive; on a real bus the CAN
controller's checksum would reject the frame, so it is lost. A dead wire transfers nothing in either direction.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hil.config.rig import Cia402
from hil.core.clock import BenchClock
from hil.drivers.checksums import crc16_ccitt
from hil.drivers.fault_injection import Faults, FaultyChannel
from hil.drivers.pty_line import PtyLine
from hil.drivers.turntable.cia402.can_port import CanPort
from hil.drivers.turntable.cia402.serial_can import Frame, SerialFrames, encode_serial

_ALONE_AFTER_S = 1.0


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

    def __init__(self, bytes_per_s: float, clock: BenchClock, faults: Faults, generator: np.random.Generator) -> None:
        self._faults = faults
        self._channel = FaultyChannel(faults, generator)
        self._line = PtyLine(round(10.0 * bytes_per_s), clock)
        self.address = self._line.path
        self._frames = SerialFrames()
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
