"""A CAN bus of python-can with this package's errors, the same for drivers and emulators.

python-can's ``serial`` framing is decoded here. A frame (little-endian): 0xAA, time stamp u32, length u8, identifier
u32 (flags in bits 29 to 31), data, 0xBB. There is no checksum: the receiver bounds the effect of a damaged byte.
"""

from __future__ import annotations

import errno
import select
import struct
from collections import deque
from typing import Any, Protocol

import can

from hil.core.clock import BenchClock
from hil.drivers.serial_port import open_serial, set_low_latency, wait_readable
from hil.errors import LinkLost, ProtocolError

Frame = tuple[int, bytes]

_HEAD = struct.Struct("<BIBI")
_START = 0xAA
_END = 0xBB
_LONGEST_DATA = 8
_HIGHEST_IDENTIFIER = 0x7FF
_FLAGS = 0xE000_0000
REMOTE = 0x4000_0000
"""Flag of the identifier of a remote frame, which has no data."""
_WRITE_WALL_S = 0.3
_FULL_WALL_S = 0.02  # longest wait for room in the queue of an interface
_RETRY_WALL_S = 0.0005


def encode_serial(frame: Frame) -> bytes:
    """Return one frame, identifier and data, as bytes of the serial wire."""
    identifier, data = frame
    return _HEAD.pack(_START, 0, len(data), identifier) + data + bytes((_END,))


class SerialFrames:
    """Splits the bytes of the serial wire into frames; other bytes are skipped and counted.

    Frames with flags (extended, remote, error) are discarded, unless ``takes_remote``.
    """

    def __init__(self, takes_remote: bool = False) -> None:
        self._buffer = bytearray()
        self._discarded = _FLAGS & ~REMOTE if takes_remote else _FLAGS
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
                if not identifier & self._discarded:
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


class CanLine(Protocol):
    """Settings of a CAN bus: interface of python-can, channel, bit rate, baud rate of a serial adapter, arguments."""

    @property
    def interface(self) -> str: ...

    @property
    def channel(self) -> str | None: ...

    @property
    def bitrate(self) -> int: ...

    @property
    def baud(self) -> int: ...

    @property
    def arguments(self) -> dict[str, Any]: ...


class CanPort:
    """One node on a bus. Frames have 11-bit identifiers and at most eight bytes.

    python-can's ``serial`` framing is decoded here, with resynchronisation after damaged bytes. Raises LinkLost if
    the bus is gone, ProtocolError for an error of the interface; both name ``device``.
    """

    def __init__(self, device: str, config: CanLine, clock: BenchClock) -> None:
        self.device = device
        self._clock = clock
        self._serial: SerialCan | None = None
        self._bus: can.BusABC | None = None
        self._descriptor = -1
        try:
            if config.interface == "serial":
                self._serial = SerialCan(str(config.channel), config.baud, clock)
            else:
                more = {"tty_baudrate": config.baud} if config.interface == "slcan" else {}
                self._bus = can.Bus(
                    channel=config.channel,
                    interface=config.interface,
                    **{"bitrate": config.bitrate, **more, **config.arguments},
                )
        except (can.CanError, OSError, TypeError, ValueError) as error:
            raise LinkLost(device, f"cannot open CAN {config.interface} {config.channel}: {error}") from error
        if self._bus is not None:
            set_low_latency(getattr(self._bus, "serialPortOrig", None))  # of slcan
            try:
                self._descriptor = self._bus.fileno()
            except NotImplementedError:
                self._descriptor = -1

    @property
    def skipped_bytes(self) -> int:
        """Bytes of a serial wire that were part of no frame."""
        return self._serial.skipped_bytes if self._serial else 0

    def send(self, *frames: Frame) -> None:
        """Put frames, identifier and data, on the bus, one after the other."""
        try:
            if self._serial is not None:
                self._serial.send(*frames)
            elif self._bus is not None:
                for identifier, data in frames:
                    self._send(self._bus, identifier, data)
        except (can.CanError, OSError) as error:
            raise LinkLost(self.device, f"CAN send failed: {error}") from error

    def _send(self, bus: can.BusABC, identifier: int, data: bytes) -> None:
        """Send one frame; wait while the queue of the interface is full."""
        is_remote = bool(identifier & REMOTE)
        message = can.Message(
            arbitration_id=identifier & ~REMOTE,
            data=None if is_remote else data,
            dlc=1 if is_remote else None,
            is_extended_id=False,
            is_remote_frame=is_remote,
        )
        end_s = self._clock.host_s() + _FULL_WALL_S
        while True:
            try:
                bus.send(message)
            except (can.CanError, OSError) as error:
                if not _is_full(error) or self._clock.host_s() > end_s:
                    raise
                self._clock.sleep(_RETRY_WALL_S)
            else:
                return

    def receive(self, wall_s: float) -> tuple[int, bytes] | None:
        """Return identifier and data of the next frame, None if none was received within ``wall_s``."""
        try:
            if self._serial is not None:
                return self._serial.receive(wall_s)
            if self._bus is None:
                return None
            if self._descriptor >= 0 and not select.select([self._descriptor], [], [], wall_s)[0]:
                return None
            message = self._bus.recv(wall_s if self._descriptor < 0 else 0.0)
        except OSError as error:
            raise LinkLost(self.device, f"CAN receive failed: {error}") from error
        except (can.CanError, TypeError, ValueError) as error:
            if isinstance(error.__cause__, OSError):
                raise LinkLost(self.device, f"CAN receive failed: {error.__cause__}") from error
            raise ProtocolError(self.device, f"broken CAN frame: {error}") from error
        if message is None or message.is_error_frame or message.is_remote_frame or message.is_extended_id:
            return None
        return message.arbitration_id, bytes(message.data)

    def close(self) -> None:
        """Leave the bus. Idempotent."""
        self._descriptor = -1
        if self._serial is not None:
            self._serial.close()
        if self._bus is not None:
            self._bus.shutdown()


def _is_full(error: BaseException | None) -> bool:
    """Return whether the queue of an interface is full: Linux reports that as an error, not by its socket."""
    while error is not None:
        number = getattr(error, "errno", None) or getattr(error, "error_code", None)
        if number in (errno.ENOBUFS, errno.EAGAIN):
            return True
        error = error.__cause__
    return False
