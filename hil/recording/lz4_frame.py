"""Frames of LZ4, also those of writers that do not end their blocks as the format asks, which the library refuses.

Format: LZ4 frame format 1.6.2. A block of it should end with 5 literals, and no match begin in its last 12 bytes; a few
writers do not heed that, and lose nothing by it.
"""

from __future__ import annotations

import struct
from typing import Final

import lz4.frame

_MAGIC, _WORD = b"\x04\x22\x4d\x18", struct.Struct("<I")
_HAS_DICTIONARY, _HAS_SIZE, _HAS_BLOCK_CHECKSUMS, _INDEPENDENT = 0x01, 0x08, 0x10, 0x20
_RAW: Final = 1 << 31
_LONG, _LEAST_MATCH = 15, 4


def unpacked(data: bytes, size: int, has_checksum: bool) -> bytes:
    """Return the content of a frame of ``size`` bytes, which a checksum of the caller's confirms if it has one.

    Raises RuntimeError, ValueError, LookupError or struct.error for what is no such frame.
    """
    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except RuntimeError:
        if not has_checksum:
            raise
    return _unpacked_by_hand(data, size)


def _unpacked_by_hand(data: bytes, size: int) -> bytes:
    """Return the content of a frame, whatever its blocks end with."""
    flags = data[len(_MAGIC)]
    if data[: len(_MAGIC)] != _MAGIC or flags & _HAS_DICTIONARY:
        raise ValueError("no frame of LZ4")
    at = 7 + (8 if flags & _HAS_SIZE else 0)
    out = bytearray()
    while (length := _WORD.unpack_from(data, at)[0]) != 0:
        begin, at = at + _WORD.size, at + _WORD.size + (length & ~_RAW)
        if at > len(data):
            raise ValueError("a block of LZ4 is cut")
        if length & _RAW:
            out += data[begin:at]
        else:
            _unpack_block(data[begin:at], out, len(out) if flags & _INDEPENDENT else 0, size)
        at += _WORD.size if flags & _HAS_BLOCK_CHECKSUMS else 0
    return bytes(out)


def _unpack_block(block: bytes, out: bytearray, first: int, size: int) -> None:
    """Append the content of ``block`` to ``out``; its matches refer to what is there from ``first`` on."""
    at, end = 0, len(block)
    while at < end:
        token = block[at]
        literals, at = _length(block, at + 1, token >> 4)
        out += block[at : at + literals]
        at += literals
        if at >= end:
            return
        offset = block[at] | block[at + 1] << 8
        match, at = _length(block, at + 2, token & _LONG)
        match += _LEAST_MATCH
        source = len(out) - offset
        if offset == 0 or source < first or len(out) + match > size:
            raise ValueError("a block of LZ4 refers to what is not there")
        if match <= offset:
            out += out[source : source + match]
        else:  # it repeats itself
            out += (out[source:] * (match // offset + 1))[:match]


def _length(block: bytes, at: int, short: int) -> tuple[int, int]:
    """Return a length that begins with ``short``, and where what follows it begins."""
    if short != _LONG:
        return short, at
    while (more := block[at]) == 255:
        short, at = short + 255, at + 1
    return short + more, at + 1
