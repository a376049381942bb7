"""Protocol files: what is refused, with which sentence, and what is warned of."""

from __future__ import annotations

import pytest

from hil.config.load import configs_folder, load_protocol, load_rig, shipped
from hil.core.clock import WallClock
from hil.drivers.turntable.ascii.driver import AsciiTurntable
from hil.drivers.turntable.ascii.protocol import DEVICE, AsciiProtocol
from hil.errors import BadInput, FaultKind


def altered(tmp_path, old, new, base="hil-ascii"):
    text = (configs_folder() / "protocols" / f"{base}.toml").read_text()
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new, 1))
    return str(path)


def test_shipped_protocols_are_found_by_name():
    assert shipped("protocols") == ["acu", "aerotech-ensemble", "hil-ascii"]
    with pytest.raises(
        BadInput, match="unknown protocol: give acu, aerotech-ensemble, hil-ascii or the path of a protocol file"
    ):
        load_protocol("nmea")


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('kind = "crc16-ccitt"', 'kind = "crc32"', r"checksum\.kind: \"crc32\": must be 'none', 'sum8', 'xor8' or"),
        ("{rate.yaw}", "{speed.yaw}", r"requests\.set: send: \{speed\.yaw\}: unknown field here, allowed: \{position"),
        ("{rate.yaw}", "{rate", r"requests\.set.*SET"),
        (
            '"IDN", reply = "identity"',
            '"IDN", reply = "ident"',
            r"requests\.identify: reply 'ident': allowed",
        ),
        (
            "{position.roll} {position.pitch}",
            "{position.pitch}",
            r"requests\.set: sends no position of roll",
        ),
        ("OK {status.roll}", "OK 00", r"requests\.status: no reply has the status of roll"),
        (
            'unit = "deg"',
            'unit = "rad"',
            r"fields\.position\.unit: \"rad\": must be 'deg', 'mdeg'",
        ),
        ('unit = "deg"', 'unit = "counts"', r"counts_per_turn: is missing: fields are in counts and degps"),
        ("homing = 0x10", "", r"requests\.home: needs status\.homing"),
        ("enabled = 0x01", "", r"status\.enabled: is missing"),
        ("0x0001 = ", '"x1" = ', r"faults\.names: .*must be whole numbers"),
        (
            "torque_off = 0x0100",
            "torque_off = 0x0200",
            r"faults\.torque_off: 512: allowed are the numbers in \[faults\.names\]: 0x0001, 0x0002, .*0x0100$",
        ),
        ("digits = 2", "digit = 2", r"sequence\.digit: unknown key: did you mean digits"),
    ],
)
def test_bad_protocol_file_is_refused_with_file_key_and_allowed(tmp_path, old, new, problem):
    path = altered(tmp_path, old, new)
    with pytest.raises(BadInput, match=problem) as caught:
        load_protocol(path)
    assert str(caught.value).startswith(path)


def test_command_set_without_its_protections_is_warned_of(tmp_path):
    assert load_protocol("hil-ascii").value.warnings() == []
    (line,) = load_protocol("acu").value.warnings()
    assert line == "protocol acu: no sequence number: a late reply can be mistaken for a new one"
    bare = load_protocol(altered(tmp_path, 'kind = "xor8"', 'kind = "none"', "acu")).value
    assert bare.warnings()[1] == "protocol acu: no checksum: a corrupted line can be accepted"


def test_counts_and_another_checksum_need_no_code(tmp_path):
    text = (configs_folder() / "protocols" / "acu.toml").read_text()
    for old, new in (
        ('name = "acu"', 'name = "mine"\ncounts_per_turn = 3600000'),
        ('unit = "mdeg", decimals = 3', 'unit = "counts"'),
        ('unit = "mdegps", decimals = 3', 'unit = "countsps"'),
        ('kind = "xor8"', 'kind = "sum8"'),
    ):
        text = text.replace(old, new)
    (tmp_path / "mine.toml").write_text(text)
    dialect = AsciiProtocol(load_protocol(str(tmp_path / "mine.toml")).value)
    values = {("position", 2): 0.017453292519943295, ("rate", 2): 0.0}
    body = "PA3=10000;VA3=0;"
    assert dialect.request(0, dialect.lines["set"][0], 2, values) == f"{body}^{sum(body.encode()) % 256:02X}\r".encode()


def test_controller_without_torque_off_has_no_such_fault(tmp_path):
    path = altered(tmp_path, "torque_off = 0x0100", "")
    assert AsciiProtocol(load_protocol(path).value).fault_kind(0x0100) is FaultKind.OTHER


def test_rig_file_names_a_protocol_file_in_its_folder(tmp_path):
    altered(tmp_path, "x", "x")
    rig = tmp_path / "rig.toml"
    rig.write_text(
        'extends = "emulated"\nname = "r"\n[turntable]\ndriver = "ascii"\n[turntable.ascii]\nprotocol = "mine.toml"\n'
    )
    assert load_rig(str(rig)).value.turntable.ascii.protocol == str(tmp_path / "mine.toml")


def test_axis_that_must_home_needs_a_command_for_it(tmp_path):
    path = altered(tmp_path, 'home = [{ send = "HOM", reply = "report" }]', "")
    rig = load_rig(
        "emulated",
        [
            "rig.turntable.driver=ascii",
            "rig.turntable.ascii.port=/nowhere",
            f"rig.turntable.ascii.protocol={path}",
            "rig.turntable.pitch.encoder=incremental",
        ],
    ).value
    with pytest.raises(
        BadInput, match=r'turntable\.pitch\.encoder: "incremental": protocol hil-ascii .* has no requests'
    ):
        AsciiTurntable(rig.turntable, WallClock())


def test_ignored_field_takes_whatever_stands_there(tmp_path):
    path = altered(tmp_path, '"IDN {model} {serial} 3"', '"IDN {model} {ignore} 3"')
    dialect = AsciiProtocol(load_protocol(path).value)
    told = dialect.decode_reply("IDN X some words here 3", dialect.lines["identify"][0], DEVICE)
    assert told["model", DEVICE] == "X"
