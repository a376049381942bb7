"""The serial ASCII protocol: literal lines."""

from __future__ import annotations

import pytest

from hil.drivers.turntable import ascii_codec as codec
from hil.drivers.turntable.ascii_codec import BrokenLine, LineSplitter, Report

SET = b">3A SET 12.345678 -1.000000 0.000000 0.500000 0.000000 0.000000*E630"
REPORT = b"<3A OK 01 01 81 0000 0000 0008 12.345601 -1.000002 0.000000 0.499873 0.000000 0.000000*A7B9"


def test_setpoint_is_one_line_of_degrees_with_checksum():
    numbers = (12.345678, -1.0, 0.0, 0.5, 0.0, 0.0)
    assert codec.encode_request(0x3A, codec.SET, numbers) == SET + b"\r\n"
    sequence, word, words = codec.decode_request(SET)
    assert (sequence, word, codec.decode_numbers(codec.SET, words)) == (0x3A, "SET", numbers)


def test_report_gives_flags_positions_and_rates():
    report = Report((1, 1, 0x81), (0, 0, 8), (12.345601, -1.000002, 0.0), (0.499873, 0.0, 0.0))
    assert codec.encode_report(0x3A, report) == REPORT + b"\r\n"
    sequence, words = codec.decode_reply(REPORT)
    assert (sequence, codec.decode_report(words)) == (0x3A, report)


def test_identity_is_asked_and_answered_in_words():
    assert codec.encode_request(1, codec.IDENTIFY) == b">01 IDN*5B53\r\n"
    assert codec.decode_reply(b"<01 IDN X 7 3*1D6C") == (1, ["IDN", "X", "7", "3"])


def test_one_changed_character_breaks_the_checksum():
    with pytest.raises(BrokenLine, match="checksum A7B9, expected"):
        codec.decode_reply(REPORT.replace(b"12.345601", b"12.345701"))


@pytest.mark.parametrize("line", [b"", b"<", b"<3A OK", b"*29B1", b"<*FFFF", b"\xff\x00*1234", REPORT[1:]])
def test_what_is_no_line_is_refused(line):
    with pytest.raises(BrokenLine):
        codec.decode_reply(line)


@pytest.mark.parametrize("words", [["ERR", "3"], ["OK", "01"], ["OK", *["0"] * 11, "nan"], ["OK", *["x"] * 12]])
def test_what_is_no_report_is_refused(words):
    with pytest.raises(BrokenLine, match="not a report"):
        codec.decode_report(words)


@pytest.mark.parametrize("words", [("1",) * 5, ("1",) * 5 + ("inf",), ("1",) * 5 + ("one",)])
def test_setpoint_needs_six_finite_numbers(words):
    with pytest.raises(BrokenLine, match="SET"):
        codec.decode_numbers(codec.SET, words)


def test_lines_are_found_after_garbage_and_across_reads():
    splitter = LineSplitter(codec.REPLY_START)
    wire = b"\x00\xffno\r\n" + b"half of <3A OK 01" + REPORT + b"\r\n" + REPORT + b"\r\n"
    found = [line for byte in wire for line in splitter.feed(bytes((byte,)))]
    assert found == [REPORT, REPORT]
    assert splitter.skipped_bytes == len(b"\x00\xffno\r\n" + b"half of <3A OK 01")


def test_endless_line_does_not_fill_the_memory():
    splitter = LineSplitter(codec.REPLY_START)
    for _ in range(100):
        assert splitter.feed(b"x" * 100) == []
    assert splitter.skipped_bytes > 9000
    assert splitter.feed(b"\r\n" + REPORT + b"\r\n") == [REPORT]


def test_fault_flags_are_named():
    assert codec.fault_text(0x0021) == "over-current, following error"
    assert codec.fault_text(0x8000) == "unknown flags 0x8000"
