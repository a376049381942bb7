"""Protocol buffers, as far as EGM needs them: fields of numbers, of doubles and of messages."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final

Value = int | float | bytes
Fields = dict[int, list[Value]]
_VARINT, _DOUBLE, _BYTES, _FLOAT = 0, 1, 2, 5
_VARINT_MAX: Final = 10


def message(fields: Iterable[tuple[int, Value]]) -> bytes:
    """Return a message of fields, by number: int as varint, float as double, bytes as an inner message."""
    parts = []
    for number, value in fields:
        if isinstance(value, float):
            parts.append(_varint(number << 3 | _DOUBLE) + struct.pack("<d", value))
        elif isinstance(value, bytes):
            parts.append(_varint(number << 3 | _BYTES) + _varint(len(value)) + value)
        else:
            parts.append(_varint(number << 3 | _VARINT) + _varint(int(value)))
    return b"".join(parts)


def fields_of(data: bytes) -> Fields:
    """Return the values of each field of a message, in their order. Raises ValueError."""
    fields: Fields = {}
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        kind = key & 7
        value: Value | None = None
        if kind == _VARINT:
            value, at = _read_varint(data, at)
        elif kind == _BYTES:
            length, at = _read_varint(data, at)
            value, at = data[at : at + length], at + length
        elif kind in (_DOUBLE, _FLOAT):
            size = 8 if kind == _DOUBLE else 4
            piece, at = data[at : at + size], at + size
            value = struct.unpack("<d" if size == 8 else "<f", piece)[0] if len(piece) == size else None
        if value is None or at > len(data):
            raise ValueError("not a message of protocol buffers")
        fields.setdefault(key >> 3, []).append(value)
    return fields


def inner(fields: Fields, number: int) -> Fields | None:
    """Return the fields of the inner message ``number``, None without one. Raises ValueError."""
    values = fields.get(number)
    if not values:
        return None
    if not isinstance(values[-1], bytes):
        raise ValueError(f"field {number} is no message")
    return fields_of(values[-1])


def doubles(fields: Fields, number: int) -> list[float]:
    """Return the doubles of a field, packed or not. Raises ValueError."""
    found: list[float] = []
    for value in fields.get(number, []):
        if isinstance(value, bytes):
            if len(value) % 8:
                raise ValueError(f"field {number} has no doubles")
            found += struct.unpack(f"<{len(value) // 8}d", value)
        else:
            found.append(float(value))
    return found


def integer(fields: Fields | None, number: int, default: int = 0) -> int:
    """Return the number of a field. Raises ValueError."""
    value = ((fields or {}).get(number) or [default])[-1]
    if not isinstance(value, int):
        raise ValueError(f"field {number} is no number")
    return value


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for k in range(_VARINT_MAX):
        if at + k >= len(data):
            break
        value |= (data[at + k] & 0x7F) << (7 * k)
        if data[at + k] < 0x80:
            return value, at + k + 1
    raise ValueError("not a message of protocol buffers")
