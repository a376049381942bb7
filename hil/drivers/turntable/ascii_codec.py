"""Serial ASCII turntable controller: lines <-> numbers. No I/O, no clock.

Half duplex, one request line and one reply line, 7-bit ASCII:

    request   >3A SET 12.345678 -1.000000 0.000000 0.500000 0.000000 0.000000*E630<CR><LF>
    reply     <3A OK 01 01 81 0000 0000 0008 12.345601 -1.000002 0.000000 0.499873 0.000000 0.000000*A7B9<CR><LF>

``3A`` is the sequence number (two hex digits, the reply repeats it), the four hex digits after ``*``
are CRC-16/CCITT-FALSE of all between the first character and ``*``. Axis order roll, pitch, yaw;
angles in degrees, rates in deg/s, at least six decimals. A request with a bad checksum gets no reply.
COMMANDS and REPORT are the whole command set.
"""

from __future__ import annotations

import binascii
import math
from dataclasses import dataclass
from typing import Final

REQUEST_START: Final = b">"
REPLY_START: Final = b"<"
_END = b"\r\n"
_LONGEST = 256

ENABLED: Final = 0x01  # status flags of an axis
QUICK_STOPPED: Final = 0x02
MOVING: Final = 0x04
FAULT: Final = 0x80

FAULT_FLAGS: Final = {
    0x0001: "over-current",
    0x0002: "over-voltage",
    0x0004: "under-voltage",
    0x0008: "over-temperature",
    0x0010: "encoder fault",
    0x0020: "following error",
    0x0040: "limit switch",
    0x0080: "command time-out",
    0x0100: "emergency stop circuit open",
}


@dataclass(frozen=True, slots=True)
class Command:
    """One command: the word on the wire, how many numbers follow, what the answer's body begins with."""

    word: str
    numbers: int
    answer: str


IDENTIFY: Final = Command("IDN", 0, "IDN")
READ: Final = Command("GET", 0, "OK")
ENABLE: Final = Command("ENA", 0, "OK")  # setpoint := where the axes stand; refused while moving or in fault
SET: Final = Command("SET", 6, "OK")  # 3 positions, deg; 3 rates, deg/s; ignored by an axis that is not enabled
HOLD: Final = Command("HLD", 0, "OK")
QUICK_STOP: Final = Command("QST", 0, "OK")
CLEAR_FAULTS: Final = Command("CLR", 0, "OK")
COMMANDS: Final = {c.word: c for c in (IDENTIFY, READ, ENABLE, SET, HOLD, QUICK_STOP, CLEAR_FAULTS)}

ERRORS: Final = {1: "unknown command", 2: "wrong arguments", 3: "refused in this state"}


class BrokenLine(Exception):
    """A line that does not mean what it should."""


@dataclass(frozen=True, slots=True)
class Report:
    """What the controller says of its axes: status and fault flags, deg, deg/s."""

    status: tuple[int, int, int]
    faults: tuple[int, int, int]
    position_deg: tuple[float, float, float]
    rate_degps: tuple[float, float, float]


_REPORT = "{:02X} {:02X} {:02X} {:04X} {:04X} {:04X} {:.6f} {:.6f} {:.6f} {:.6f} {:.6f} {:.6f}"
_REPORT_WORDS = 12


def encode_request(sequence: int, command: Command, numbers: tuple[float, ...] = ()) -> bytes:
    """Return a request line; ``numbers`` in deg and deg/s."""
    words = [f"{sequence:02X}", command.word, *(f"{number:.6f}" for number in numbers)]
    return _frame(REQUEST_START, " ".join(words))


def decode_request(line: bytes) -> tuple[int, str, tuple[str, ...]]:
    """Return sequence number, command word and its arguments as text. Raises BrokenLine."""
    sequence, words = _unframe(REQUEST_START, line)
    return sequence, words[0], tuple(words[1:])


def encode_report(sequence: int, report: Report) -> bytes:
    """Return the reply line to every command that has a report for its answer."""
    body = _REPORT.format(*report.status, *report.faults, *report.position_deg, *report.rate_degps)
    return _frame(REPLY_START, f"{sequence:02X} OK {body}")


def encode_answer(sequence: int, *words: str) -> bytes:
    """Return a reply line of another kind: ``IDN model serial axes`` or ``ERR number``."""
    return _frame(REPLY_START, " ".join((f"{sequence:02X}", *words)))


def decode_reply(line: bytes) -> tuple[int, list[str]]:
    """Return sequence number and words of a reply line. Raises BrokenLine."""
    return _unframe(REPLY_START, line)


def decode_report(words: list[str]) -> Report:
    """Return the report in a reply's words. Raises BrokenLine."""
    if len(words) != _REPORT_WORDS + 1 or words[0] != "OK":
        raise BrokenLine(f"not a report: {' '.join(words)}")
    try:
        flags = [int(word, 16) for word in words[1:7]]
        p1, p2, p3, r1, r2, r3 = numbers = [float(word) for word in words[7:]]
    except ValueError as error:
        raise BrokenLine(f"not a report: {error}") from error
    if not all(math.isfinite(number) for number in numbers):
        raise BrokenLine("not a report: a number is not finite")
    return Report((flags[0], flags[1], flags[2]), (flags[3], flags[4], flags[5]), (p1, p2, p3), (r1, r2, r3))


def decode_numbers(command: Command, words: tuple[str, ...]) -> tuple[float, ...]:
    """Return a request's numbers. Raises BrokenLine for a wrong count or one that is not finite."""
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError as error:
        raise BrokenLine(f"{command.word}: {error}") from error
    if len(numbers) != command.numbers or not all(math.isfinite(number) for number in numbers):
        raise BrokenLine(f"{command.word}: {command.numbers} finite numbers expected")
    return numbers


def fault_text(flags: int) -> str:
    """Return the names of fault flags."""
    names = [name for bit, name in FAULT_FLAGS.items() if flags & bit]
    unknown = flags & ~sum(FAULT_FLAGS)
    if unknown:
        names.append(f"unknown flags 0x{unknown:04X}")
    return ", ".join(names) or "no fault flag"


class LineSplitter:
    """Cuts a byte stream into lines; what cannot be part of a line is skipped and counted."""

    def __init__(self, start: bytes) -> None:
        self._start = start
        self._buffer = bytearray()
        self.skipped_bytes = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that ``data`` completes, from their start character to before CR LF."""
        self._buffer += data
        lines = []
        while (end := self._buffer.find(_END)) >= 0:
            line = bytes(self._buffer[:end])
            del self._buffer[: end + len(_END)]
            start = line.rfind(self._start)
            self.skipped_bytes += len(line) + len(_END) if start < 0 else start
            if start >= 0:
                lines.append(line[start:])
        if len(self._buffer) > _LONGEST:
            self.skipped_bytes += len(self._buffer) - 1
            del self._buffer[:-1]
        return lines

    def clear(self) -> None:
        """Forget a begun line."""
        self.skipped_bytes += len(self._buffer)
        self._buffer.clear()


def _checksum(body: bytes) -> int:
    return binascii.crc_hqx(body, 0xFFFF)


def _frame(start: bytes, body: str) -> bytes:
    text = body.encode("ascii")
    return b"%b%b*%04X\r\n" % (start, text, _checksum(text))


def _unframe(start: bytes, line: bytes) -> tuple[int, list[str]]:
    body, star, checksum = line[1:].rpartition(b"*")
    if not line.startswith(start) or not star:
        raise BrokenLine(f"not a line of this protocol: {line!r}")
    expected = _checksum(body)
    if checksum != b"%04X" % expected:
        raise BrokenLine(f"checksum {checksum.decode('ascii', 'replace')}, expected {expected:04X}")
    try:
        sequence, first, *others = body.decode("ascii").split()
        return int(sequence, 16), [first, *others]
    except ValueError as error:
        raise BrokenLine(f"not a line of this protocol: {line!r}") from error
