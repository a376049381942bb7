"""Thruster command words: bytes <-> numbers.

Format on a serial port, 9 bytes, little endian:

====== ===== ====== ===============================================================
offset bytes type   content
====== ===== ====== ===============================================================
0      2     bytes  sync, EB 91
2      1     u8     version 1
3      1     u8     counter, wraps; another value in each word
4      3     u24    thrusters: bit n = thruster n + 1 is open
7      2     u16    CRC-16/CCITT-FALSE of offsets 2 to 6
====== ===== ====== ===============================================================

On CAN a frame with an 11-bit identifier carries offsets 2 to 8, seven bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from hil.drivers.checksums import crc16_ccitt

SYNC: Final = b"\xeb\x91"
VERSION: Final = 1
CAN_BYTES: Final = 7
WORD_BYTES: Final = len(SYNC) + CAN_BYTES
_CRC: Final = struct.Struct("<H")
_CRC_AT: Final = CAN_BYTES - _CRC.size


@dataclass(frozen=True, slots=True)
class Word:
    """An intact word. thrusters: bit n = thruster n + 1 is open."""

    counter: int
    thrusters: int


def encode(word: Word) -> bytes:
    """Return the bytes of ``word`` on a serial port."""
    return SYNC + encode_can(word)


def encode_can(word: Word) -> bytes:
    """Return the data of ``word``'s CAN frame."""
    body = bytes([VERSION, word.counter & 0xFF]) + word.thrusters.to_bytes(3, "little")
    return body + _CRC.pack(crc16_ccitt(body))


def decode_can(data: bytes) -> Word | None:
    """Return the word in a CAN frame's data, None if length, version or CRC are wrong."""
    if (
        len(data) != CAN_BYTES
        or data[0] != VERSION
        or _CRC.unpack_from(data, _CRC_AT)[0] != crc16_ccitt(data[:_CRC_AT])
    ):
        return None
    return Word(data[1], int.from_bytes(data[2:5], "little"))


class CommandWordDecoder:
    """Decodes words from a byte stream with arbitrary splits and damage; never raises."""

    def __init__(self) -> None:
        self.refused = 0
        """Number of syncs without a valid word: CRC or version."""
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Word]:
        """Decode ``data``; return the completed words. After an error the search resumes after the sync."""
        self._buffer += data
        words: list[Word] = []
        while True:
            start = self._buffer.find(SYNC)
            if start < 0:
                del self._buffer[: max(0, len(self._buffer) - 1)]
                return words
            del self._buffer[:start]
            if len(self._buffer) < WORD_BYTES:
                return words
            word = decode_can(bytes(self._buffer[len(SYNC) : WORD_BYTES]))
            if word is None:
                self.refused += 1
                del self._buffer[: len(SYNC)]
            else:
                words.append(word)
                del self._buffer[:WORD_BYTES]
