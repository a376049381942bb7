"""Lines of a serial protocol: start, sequence number, body, checksum, end. No I/O, no clock."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

from hil.config.protocol import Checksum, Protocol
from hil.drivers.checksums import crc16_ccitt, sum8, xor8

_HEX = re.compile(rb"[0-9A-F]+")


class BrokenLine(Exception):
    """A line that is damaged or not of this protocol."""


CHECKSUMS: Final[dict[str, tuple[Callable[[bytes], int], int]]] = {
    "sum8": (sum8, 2),
    "xor8": (xor8, 2),
    "crc16-ccitt": (crc16_ccitt, 4),
}


class Framing:
    """One direction of a line: ``start`` and ``end`` as the protocol file names them."""

    def __init__(self, protocol: Protocol, start: str, end: str) -> None:
        self.start = start.encode("ascii")
        self.end = end.encode("ascii")
        self._longest = protocol.line.longest_bytes
        self._checksum: Checksum = protocol.checksum
        self._separator = protocol.checksum.separator.encode("ascii")
        self._digits = protocol.sequence.digits if protocol.sequence else 0
        self._space = protocol.sequence.separator.encode("ascii") if protocol.sequence else b""

    def encode(self, sequence: int, body: str) -> bytes:
        """Return a whole line."""
        text = (b"%0*X" % (self._digits, sequence) if self._digits else b"") + self._space + body.encode("ascii")
        return self.start + text + self._check_part(text) + self.end

    def decode(self, line: bytes) -> tuple[int, str]:
        """Return sequence number (0 without one) and body of a line without its end. Raises BrokenLine."""
        if not line.startswith(self.start):
            raise BrokenLine(f"not a line of this protocol: {line!r}")
        text = self._checked(line[len(self.start) :])
        sequence = 0
        if self._digits:
            head = text[: self._digits]
            if (
                not _HEX.fullmatch(head)
                or len(head) < self._digits
                or text[self._digits :][: len(self._space)] != self._space
            ):
                raise BrokenLine(f"no sequence number: {line!r}")
            sequence = int(head, 16)
            text = text[self._digits + len(self._space) :]
        if not text.isascii():
            raise BrokenLine(f"not a line of this protocol: {line!r}")
        return sequence, text.decode("ascii")

    def splitter(self) -> LineSplitter:
        """Return a splitter for this direction."""
        return LineSplitter(self.start, self.end, self._longest)

    def _checked(self, text: bytes) -> bytes:
        if self._checksum.kind == "none":
            return text
        length = CHECKSUMS[self._checksum.kind][1] + len(self._separator)
        body, checksum = text[:-length], text[-length:]
        expected = self._check_part(body)
        if len(text) < length or checksum != expected:
            shown = checksum[len(self._separator) :].decode("ascii", "replace")
            raise BrokenLine(f"checksum {shown}, expected {expected[len(self._separator) :].decode('ascii')}")
        return body

    def _check_part(self, text: bytes) -> bytes:
        """Return separator and digits of the checksum for the text between start and separator."""
        if self._checksum.kind == "none":
            return b""
        function, digits = CHECKSUMS[self._checksum.kind]
        covered = (self.start if self._checksum.covers_start else b"") + text
        covered += self._separator if self._checksum.covers_separator else b""
        return b"%b%0*X" % (self._separator, digits, function(covered))


class LineSplitter:
    """Splits a byte stream into lines; bytes outside lines are skipped and counted."""

    def __init__(self, start: bytes, end: bytes, longest: int) -> None:
        self._start = start
        self._end = end
        self._longest = longest
        self._buffer = bytearray()
        self.skipped_bytes = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that ``data`` completes, from their start characters to before their end."""
        self._buffer += data
        lines = []
        while (end := self._buffer.find(self._end)) >= 0:
            line = bytes(self._buffer[:end])
            del self._buffer[: end + len(self._end)]
            start = line.rfind(self._start) if self._start else 0
            self.skipped_bytes += len(line) + len(self._end) if start < 0 else start
            if start >= 0 and line:
                lines.append(line[start:])
        if len(self._buffer) > self._longest:
            kept = len(self._end) - 1  # the beginning of an end
            self.skipped_bytes += len(self._buffer) - kept
            del self._buffer[: len(self._buffer) - kept]
        return lines

    def clear(self) -> None:
        """Discard an incomplete line."""
        self.skipped_bytes += len(self._buffer)
        self._buffer.clear()
