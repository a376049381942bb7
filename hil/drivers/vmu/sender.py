"""Sender of frames on a real RS-422 line, for poses measured by this computer."""

from __future__ import annotations

import contextlib
import termios
from dataclasses import replace
from typing import Final

import serial

from hil.core.messages import PoseFrame
from hil.drivers.vmu.codec import STATUS_NO_POSE, ReportedIdentity
from hil.drivers.vmu.codecs import frame_codec
from hil.errors import LinkLost

IDENTITY: Final = ReportedIdentity("hil", "VMU-SOFT", "1.0")
IDENTITY_PERIOD_S: Final = 1.0
_NAME: Final = "vmu"


class FrameSender:
    """Sends identity and frames, numbered from 0, on the serial port ``port``. Raises LinkLost, in the unit's name."""

    def __init__(self, port: str, baud: int) -> None:
        self._codec = frame_codec()
        self._identity = self._codec.encode_identity(IDENTITY)
        self._identified_s = -float("inf")
        self._counter = 0
        try:
            self._line = serial.Serial(port, baud, write_timeout=1.0)
        except Exception as error:  # pyserial: OSError, ValueError (baud), termios.error
            raise LinkLost(_NAME, f"cannot open {port} at {baud} baud: {error}") from error
        self._port = port

    def send(self, pose: PoseFrame | None, t_s: float) -> None:
        """Send the pose of the exposure at ``t_s``, s of the unit's clock; None: no pose."""
        counter, self._counter = self._counter, (self._counter + 1) & 0xFFFF_FFFF
        data = b""
        if t_s - self._identified_s >= IDENTITY_PERIOD_S:
            data, self._identified_s = self._identity, t_s
        if pose is None:
            data += self._codec.encode_status(counter, t_s, STATUS_NO_POSE)
        else:
            data += self._codec.encode(replace(pose, counter=counter, t_s=t_s))
        try:
            self._line.write(data)
        except OSError as error:
            raise LinkLost(_NAME, f"{self._port}: {error}") from error

    def close(self) -> None:
        """Close the port after all data has been sent. Idempotent."""
        if self._line.is_open:
            with contextlib.suppress(OSError, termios.error):  # the line may be gone, with what was not sent
                self._line.flush()
            self._line.close()
