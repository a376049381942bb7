"""Serial ports of the drivers: pyserial's, whose bytes are counted on a bench in lock-step."""

from __future__ import annotations

import select
from typing import Any, Final

import serial

from hil.core.clock import BenchClock
from hil.core.lock_step import LockStepClock, LockStepWire

_DRIVER: Final = 1


def open_serial(clock: BenchClock, path: str, baud: int, **settings: Any) -> serial.Serial:
    """Return the serial port ``path``, open, without the bytes that were received before.

    settings: further arguments of pyserial; its time-outs are wall time, bench time in lock-step. Raises OSError,
    ValueError or termios.error.
    """
    if isinstance(clock, LockStepClock):
        return _CountedSerial(clock, path, baud, **settings)
    port = serial.Serial(path, baud, **settings)
    port.reset_input_buffer()
    return port


class _CountedSerial(serial.Serial):  # type: ignore[misc]
    """A serial port in lock-step."""

    def __init__(self, clock: LockStepClock, path: str, baud: int, **settings: Any) -> None:
        self.wire: LockStepWire | None = None
        super().__init__(path, baud, **settings)
        self.wire = clock.wire(path, _DRIVER)
        while self.wire.pending > 0:
            self.wire.read(self.fileno(), self.wire.pending)

    @property
    def in_waiting(self) -> int:
        return self.wire.pending if self.wire is not None else 0

    def read(self, size: int = 1) -> bytes:
        wire = self.wire
        if wire is None or not wire.wait(self.fileno(), self.timeout):
            return b""
        data = wire.read(self.fileno(), size)
        if not data:
            raise serial.SerialException("the device has gone")
        return data

    def write(self, data: Any) -> int:
        assert self.wire is not None
        sent = len(data)
        if self.wire.sending(sent):
            try:
                super().write(data)
            except BaseException:
                self.wire.sending(-sent)
                raise
        return sent

    def close(self) -> None:
        if self.wire is not None:
            self.wire.close()
            self.wire = None
        super().close()


def wait_readable(port: serial.Serial, wall_s: float) -> bool:
    """Wait at most ``wall_s`` until there is something to read; return whether there is."""
    if isinstance(port, _CountedSerial):
        return port.wire is not None and port.wire.wait(port.fileno(), wall_s)
    return bool(select.select([port.fileno()], [], [], wall_s)[0])
