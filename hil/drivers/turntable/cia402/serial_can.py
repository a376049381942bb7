"""python-can's ``serial`` framing of CAN on a serial wire.

A frame (little-endian): 0xAA, time stamp u32, length u8, identifier u32 (flags in bits 29 to 31), data,
0xBB. There is no checksum: the receiver of the data bounds the effect of a damaged byte.
"""

from __future__ import annotations

import struct
from collections import deque

from hil.core.clock import BenchClock
from hil.drivers.serial_port import open_serial, wait_readable

Frame = tuple[int, bytes]

_HEAD = struct.Struct("<BIBI")
_START = 0xAA
_END = 0xBB
_LONGEST_DATA = 8
_HIGHEST_IDENTIFIER = 0x7FF
_FLAGS = 0xE000_0000
_WRITE_WALL_S = 0.3


def encode_serial(frame: Frame) -> bytes:
    """Return one frame, identifier and data, as bytes of the serial wire."""
    identifier, data = frame
    return _HEAD.pack(_START, 0, len(data), identifier) + data + bytes((_END,))


class SerialFrames:
    """Splits the bytes of the serial wire into frames; other bytes are skipped and counted.

    Frames with flags (extended, remote, error) are discarded.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.skipped_bytes = 0

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that ``data`` completes."""
        self._buffer += data
        frames: list[Frame] = []
        buffer = self._buffer
        while len(buffer) > _HEAD.size:
            start, _, length, identifier = _HEAD.unpack_from(buffer)
            end = _HEAD.size + length
            is_head = start == _START and length <= _LONGEST_DATA
            is_head = is_head and (bool(identifier & _FLAGS) or identifier <= _HIGHEST_IDENTIFIER)
            if is_head and len(buffer) <= end:
                break
            if is_head and buffer[end] == _END:
                if not identifier & _FLAGS:
                    frames.append((identifier, bytes(buffer[_HEAD.size : end])))
                del buffer[: end + 1]
            else:
                del buffer[0]
                self.skipped_bytes += 1
        return frames


class SerialCan:
    """A CAN adapter on a serial port. Raises OSError (pyserial's errors are such) when the port is gone."""

    def __init__(self, path: str, baud: int, clock: BenchClock) -> None:
        self._port = open_serial(clock, path, baud, timeout=0.0, write_timeout=_WRITE_WALL_S, exclusive=True)
        self._cutter = SerialFrames()
        self._frames: deque[Frame] = deque()

    @property
    def skipped_bytes(self) -> int:
        return self._cutter.skipped_bytes

    def send(self, *frames: Frame) -> None:
        """Write frames, at once: each write wakes the other end of the line."""
        self._port.write(b"".join(map(encode_serial, frames)))

    def receive(self, wall_s: float) -> Frame | None:
        """Return the next frame, None if no bytes complete one within ``wall_s``."""
        if not self._frames and wait_readable(self._port, wall_s):
            self._frames.extend(self._cutter.feed(self._port.read(max(1, self._port.in_waiting))))
        return self._frames.popleft() if self._frames else None

    def close(self) -> None:
        """Close the port. Idempotent."""
        self._port.close()
