"""The coupler's answers: literal Modbus transcripts, refusals, and any bytes at all."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.config.tables.io import Io
from hil.drivers.io.codec import Image, LineMap, respond, runs


def image() -> Image:
    coils = dict.fromkeys(range(10), False)
    inputs = dict.fromkeys(range(3), False) | {7: True}
    return Image(coils, inputs, ("hil", "io", "1.0"))


# request and answer without transaction, protocol, length and unit; after the examples of the Modbus
# application protocol specification, V1.1b3, chapter 6
TRANSCRIPT = [
    ("0f 0000 000a 02 cd 01", "0f 0000 000a"),
    ("01 0000 000a", "01 02 cd 01"),
    ("01 0002 0003", "01 01 03"),
    ("05 0001 ff00", "05 0001 ff00"),
    ("01 0000 0002", "01 01 03"),
    ("05 0001 0000", "05 0001 0000"),
    ("01 0000 0002", "01 01 01"),
    ("02 0000 0003", "02 01 00"),
    ("02 0007 0001", "02 01 01"),
    ("2b 0e 01 00", "2b 0e 01 01 00 00 03 00 03 68 69 6c 01 02 69 6f 02 03 31 2e 30"),
]

REFUSED = [
    ("03 0000 0001", "83 01"),  # no such function here
    ("2b 0d 01 00", "ab 01"),
    ("2b 0e 04 00", "ab 02"),
    ("01 0009 0002", "81 02"),  # runs over the last coil
    ("02 0003 0001", "82 02"),
    ("01 0000 0000", "81 03"),
    ("01 0000 07d1", "81 03"),  # 2001 bits
    ("05 0000 1234", "85 03"),
    ("0f 0000 0009 01 ff", "8f 03"),  # a byte for nine coils
    ("0f 0000 0008 01", "8f 03"),
    ("01 00", "81 03"),
]


def test_requests_are_answered_as_in_the_transcript() -> None:
    memory = image()
    for request, expected in TRANSCRIPT:
        assert respond(memory, bytes.fromhex(request)) == bytes.fromhex(expected), request


@pytest.mark.parametrize(("request_", "expected"), REFUSED)
def test_what_cannot_be_done_is_refused_by_code_and_changes_nothing(request_: str, expected: str) -> None:
    memory = image()
    assert respond(memory, bytes.fromhex(request_)) == bytes.fromhex(expected)
    assert not any(memory.coils.values())


@given(st.binary(min_size=1, max_size=300))
def test_any_request_is_answered_and_creates_no_line(request_: bytes) -> None:
    memory = image()
    response = respond(memory, request_)
    assert response[0] & 0x7F == request_[0] & 0x7F
    assert (len(memory.coils), memory.inputs) == (10, image().inputs)


def test_addresses_are_read_in_runs_without_lines_of_others() -> None:
    assert runs([5, 1, 0, 2, 9]) == (range(3), range(5, 6), range(9, 10))
    lines = LineMap(Io.model_validate({"driver": "modbus", "coils": {"charge_pump": 100}, "thruster_lines": 2}))
    assert lines.coils == (100, 1, 2, 3)
    assert lines.coil_runs == (range(1, 4), range(100, 101))


@pytest.mark.slow
def test_a_million_mutated_requests_are_answered() -> None:
    rng = random.Random(5)
    requests = [bytes.fromhex(request) for request, _ in TRANSCRIPT]
    memory = image()
    for _ in range(1_000_000):
        raw = bytearray(rng.choice(requests))
        for _ in range(rng.randrange(4)):
            raw[rng.randrange(len(raw))] ^= rng.randrange(1, 256)
        cut = rng.randrange(1, len(raw) + 1) if rng.random() < 0.2 else len(raw)
        response = respond(memory, bytes(raw[:cut]))
        assert 2 <= len(response) <= 253
    assert len(memory.coils) == 10
