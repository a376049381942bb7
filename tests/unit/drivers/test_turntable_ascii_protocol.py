"""The serial protocols on the wire: literal lines of both shipped protocols."""

from __future__ import annotations

import math

import pytest

from hil.config.load import load_protocol
from hil.drivers.checksums import crc16_ccitt, sum8, xor8
from hil.drivers.turntable.ascii.frames import BrokenLine
from hil.drivers.turntable.ascii.protocol import DEVICE, AsciiProtocol, CommandRefused
from hil.errors import FaultKind

HIL = AsciiProtocol(load_protocol("hil-ascii").value)
ACU = AsciiProtocol(load_protocol("acu").value)
SET = b">3A SET 12.345678 -1.000000 0.000000 0.500000 0.000000 0.000000*E630"
REPORT = b"<3A OK 01 01 81 0000 0000 0008 12.345601 -1.000002 0.000000 0.499873 0.000000 0.000000*A7B9"
POSITIONS = [math.radians(angle) for angle in (12.345678, -1.0, 0.0)]
RATES = [math.radians(rate) for rate in (0.5, 0.0, 0.0)]


def axes(name, values):
    return {(name, axis): pytest.approx(value, abs=1e-12) for axis, value in enumerate(values)}


def line_of(dialect, action):
    return dialect.lines[action][0]


def read(dialect, action, line, axis=DEVICE):
    sequence, body = dialect.replies.decode(line)
    return sequence, dialect.decode_reply(body, line_of(dialect, action), axis)


def test_setpoint_is_one_line_of_degrees_with_checksum():
    values = {("position", k): x for k, x in enumerate(POSITIONS)} | {("rate", k): x for k, x in enumerate(RATES)}
    assert HIL.request(0x3A, line_of(HIL, "set"), DEVICE, values) == SET + b"\r\n"
    sequence, line, axis, found = HIL.decode_request(SET)
    assert (sequence, line.action, axis) == (0x3A, "set", DEVICE)
    assert found == axes("position", POSITIONS) | axes("rate", RATES)


def test_report_gives_flags_positions_and_rates():
    positions, rates = [math.radians(a) for a in (12.345601, -1.000002, 0.0)], [math.radians(0.499873), 0.0, 0.0]
    expected = (
        axes("status", (1, 1, 0x81)) | axes("fault", (0, 0, 8)) | axes("position", positions) | axes("rate", rates)
    )
    sequence, told = read(HIL, "set", REPORT)
    assert (sequence, told) == (0x3A, expected)
    assert HIL.reply(0x3A, line_of(HIL, "status"), DEVICE, told) == REPORT + b"\r\n"


def test_identity_is_requested_and_answered_as_text():
    assert HIL.request(1, line_of(HIL, "identify"), DEVICE, {}) == b">01 IDN*5B53\r\n"
    told = {("model", DEVICE): "X", ("serial", DEVICE): "7"}
    assert read(HIL, "identify", b"<01 IDN X 7 3*1D6C") == (1, told)


def test_acu_asks_each_axis_in_milli_degrees_with_an_exclusive_or():
    values = {("position", 0): POSITIONS[0], ("rate", 0): -RATES[0]}
    line = b"PA1=12345.678;VA1=-500.000;^26\r"
    assert ACU.request(0, line_of(ACU, "set"), 0, values) == line
    _, step, axis, found = ACU.decode_request(line[:-1])
    assert (step.action, axis) == ("set", 0)
    assert found == {key: pytest.approx(value, abs=1e-12) for key, value in values.items()}


def test_acu_reply_reports_one_axis_and_ends_in_a_prompt():
    line = b"PA2=12345.600;VA2=-499.870;SR2=3;EC2=0;^23\r\n>"
    _, told = read(ACU, "status", line[:-3], axis=1)
    assert told["position", 1] == pytest.approx(math.radians(12.3456))
    assert (told["status", 1], told["fault", 1]) == (3, 0)
    assert ACU.reply(0, line_of(ACU, "status"), 1, told) == line


def test_acu_reply_of_another_axis_is_refused():
    with pytest.raises(BrokenLine, match="is no reply to"):
        read(ACU, "status", b"PA2=12345.600;VA2=-499.870;SR2=3;EC2=0;^23", axis=0)


@pytest.mark.parametrize(
    ("dialect", "line", "text"),
    [(HIL, HIL.refusal(7, 3)[:-2], r"error 3 \(refused in this state\)"), (ACU, b"?13;^06", r"error 13 \(not now\)")],
)
def test_error_reply_is_named(dialect, line, text):
    with pytest.raises(CommandRefused, match=text):
        read(dialect, "enable", line)


def test_one_changed_character_breaks_the_checksum():
    with pytest.raises(BrokenLine, match="checksum A7B9, expected"):
        HIL.replies.decode(REPORT.replace(b"12.345601", b"12.345701"))


@pytest.mark.parametrize("line", [b"", b"<", b"<3A OK", b"*29B1", b"<*FFFF", b"\xff\x00*1234", REPORT[1:]])
def test_what_is_no_line_is_refused(line):
    with pytest.raises(BrokenLine):
        HIL.replies.decode(line)


@pytest.mark.parametrize("body", ["OK 01", "OK " + "0 " * 11 + "nan", "OK " + " ".join(["x"] * 12), ""])
def test_what_is_no_report_is_refused(body):
    with pytest.raises(BrokenLine, match="no reply"):
        HIL.decode_reply(body, line_of(HIL, "status"), DEVICE)


@pytest.mark.parametrize("numbers", ["1 1 1 1 1", "1 1 1 1 1 inf", "1 1 1 1 1 one", "1 1 1 1 1 1 1"])
def test_setpoint_needs_six_finite_numbers(numbers):
    line = HIL.requests.encode(1, f"SET {numbers}")[:-2]
    with pytest.raises(CommandRefused):
        HIL.decode_request(line)


def test_lines_are_found_after_garbage_and_across_reads():
    splitter = HIL.replies.splitter()
    wire = b"\x00\xffno\r\n" + b"half of <3A OK 01" + REPORT + b"\r\n" + REPORT + b"\r\n"
    found = [line for byte in wire for line in splitter.feed(bytes((byte,)))]
    assert found == [REPORT, REPORT]
    assert splitter.skipped_bytes == len(b"\x00\xffno\r\n" + b"half of <3A OK 01")


def test_endless_line_does_not_fill_the_memory():
    splitter = HIL.replies.splitter()
    for _ in range(100):
        assert splitter.feed(b"x" * 100) == []
    assert splitter.skipped_bytes > 9000
    assert splitter.feed(b"\r\n" + REPORT + b"\r\n") == [REPORT]


def test_fault_flags_and_codes_are_named():
    assert HIL.fault_text(0x0021) == "over-current, following error"
    assert HIL.fault_text(0x8000) == "unknown flags 0x8000"
    assert ACU.fault_text(4) == "following error"
    assert ACU.fault_text(99) == "unknown fault 99"


@pytest.mark.parametrize(
    ("dialect", "number", "kind"),
    [
        (HIL, 0x0100, FaultKind.TORQUE_OFF),
        (HIL, 0x0180, FaultKind.TORQUE_OFF),  # a command time-out besides
        (HIL, 0x0080, FaultKind.OTHER),
        (HIL, 0, FaultKind.OTHER),
        (ACU, 6, FaultKind.TORQUE_OFF),
        (ACU, 7, FaultKind.OTHER),  # codes are no flags
        (ACU, 2, FaultKind.OTHER),
    ],
)
def test_torque_off_is_a_flag_or_a_code(dialect, number, kind):
    assert dialect.fault_kind(number) is kind


def test_checksums_are_those_of_the_catalogue():
    assert (crc16_ccitt(b"123456789"), xor8(b"123456789"), sum8(b"123456789")) == (0x29B1, 0x31, 0xDD)
