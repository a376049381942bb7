"""Serial ports in lock-step, whose bytes are counted."""

from __future__ import annotations

from typing import Any, Final

import serial

from hil.parts.emulation.lock_step import LockStepClock, LockStepWire

_DRIVER: Final = 1


class CountedSerial(serial.Serial):  # type: ignore[misc]
    """A serial port in lock-step. wires: of an event loop, by descriptor, in which the port is entered."""

    def __init__(
        self,
        clock: LockStepClock,
        port: str | None = None,
        baudrate: int = 9600,
        wires: dict[int, LockStepWire] | None = None,
        **settings: Any,
    ) -> None:
        self.wire: LockStepWire | None = None
        self._clock = clock
        self._wires = {} if wires is None else wires
        super().__init__(port, baudrate, **settings)

    def open(self) -> None:
        super().open()
        wire = self._clock.wire(str(self.port), _DRIVER)
        while wire.pending > 0:
            wire.read(self.fileno(), wire.pending)
        self.wire = self._wires[self.fileno()] = wire

    def _reset_input_buffer(self) -> None:
        """Do nothing: what the kernel discards would not be counted."""

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
        """Write at once: pyserial's time-out, of the wall clock, also ends a write that a pause has delayed."""
        assert self.wire is not None
        return self.wire.write(self.fileno(), bytes(data))

    def wait_readable(self, wall_s: float) -> bool:
        """Wait at most ``wall_s`` until there is something to read; return whether there is."""
        return self.wire is not None and self.wire.wait(self.fileno(), wall_s)

    def close(self) -> None:
        if self.wire is not None:
            self.wire.close()
            self._wires.pop(self.fileno(), None)
            self.wire = None
        super().close()
