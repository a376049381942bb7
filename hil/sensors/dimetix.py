"""Lines of the laser distance sensors of Dimetix: command set of the DLS-A, DLS-C and FLS-C series, device number 0.

Technical Reference Manual DLS-C/FLS-C, chapter "Command set": ``s0h`` measures continuously, each measurement is a line
``g0h+xxxxxxxx`` in 1/10 mm, an error ``g0@Ezzz``; ``s0c`` stops, which is acknowledged by ``g0?``. Lines end with
carriage return and line feed; 19,200 baud, seven bits, even parity as delivered.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from hil.core.line_protocol import LineProtocol

_DISTANCE: Final = re.compile(rb"g\du?h\+(\d{8})")
_ERROR: Final = re.compile(rb"g\d@E(\d{3})")
_ACKNOWLEDGED: Final = re.compile(rb"g\d\?")
_UNIT_M: Final = 1e-4
_MOST: Final = 99_999_999


class DimetixLines(LineProtocol):
    """Continuous measurement of one distance."""

    baud = 19_200
    bytesize = 7
    parity = "E"
    start = b"s0h\r\n"
    stop = b"s0c\r\n"

    def encode(self, values: Sequence[float]) -> bytes:
        """Return the line of a distance."""
        return b"g0h+%08d\r\n" % min(_MOST, max(0, round(values[0] / _UNIT_M)))

    def decode(self, line: bytes) -> tuple[float, ...] | None:
        """Return the distance of a line."""
        if found := _DISTANCE.fullmatch(line):
            return (int(found[1]) * _UNIT_M,)
        if _ACKNOWLEDGED.fullmatch(line):
            return None
        if found := _ERROR.fullmatch(line):
            raise ValueError(f"the sensor reports error {found[1].decode()}")
        raise ValueError("no line of a distance sensor")
