"""Registers of a rail drive, as literal words."""

from __future__ import annotations

import pytest

from hil.config.tables.rail_map import RailMap
from hil.drivers.rails.codec import (
    Command,
    ControlFlags,
    DriveIdentity,
    Number,
    RegisterBlock,
    RegisterMap,
    State,
    Status,
)

DRIVE_MAP = RegisterMap(RailMap())


def test_command_fills_its_registers() -> None:
    command = Command(ControlFlags.ENABLE | ControlFlags.QUICK_STOP, 0xABCD, 11.999999, -0.25)
    registers = [0x0003, 0xABCD, 0x00B7, 0x1AFF, 0xFFFC, 0x2F70]
    assert DRIVE_MAP.encode_command(command) == registers
    assert DRIVE_MAP.decode_command(registers) == command


def test_state_is_read_from_its_registers() -> None:
    registers = [0x002E, 0x0003, 0x0007, 0xFFFF, 0xFFFF, 0x0000, 0x01F4]
    state = State(Status.ENABLED | Status.MOVING | Status.FAULT | Status.LIMIT, 3, 7, -1e-6, 0.0005)
    assert DRIVE_MAP.decode_state(registers) == state
    assert DRIVE_MAP.encode_state(state) == registers


def test_identity_is_checked() -> None:
    identity = DRIVE_MAP.decode_identity([0x4849, 0x4C52, 0x0102])
    assert identity == DriveIdentity(0x48494C52, (1, 2))
    assert DRIVE_MAP.encode_identity(identity) == [0x4849, 0x4C52, 0x0102]
    assert DRIVE_MAP.identity_problem(identity) is None
    assert DRIVE_MAP.identity_problem(DriveIdentity(0x12345678, (1, 2))) == "vendor 0x12345678, expected 0x48494C52"
    assert DRIVE_MAP.identity_problem(DriveIdentity(0x48494C52, (2, 5))) == "firmware 2.5, expected 1.x"


def test_blocks_have_the_addresses_of_the_manual() -> None:
    blocks = (DRIVE_MAP.command, DRIVE_MAP.state, DRIVE_MAP.identity)
    assert [(block.address, block.count) for block in blocks] == [(0, 6), (16, 7), (32, 3)]


def test_twelve_metres_are_resolved_to_half_a_micrometre() -> None:
    for position_m in (0.0, 1.2345678, 11.9999996, -3.3333333):
        words = DRIVE_MAP.encode_command(Command(ControlFlags.ENABLE, 0, position_m, 0.0))
        assert DRIVE_MAP.decode_command(words).position_m == pytest.approx(position_m, abs=0.5000001e-6)


def test_float_registers_carry_si() -> None:
    block = RegisterBlock(Number(100, "f32"), Number(102, "f64"), Number(106, "i16", 1000.0))
    registers = [0x3F80, 0x0000, 0x3FB9, 0x9999, 0x9999, 0x999A, 0xFFFB]
    assert block.encode((1.0, 0.1, -0.005)) == registers
    assert block.decode(registers) == (1.0, 0.1, -0.005)


def test_low_word_may_come_first() -> None:
    block = RegisterBlock(Number(100, "f32"), Number(102, "i32", 1000.0), Number(104, "u16"), little=True)
    assert block.encode((1.0, 65.537, 7.0)) == [0x0000, 0x3F80, 0x0001, 0x0001, 7]
    assert block.decode([0x0000, 0x3F80, 0x0001, 0x0002, 7]) == (1.0, 131.073, 7.0)


def test_registers_between_the_numbers_are_ignored() -> None:
    block = RegisterBlock(Number(20, "u16"), Number(10, "i16"))
    assert (block.address, block.count) == (10, 11)
    assert block.decode([0xFFFF, *[9] * 9, 5]) == (5.0, -1.0)


@pytest.mark.parametrize("words", [[0x7F80, 0], [0x7FC0, 1], [0xFF80, 0]])
def test_number_that_is_not_finite_is_refused(words: list[int]) -> None:
    with pytest.raises(ValueError, match=r"register 100 holds .*, expected a finite number"):
        RegisterBlock(Number(100, "f32")).decode(words)


def test_number_too_large_for_its_registers_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fit registers from 0"):
        DRIVE_MAP.encode_command(Command(ControlFlags.ENABLE, 0, 2500.0, 0.0))


def test_fault_code_is_readable() -> None:
    assert DRIVE_MAP.fault_text(3) == "fault 3, motor too hot"
    assert DRIVE_MAP.fault_text(99) == "fault 99, not in the list of fault codes"
