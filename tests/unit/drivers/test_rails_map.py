"""Register maps of the rails: what a rig file may contain, and what is refused with its reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.config.load import load_rig
from hil.drivers.rails.codec import Command, ControlFlags, DriveIdentity, RegisterMap, State, Status
from hil.errors import BadInput, FaultKind

SHIPPED = RegisterMap(load_rig("emulated-rtu").value.rails.map)


def refusal(tmp_path: Path, text: str) -> str:
    """Return the one line that a rig file with ``text`` is refused with."""
    file = tmp_path / "lab.toml"
    file.write_text(f'extends = "emulated"\n{text}\n')
    with pytest.raises(BadInput) as caught:
        load_rig(str(file))
    (problem,) = caught.value.problems
    return str(problem).replace(str(file), "lab.toml")


def test_the_shipped_example_writes_its_numbers_low_word_first() -> None:
    command = Command(ControlFlags.ENABLE | ControlFlags.HOME, 7, 1.0, -0.5)  # 1000 mm, -500 mm/s
    assert (SHIPPED.command.address, SHIPPED.encode_command(command)) == (
        1000,
        [0b11000, 7, 0x0000, 0x447A, 0x0000, 0xC3FA],
    )
    assert SHIPPED.decode_command(SHIPPED.encode_command(command)) == command


def test_the_shipped_example_reads_its_numbers_low_word_first() -> None:
    registers = [0x102C, 0x0002, 0x4310, 99, 0x0000, 0x447A, 0xFFFF]
    state = SHIPPED.decode_state(registers)
    assert state == State(
        Status.ENABLED | Status.FAULT | Status.QUICK_STOP | Status.HOMED | Status.LIMIT_HIGH, 0x4310, 99, 1.0, -0.0001
    )
    assert SHIPPED.encode_state(state) == registers
    assert SHIPPED.fault_text(0x4310) == "fault 17168, motor too hot"


def test_an_older_firmware_is_refused() -> None:
    assert SHIPPED.identity_problem(DriveIdentity(0x0ABC, (2, 3))) is None
    assert SHIPPED.identity_problem(DriveIdentity(0x0ABC, (2, 2))) == "firmware 2.2, expected 2.3 or newer"


def test_a_drive_without_exchange_numbers_needs_no_registers_for_them(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text(
        'extends = "emulated"\n[rails.map]\nnumbered = false\n'
        "[rails.map.command]\nposition = { address = 1 }\nrate = { address = 3 }\n"
    )
    plain = RegisterMap(load_rig(str(file)).value.rails.map)
    assert plain.echo_at is None
    assert plain.encode_command(Command(ControlFlags.ENABLE, 5, 0.001, 0.0)) == [1, 0, 1000, 0, 0]
    assert plain.decode_state([1, 0, 77, 0, 1000, 0, 0]).position_m == 0.001


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "rails.map.state.echo = { address = 20 }",
            "lab.toml: rig.rails.map: state.position.address 19: register 20 is state.echo, "
            "allowed: registers of its own",
        ),
        (
            "rails.map.identity.version = { address = 5 }",
            "lab.toml: rig.rails.map: identity.version.address 5: register 5 is command.rate, "
            "allowed: registers of its own",
        ),
        (
            'rails.map.state.position = { address = 19, type = "f16" }',
            "lab.toml: rig.rails.map.state.position.type: \"f16\": must be 'u16', 'i16', 'u32', 'i32', 'f32' or 'f64'",
        ),
        (
            "rails.map.state.fault = { address = 400 }",
            "lab.toml: rig.rails.map: state: 385 registers in one transaction, allowed 1 to 125",
        ),
        (
            "rails.map.command.rate = { address = 6 }",
            "lab.toml: rig.rails.map: command: register 4 would be written and is no number, allowed: no gap",
        ),
        (
            "rails.map.state.status = { address = 70000 }",
            "lab.toml: rig.rails.map.state.status.address: 70000: must be less than or equal to 65535",
        ),
        (
            'rails.map.identity.vendor = { address = 65535, type = "u32" }',
            "lab.toml: rig.rails.map: identity.vendor.address 65535: u32 ends beyond 65535, the last register",
        ),
        (
            "rails.map.control_bits.quick_stop = 0",
            "lab.toml: rig.rails.map: control_bits.quick_stop 0: this bit is enable, allowed: a bit of its own, or -1",
        ),
        (
            "rails.map.status_bits.homed = 16",
            "lab.toml: rig.rails.map: status_bits.homed 16: the word is u16, allowed 0 to 15",
        ),
        (
            "rails.map.status_bits.fault = -1",
            "lab.toml: rig.rails.map: status_bits.fault -1: the drive must have it, allowed 0 to 15",
        ),
        (
            'rails.map.command.position = { address = 2, unit = "km" }',
            "lab.toml: rig.rails.map.command.position.unit: \"km\": must be 'm', 'mm' or 'um'",
        ),
        (
            "rails.map.command.position = { address = 2, scale = 0.001 }",
            "lab.toml: rig.rails: x.travel_m [-0.2, 12.0]: map.command.position (i32, 0.001 um per count) "
            "holds -2.14748 to 2.14748 m",
        ),
        (
            'rails.map.control_bits.home = -1\nrails.x.encoder = "incremental"',
            'lab.toml: rig.rails: x.encoder = "incremental" needs map.control_bits.home and map.status_bits.homed',
        ),
        (
            'rails.driver = "modbus_rtu"\nrails.rtu.baud = 9600',
            "lab.toml: rig.rails: timeout_s 0.4: too short for 3 drives at 9600 baud with one retry, "
            "allowed 0.58 or more",
        ),
        (
            'rails.driver = "modbus_rtu"\nrails.rtu.device_ids = [1, 2, 1]',
            "lab.toml: rig.rails.rtu: device_ids [1, 2, 1] must differ from each other",
        ),
        (
            "rails.modbus.x.port = 502\nrails.modbus.y.port = 502",
            "lab.toml: rig.rails: modbus: two axes have the same host, port and device_id, allowed: different ones",
        ),
        (
            'rails.map.faults = { hot = "motor too hot" }',
            'lab.toml: rig.rails.map.faults.hot: "hot": string should match pattern '
            "'^(0x[0-9a-fA-F]{1,8}|[0-9]{1,10})$'",
        ),
        (
            'rails.map = { torque_off = 8, faults = { 2 = "over-current", 0x5441 = "STO active" } }',
            "lab.toml: rig.rails.map: torque_off 8: no such code in faults, allowed: 2, 0x5441, -1",
        ),
        (
            "rails.map.functions = [3, 16]",
            "lab.toml: rig.rails.map: functions [3, 16]: allowed [23], [16, 3], [6, 3]",
        ),
        (
            "rails.map.functions = [6, 3]",
            "lab.toml: rig.rails.map: command.position.type i32: function 6 writes one register at a time, a number in "
            "several would be torn; allowed u16, i16",
        ),
        (
            "rails.map.torque_off = -2",
            "lab.toml: rig.rails.map.torque_off: -2: must be greater than or equal to -1",
        ),
    ],
)
def test_a_bad_map_is_refused_with_key_value_and_what_is_allowed(tmp_path: Path, text: str, line: str) -> None:
    assert refusal(tmp_path, text) == line


@pytest.mark.parametrize(
    ("text", "code", "kind"),
    [
        ("", 7, FaultKind.TORQUE_OFF),
        ("", 6, FaultKind.OTHER),
        ("torque_off = 0x21\nfaults = { 0x21 = 'STO active', 7 = 'safe torque off' }", 0x21, FaultKind.TORQUE_OFF),
        ("torque_off = 0x21\nfaults = { 0x21 = 'STO active', 7 = 'safe torque off' }", 7, FaultKind.OTHER),
        ("torque_off = -1", 7, FaultKind.OTHER),
        ("faults = { 2 = 'over-current' }", 7, FaultKind.OTHER),
    ],
)
def test_torque_off_is_identified_by_its_code_whatever_it_is_called(
    tmp_path: Path, text: str, code: int, kind: FaultKind
) -> None:
    file = tmp_path / "lab.toml"
    file.write_text(f'extends = "emulated"\n[rails.map]\n{text}\n')
    assert RegisterMap(load_rig(str(file)).value.rails.map).fault_kind(code) is kind


def test_a_drive_without_torque_off_reports_another_fault(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text('extends = "emulated"\n[rails.map]\ntorque_off = -1\nfaults = { 3 = "hot" }\n')
    register_map = RegisterMap(load_rig(str(file)).value.rails.map)
    assert [register_map.code_of(kind) for kind in (FaultKind.TORQUE_OFF, FaultKind.OTHER)] == [3, 3]
    assert [SHIPPED.code_of(kind) for kind in (FaultKind.TORQUE_OFF, FaultKind.OTHER)] == [0x5441, 0x2310]
