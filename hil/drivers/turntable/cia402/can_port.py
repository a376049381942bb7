"""A CAN bus of python-can with this package's errors, the same for drivers and emulators."""

from __future__ import annotations

import select
from typing import Protocol

import can

from hil.core.clock import BenchClock
from hil.drivers.turntable.cia402.serial_can import Frame, SerialCan
from hil.errors import LinkLost, ProtocolError


class CanLine(Protocol):
    """Settings of a CAN bus: interface of python-can, channel, bit rate, baud rate of a serial adapter."""

    @property
    def interface(self) -> str: ...

    @property
    def channel(self) -> str | None: ...

    @property
    def bitrate(self) -> int: ...

    @property
    def baud(self) -> int: ...


class CanPort:
    """One node on a bus. Frames have 11-bit identifiers and at most eight bytes.

    python-can's ``serial`` framing is decoded here, with resynchronisation after damaged bytes. Raises LinkLost if
    the bus is gone, ProtocolError for an error of the interface; both name ``device``.
    """

    def __init__(self, device: str, config: CanLine, clock: BenchClock) -> None:
        self.device = device
        self._serial: SerialCan | None = None
        self._bus: can.BusABC | None = None
        self._descriptor = -1
        try:
            if config.interface == "serial":
                self._serial = SerialCan(str(config.channel), config.baud, clock)
            else:
                self._bus = can.Bus(channel=config.channel, interface=config.interface, bitrate=config.bitrate)
        except (can.CanError, OSError, TypeError, ValueError) as error:
            raise LinkLost(device, f"cannot open CAN {config.interface} {config.channel}: {error}") from error
        if self._bus is not None:
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
                    self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        except (can.CanError, OSError) as error:
            raise LinkLost(self.device, f"CAN send failed: {error}") from error

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
