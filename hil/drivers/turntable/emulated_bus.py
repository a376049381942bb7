"""The emulated drives' end of a CAN bus: python-can's serial framing on a paced pty, or a bus of python-can.

A frame on the serial wire (python-can's ``serial`` interface, little-endian): 0xAA, time stamp u32,
length u8, identifier u32 (flags in bits 29 to 31), data, 0xBB.
"""

from __future__ import annotations

import struct
from typing import Protocol

from hil.clock import WallClock
from hil.config.rig import Cia402
from hil.drivers.lines import PtyLine
from hil.drivers.turntable.can_port import CanPort

Frame = tuple[int, bytes]

_HEAD = struct.Struct("<BIBI")
_START = 0xAA
_END = 0xBB
_LONGEST_DATA = 8
_ALONE_AFTER_S = 1.0


def encode_serial(frame: Frame) -> bytes:
    """Return one frame, identifier and data, as bytes of the serial wire."""
    identifier, data = frame
    return _HEAD.pack(_START, 0, len(data), identifier) + data + bytes((_END,))


class SerialFrames:
    """Cuts the bytes of the serial wire into frames; other bytes are skipped."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that ``data`` completes."""
        self._buffer += data
        frames: list[Frame] = []
        buffer = self._buffer
        while len(buffer) > _HEAD.size:
            start, _, length, identifier = _HEAD.unpack_from(buffer)
            end = _HEAD.size + length
            if start != _START or length > _LONGEST_DATA:
                del buffer[0]
            elif len(buffer) <= end:
                break
            elif buffer[end] != _END:
                del buffer[0]
            else:
                frames.append((identifier, bytes(buffer[_HEAD.size : end])))
                del buffer[: end + 1]
        return frames


class Station(Protocol):
    """One end of the bus. ``address`` is what the controller's configuration names as channel."""

    address: str

    def receive(self, timeout_s: float) -> list[Frame]:
        """Return what came within ``timeout_s`` of bench time."""

    def send(self, frames: list[Frame]) -> None:
        """Put frames on the bus."""

    def close(self) -> None:
        """Leave the bus."""


class SerialStation:
    """A station on a pty that takes ``bytes_per_s`` of bench time, both ways."""

    def __init__(self, bytes_per_s: float, clock: WallClock) -> None:
        self._line = PtyLine(round(10.0 * bytes_per_s), clock)
        self.address = self._line.path
        self._frames = SerialFrames()
        self._clock = clock
        self._heard_s = -_ALONE_AFTER_S

    def receive(self, timeout_s: float) -> list[Frame]:
        data = self._line.read(max(0.0, timeout_s))
        if not data:
            return []
        self._heard_s = self._clock.now_s()
        return self._frames.feed(data)

    def send(self, frames: list[Frame]) -> None:
        """Put frames on the wire; without another station nothing leaves, as on a bus nobody acknowledges."""
        if frames and self._clock.now_s() - self._heard_s < _ALONE_AFTER_S:
            self._line.write(b"".join(map(encode_serial, frames)))

    def close(self) -> None:
        self._line.close()


class BusStation:
    """A station on any bus of python-can."""

    def __init__(self, config: Cia402, clock: WallClock) -> None:
        self._port = CanPort("turntable", config)
        self.address = str(config.channel)
        self._clock = clock

    def receive(self, timeout_s: float) -> list[Frame]:
        frame = self._port.receive(max(0.0, self._clock.wall_s(timeout_s)))
        return [] if frame is None else [frame]

    def send(self, frames: list[Frame]) -> None:
        for identifier, data in frames:
            self._port.send(identifier, data)

    def close(self) -> None:
        self._port.close()
