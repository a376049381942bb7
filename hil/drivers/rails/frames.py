"""Matching of Modbus responses, TCP and RTU, in a stream of bytes. No I/O.

A response is valid if device, function, length and transaction (TCP) or checksum (RTU) match the pending request, and
the exchange number, if the drive echoes one. Others are counted: damaged bytes, late and duplicate responses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

from pymodbus.framer import FramerRTU

READ: Final = 3
WRITE_ONE: Final = 6
WRITE: Final = 16
READ_WRITE: Final = 23
ANY_UNIT: Final = (0, 255)  # of Modbus TCP devices for which the unit id has no meaning
_READING: Final = (READ, READ_WRITE)
_WRITING: Final = (WRITE_ONE, WRITE)
_ERROR: Final = 0x80
_MBAP: Final = 7  # bytes of a TCP header: transaction, protocol, length, device
_CRC: Final = 2

Counters = dict[str, int]


def new_counters() -> Counters:
    """Return the counters of the wires of one driver, all zero."""
    return {"exchanges": 0, "retries": 0, "protocol_errors": 0, "late": 0, "duplicates": 0}


@dataclass(frozen=True, slots=True)
class Expected:
    """Response to the pending request.

    echo: index of the register, and value, of the echoed exchange number. written: address, and value or number of
    registers, that a writing function repeats.
    """

    device_id: int
    function: int
    count: int  # registers
    transaction: int = 0  # TCP only
    echo: tuple[int, int] | None = None
    written: tuple[int, int] | None = None

    def is_answered_by(self, frame: ModbusFrame, any_unit: bool = False) -> bool:
        """Return whether ``frame`` is the response. any_unit: the unit ids 0 and 255 are those of any device."""
        if frame.transaction != self.transaction:
            return False
        if frame.device_id != self.device_id and not (any_unit and frame.device_id in ANY_UNIT):
            return False
        if frame.function == self.function | _ERROR:
            return True
        if frame.function != self.function or len(frame.registers) != self.count:
            return False
        if self.written is not None:
            return frame.registers == self.written
        return self.echo is None or frame.registers[self.echo[0]] == self.echo[1]


@dataclass(frozen=True, slots=True)
class ModbusFrame:
    """One intact response. registers: words of its content; exception: exception code, 0 for none."""

    device_id: int
    function: int
    registers: tuple[int, ...]
    exception: int = 0
    transaction: int = 0


Measure = Callable[[bytes, int], int]


def measure_rtu(data: bytes, start: int) -> int:
    """Return the length of the intact RTU response at ``start``; 0: incomplete; -1: none."""
    available = len(data) - start
    if available < 2:
        return 0
    size = 5
    if data[start + 1] in _WRITING:
        size = 6 + _CRC
    elif data[start + 1] in _READING:
        if available < 3:
            return 0
        if not _even_and_full(data[start + 2]):
            return -1
        size = 3 + data[start + 2] + _CRC
    elif not _is_error(data[start + 1]):
        return -1
    if available < size:
        return 0
    end = start + size
    return size if FramerRTU.check_CRC(data[start : end - _CRC], int.from_bytes(data[end - _CRC : end], "big")) else -1


def measure_tcp(data: bytes, start: int) -> int:
    """Return the same for a TCP response, whose header must be consistent with its body."""
    available = len(data) - start
    if available < _MBAP + 2:
        return 0
    if data[start + 2] or data[start + 3]:
        return -1
    length = int.from_bytes(data[start + 4 : start + 6], "big")
    function, content = data[start + _MBAP], data[start + _MBAP + 1]
    if function in _WRITING:
        if length != 6:
            return -1
    elif function in _READING:
        if length != 3 + content or not _even_and_full(content):
            return -1
    elif not _is_error(function) or length != 3:
        return -1
    size = _MBAP - 1 + length
    return size if available >= size else 0


def split(data: bytes, measure: Measure) -> tuple[int, list[bytes], int]:
    """Return the number of bytes of ``data`` consumed, the intact responses in it, and the number of bytes skipped.

    A response after garbage is found as soon as it is complete, even if the garbage resembles the start of a longer
    one.
    """
    frames = []
    at = done = sound = 0
    waiting = False
    while at < len(data):
        size = measure(data, at)
        if size > 0:
            frames.append(data[at : at + size])
            sound += size
            at += size
            done, waiting = at, False
            continue
        waiting = waiting or size == 0
        at += 1
        if not waiting:
            done = at
    return done, frames, done - sound


def parse(frame: bytes, tcp: bool) -> ModbusFrame:
    """Return the content of an intact response."""
    transaction = int.from_bytes(frame[:2], "big") if tcp else 0
    body = frame[_MBAP - 1 :] if tcp else frame[:-_CRC]
    if body[1] & _ERROR:
        return ModbusFrame(body[0], body[1], (), body[2], transaction)
    first = 2 if body[1] in _WRITING else 3
    words = tuple(int.from_bytes(body[at : at + 2], "big") for at in range(first, len(body), 2))
    return ModbusFrame(body[0], body[1], words, 0, transaction)


@dataclass(slots=True)
class ResponseMatcher:
    """Selects the response to the pending request, and counts everything else.

    expect: set with each request, None between requests. damaged: description of damaged bytes received since then,
    "" for none. stranger: unit id of another device that has answered since then. Over TCP, where the transaction shows
    which request is answered, the unit ids 0 and 255 are accepted, and counted.
    """

    tcp: bool
    counters: Counters
    expect: Expected | None = None
    damaged: str = ""
    stranger: int | None = None
    _last: ModbusFrame | None = field(default=None)

    def await_(self, expected: Expected | None) -> None:
        """Start a request; None: without a response."""
        self.expect = expected
        self.damaged, self.stranger = "", None

    def feed(self, data: bytes) -> tuple[int, ModbusFrame | None]:
        """Return the number of bytes consumed, and the expected response if it is among them."""
        used, frames, skipped = split(data, measure_tcp if self.tcp else measure_rtu)
        if skipped:
            self.counters["protocol_errors"] += 1
            self.damaged = f"{skipped} bytes that are no response: {data[:24].hex(' ')}"
        answer = None
        for raw in frames:
            frame = parse(raw, self.tcp)
            if self.expect is not None and self.expect.is_answered_by(frame, any_unit=self.tcp):
                if frame.device_id != self.expect.device_id:
                    self.counters["other_unit"] = self.counters.get("other_unit", 0) + 1
                answer = self._last = replace(frame, device_id=self.expect.device_id)
                self.expect = None
            else:
                if self.expect is not None and frame.device_id != self.expect.device_id:
                    self.stranger = frame.device_id
                self._count_stray(frame)
        return used, answer

    def _count_stray(self, frame: ModbusFrame) -> None:
        last = self._last
        if last is not None and (frame.device_id, frame.function) == (last.device_id, last.function) and frame == last:
            self.counters["duplicates"] += 1
        else:
            self.counters["late"] += 1


def _is_error(function: int) -> bool:
    return function & _ERROR != 0 and function & ~_ERROR in (*_READING, *_WRITING)


def _even_and_full(byte_count: int) -> bool:
    return byte_count % 2 == 0 and 2 <= byte_count <= 250
