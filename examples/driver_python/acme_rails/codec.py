"""Lines of the ACME controller: bytes <-> numbers. No I/O, no clock.

A request is ``NUMBER COMMAND [x y z vx vy vz]``, a response ``NUMBER STATUS x y z vx vy vz``, or ``NUMBER MODEL`` to
the command IDENT. Positions are in um, rates in um/s. ``*`` and the exclusive or of all bytes before it, two
hexadecimal digits, end each line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from functools import reduce
from operator import xor

IDENT, ENABLE, SET, READ, STOP = "IDENT", "ENABLE", "SET", "READ", "STOP"
UM_PER_M = 1e6


class Status(IntFlag):
    """Status of the controller."""

    ENABLED = 1
    FAULT = 2
    TORQUE_OFF = 4


@dataclass(frozen=True)
class Response:
    """Status, positions (m) and rates (m/s) of x, y, z."""

    status: Status
    position_m: tuple[float, ...]
    rate_mps: tuple[float, ...]


def encode(text: str) -> bytes:
    """Return ``text`` as a line."""
    data = text.encode("ascii")
    return b"%b*%02X\n" % (data, reduce(xor, data, 0))


def decode(line: bytes) -> list[str]:
    """Return the words of a line. Raises ValueError if the checksum is wrong."""
    data, _, checksum = line.rpartition(b"*")
    if checksum != b"%02X" % reduce(xor, data, 0):
        raise ValueError(f"checksum: {line!r}")
    return data.decode("ascii").split()


def encode_numbers(*values_m: Sequence[float]) -> str:
    """Return positions (m) and rates (m/s) as text."""
    return " ".join(str(round(value * UM_PER_M)) for values in values_m for value in values)


def decode_numbers(words: Sequence[str]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return positions (m) and rates (m/s). Raises ValueError."""
    if len(words) != 6:
        raise ValueError(f"{len(words)} numbers, expected 6")
    values = tuple(int(word) / UM_PER_M for word in words)
    return values[:3], values[3:]


def decode_response(words: Sequence[str]) -> Response:
    """Return a response without its number. Raises ValueError."""
    return Response(Status(int(words[0])), *decode_numbers(words[1:]))
