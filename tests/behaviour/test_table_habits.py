"""ASCII tables that differ: formats of numbers, status as text, silent commands, echo, TCP, in lock-step."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import configs_folder, load_protocol
from hil.core.messages import Homing
from hil.drivers.turntable.ascii.protocol import AsciiProtocol, FieldFormat
from hil.errors import BadInput, DriveFault, ProtocolError
from tests.support.turntable_bench import PARK_DEG, error_of, eventually, served

ACU = (configs_folder() / "protocols" / "acu.toml").read_text()
WORDS = """
[status_words]
Off = []
Ready = ["enabled", "homed"]
Busy = ["enabled", "homed", "moving"]
Stopped = ["homed", "quick_stopped"]
"Limit low" = ["enabled", "homed", "limit_low"]
Fault = ["fault", "homed"]
"""
PLAIN = '[checksum]\nkind = "none"\n'


def file_of(tmp_path, *changes: tuple[str, str]) -> str:
    text = ACU
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "table.toml"
    path.write_text(text)
    return str(path)


def in_words(tmp_path) -> str:
    head, _, rest = ACU.partition("[status] # bits")
    path = tmp_path / "words.toml"
    head = head.replace('home = [{ send = "HM{axis};", reply = "state", each_axis = true }]', "")
    path.write_text(head + WORDS + rest[rest.index("[faults]") :])
    return str(path)


SILENT = ('VA{axis}={rate};", reply = "state", each', 'VA{axis}={rate};", each')
ECHO = ("[line]\n", "[line]\necho = true\n")


def moves(protocol: str, address: str | None = None) -> None:
    with served("acu", protocol=protocol, listen=address) as (_, device, clock):
        assert np.degrees(device.read(clock.now_s()).position) == pytest.approx(PARK_DEG, abs=1e-4)
        goal = np.radians((0.0, 1e-7, -3.0))
        end_s = clock.now_s() + 3.0
        while clock.now_s() < end_s:
            device.send(goal, np.zeros(3), clock.now_s())
            clock.sleep(0.02)
        assert device.read(clock.now_s()).position == pytest.approx(goal, abs=1e-4)
        assert device.counters()["protocol_errors"] == device.counters()["lost"] == 0


@pytest.mark.parametrize("habit", ["words", "silent", "echo", "silent with echo", "TCP"])
def test_table_with_a_habit_moves(tmp_path, habit: str) -> None:
    if habit == "words":
        moves(in_words(tmp_path))
        return
    changes = [change for name, change in (("silent", SILENT), ("echo", ECHO)) if name in habit]
    moves(file_of(tmp_path, *changes), "tcp://127.0.0.1:0" if habit == "TCP" else None)


NUMBERS = [
    "12.",
    ".5",
    "-1.5e-7",
    "1E3",
    "  3.25 ",
    "+7",
    "0.0000000000001234",
    "-0",
    "1e-300",
    "12345.678901234567890",
]


@pytest.mark.parametrize("text", NUMBERS)
def test_number_is_read_as_float_reads_it(tmp_path, text: str) -> None:
    protocol = load_protocol(file_of(tmp_path)).value
    assert FieldFormat(protocol, "position").read(text) == pytest.approx(np.radians(float(text) / 1000.0))
    table = AsciiProtocol(protocol)
    line = table.lines["status"][0]
    reply = table.decode_reply(f"PA1={text};VA1={text};SR1=-1;EC1= 0;", line, 0)
    assert reply["position", 0] == pytest.approx(np.radians(float(text) / 1000.0))
    assert reply["status", 0] == 0xFFFF_FFFF


def test_drawn_numbers_and_paddings_are_read(tmp_path) -> None:
    table, dice = AsciiProtocol(load_protocol(file_of(tmp_path)).value), random.Random(5)
    line = table.lines["status"][0]
    for _ in range(2000):
        value = dice.choice([0.0, 10.0 ** dice.uniform(-15, 5)]) * dice.choice([1, -1])
        text = dice.choice(["{:g}", "{:.3f}", "{:.15f}", "{:e}", "{:12.4f}", "{!r}"]).format(value)
        status = dice.choice(["3", " 3", "003", "+3", "-32768"])
        reply = table.decode_reply(f"PA1={text};VA1=0;SR1={status};EC1=0;", line, 0)
        assert reply["position", 0] == pytest.approx(np.radians(float(text) / 1000.0), rel=1e-12, abs=1e-30)


def test_fault_as_text_is_a_drive_fault(tmp_path) -> None:
    with served("acu", protocol=in_words(tmp_path)) as (emulator, device, clock):
        emulator.faults.on("drive_fault", "pitch", 3.0)
        with pytest.raises(DriveFault, match=r"turntable\.pitch: encoder"):
            raise error_of(device, clock)


def test_reply_that_cannot_be_read_is_shown_with_the_line_that_it_answers(tmp_path) -> None:
    wrong = pytest.raises(ProtocolError, match=r"turntable: 4 broken replies in a row: .*PA1=ERR.* is no reply to 'RS")
    with wrong, served("acu", prepare=spoil):
        pass


def spoil(emulator) -> None:
    written = emulator.protocol.reply

    def reply(sequence, line, axis, values):
        text = written(sequence, line, axis, values)
        return text if line.action != "status" else emulator.protocol.replies.encode(sequence, "PA1=ERR;")

    emulator.protocol.reply = reply


def test_words_without_an_enabled_state_are_refused(tmp_path) -> None:
    path = Path(in_words(tmp_path))
    path.write_text(path.read_text().replace('"enabled", ', ""))
    with pytest.raises(BadInput, match="status_words: no word means enabled"):
        load_protocol(str(path))


@pytest.mark.parametrize("address", [None, "tcp://127.0.0.1:0"], ids=["serial", "TCP"])
@pytest.mark.parametrize("encoder", ["absolute", "incremental"])
def test_ensemble_homes_follows_and_stops(encoder: str, address: str | None) -> None:
    keys = {"encoder": encoder} | ({"home_deg": 1.0, "homing_rate_degps": 15.0} if encoder == "incremental" else {})
    with served("ensemble", listen=address, **keys) as (emulator, device, clock):
        if encoder == "incremental":
            device.home(clock.now_s())
            eventually(clock, lambda: set(device.read(clock.now_s()).homing) == {Homing.DONE})
        goal = np.radians((1.0, -2.0, 3.0))
        end_s = clock.now_s() + 3.0
        while clock.now_s() < end_s:
            device.send(goal, np.zeros(3), clock.now_s())
            clock.sleep(0.05)
        assert device.read(clock.now_s()).position == pytest.approx(goal, abs=1e-3)
        assert device.counters()["protocol_errors"] == device.counters()["lost"] == 0
        device.send(-3.0 * goal, np.zeros(3), clock.now_s())
        clock.sleep(0.2)
        device.stop(clock.now_s())
        eventually(clock, lambda: not any(emulator.gimbals.moving(axis) for axis in range(3)))


def test_fault_of_an_ensemble_is_named_by_its_flags() -> None:
    with served("ensemble") as (emulator, device, clock):
        emulator.faults.on("drive_fault", "pitch", 12.0)
        with pytest.raises(DriveFault, match=r"turntable\.pitch: limit of clockwise travel, limit of counter"):
            raise error_of(device, clock)


def test_status_without_a_fault_needs_the_fault_number(tmp_path) -> None:
    text = (configs_folder() / "protocols" / "aerotech-ensemble.toml").read_text()
    path = tmp_path / "table.toml"
    path.write_text(text.replace('    { send = "AXISFAULT(@{axis})", reply = "fault", each_axis = true },\n', ""))
    with pytest.raises(BadInput, match=r"status\.fault: is missing, and no reply to requests\.status has the fault"):
        load_protocol(str(path))
