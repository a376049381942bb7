"""Protocol of a sensor that sends its measurements as lines of text on a serial wire."""

from __future__ import annotations

from collections.abc import Sequence

BITS_PER_BYTE = 10
LONGEST_LINE = 200
"""Bytes after which a line without an end is discarded."""


class LineProtocol:
    """Base class: how measurements are asked for, written and read.

    baud, bytesize, parity: of the wire, as pyserial has them; a rig's table may give another baud rate. start: sent
    when the wire is opened, so that the sensor measures continuously; stop: sent before it is closed.
    """

    baud: int = 9600
    bytesize: int = 8
    parity: str = "N"
    start: bytes = b""
    stop: bytes = b""

    def encode(self, values: Sequence[float]) -> bytes:
        """Return the line, with its end, that means a measurement with components ``values``, SI."""
        raise NotImplementedError

    def decode(self, line: bytes) -> tuple[float, ...] | None:
        """Return the components of the measurement that ``line`` is, SI; None for a line that is none.

        line: without its end. Raises ValueError with what the sensor reports, or why the line cannot be read.
        """
        raise NotImplementedError
