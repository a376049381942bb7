"""A CAN bus of python-can with this package's errors, the same for drivers and emulators."""

from __future__ import annotations

import select
import struct

import can

from hil.config.rig import Cia402
from hil.errors import DeviceError, LinkLost, ProtocolError

_FRAME_WALL_S = 0.02  # python-can's serial interface: longest gap inside one frame


class CanPort:
    """One station on a bus. Frames have 11-bit identifiers and at most eight bytes.

    Raises LinkLost when the bus is gone, ProtocolError for broken framing; both name ``device``.
    """

    def __init__(self, device: str, config: Cia402) -> None:
        self.device = device
        options = {"timeout": _FRAME_WALL_S, "baudrate": config.baud} if config.interface == "serial" else {}
        try:
            self.bus = can.Bus(
                channel=config.channel,
                interface=config.interface,
                bitrate=config.bitrate,
                **options,  # type: ignore[arg-type]
            )
        except (can.CanError, OSError, TypeError, ValueError) as error:
            raise LinkLost(device, f"cannot open CAN {config.interface} {config.channel}: {error}") from error
        try:
            self._descriptor = self.bus.fileno()
        except NotImplementedError:
            self._descriptor = -1

    def send(self, identifier: int, data: bytes) -> None:
        """Put one frame on the bus."""
        try:
            self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        except (can.CanError, OSError) as error:
            raise LinkLost(self.device, f"CAN send failed: {error}") from error

    def receive(self, wall_s: float) -> tuple[int, bytes] | None:
        """Return identifier and data of the next frame, None if none came within ``wall_s``."""
        try:
            if self._descriptor < 0:
                message = self.bus.recv(wall_s)
            elif select.select([self._descriptor], [], [], wall_s)[0]:
                # the serial interface ignores recv's own time-out: ask only once bytes are there
                message = self.bus.recv(0.0)
            else:
                return None
        except (can.CanError, OSError, TypeError, ValueError, struct.error) as error:
            raise self._failure(error) from error
        if message is None or message.is_error_frame or message.is_remote_frame or message.is_extended_id:
            return None
        return message.arbitration_id, bytes(message.data)

    def close(self) -> None:
        """Leave the bus. Idempotent."""
        self._descriptor = -1
        self.bus.shutdown()

    def _failure(self, error: Exception) -> DeviceError:
        """Tell a lost wire from broken framing: python-can's serial interface uses one class for both."""
        if isinstance(error, OSError) or isinstance(error.__cause__, OSError):
            return LinkLost(self.device, f"CAN receive failed: {error.__cause__ or error}")
        return ProtocolError(self.device, f"broken CAN frame: {error}")
