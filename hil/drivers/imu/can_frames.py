"""Frames of an IMU on a CAN bus: the data of several messages, after the identifier of the first one."""

from __future__ import annotations

import math

from hil.config.tables.wires import ImuCan
from hil.core.clock import BenchClock
from hil.drivers.can_port import CanPort, encode_serial
from hil.drivers.wire_reader import READ_WALL_S


class CanFrames:
    """A CAN bus with the interface of a serial port as readers use it. Raises LinkLost if it cannot be opened."""

    in_waiting = 0

    def __init__(self, config: ImuCan, clock: BenchClock) -> None:
        self.port = f"CAN {config.interface} {config.channel}"
        self._bus, self._config = CanPort("imu", config, clock), config
        self._data: list[bytes] = []

    def read(self, _size: int = 0) -> bytes:
        """Return the next frame, whole, b"" if no message has completed one in time.

        A frame of which a message is missing is dropped. Raises LinkLost and ProtocolError.
        """
        identifiers = self._config.identifiers
        if (message := self._bus.receive(READ_WALL_S)) is None:
            return b""
        identifier, data = message
        if identifier == identifiers[0]:
            self._data = []
        elif identifier not in identifiers:
            return b""
        if identifier != identifiers[len(self._data)]:
            self._data = []
            return b""
        self._data.append(data)
        if len(self._data) < len(identifiers):
            return b""
        frame, self._data = self._config.sync + b"".join(self._data), []
        return frame

    def close(self) -> None:
        """Leave the bus. Idempotent."""
        self._bus.close()


def as_messages(config: ImuCan, frame: bytes) -> bytes:
    """Return the messages of ``frame``, which begins with its sync, as bytes of a serial adapter."""
    data = frame[len(config.sync) :]
    part = math.ceil(len(data) / len(config.identifiers))
    parts = (data[k * part : (k + 1) * part] for k in range(len(config.identifiers)))
    return b"".join(map(encode_serial, zip(config.identifiers, parts, strict=True)))
