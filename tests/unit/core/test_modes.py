"""Which mode may follow which."""

from __future__ import annotations

from itertools import product

import pytest

from hil.core.modes import ALLOWED, Mode, ModeMachine
from hil.errors import BenchError

FORWARD = {
    (Mode.OFF, Mode.STANDBY),
    (Mode.STANDBY, Mode.HOMING),
    (Mode.STANDBY, Mode.JOGGING),
    (Mode.STANDBY, Mode.PLACING),
    (Mode.STANDBY, Mode.PARKING),
    (Mode.PLACING, Mode.ARMED),
    (Mode.ARMED, Mode.RUNNING),
    (Mode.PLACING, Mode.HOLD),
    (Mode.RUNNING, Mode.HOLD),
}
BACK = {
    (Mode.STANDBY, Mode.OFF),
    (Mode.HOMING, Mode.STANDBY),
    (Mode.JOGGING, Mode.STANDBY),
    (Mode.PLACING, Mode.STANDBY),
    (Mode.ARMED, Mode.STANDBY),
    (Mode.RUNNING, Mode.STANDBY),
    (Mode.PARKING, Mode.STANDBY),
    (Mode.HOLD, Mode.STANDBY),
    (Mode.SAFE_STOP, Mode.OFF),
}
RESUME = {(Mode.HOLD, Mode.PLACING), (Mode.HOLD, Mode.RUNNING)}
STOP = {(mode, Mode.SAFE_STOP) for mode in Mode}


@pytest.mark.parametrize(("here", "to"), list(product(Mode, Mode)))
def test_every_pair_of_modes_is_allowed_or_refused_as_in_the_table_of_moves(here: Mode, to: Mode) -> None:
    machine = ModeMachine()
    machine.mode = here
    machine.held_from = to  # where a hold came from
    if (here, to) in FORWARD | BACK | STOP | RESUME:
        machine.go(to)
        assert machine.mode is to
    else:
        with pytest.raises(BenchError, match=f"bench: cannot go from {here.value} to {to.value}"):
            machine.go(to)
        assert machine.mode is here


def test_every_mode_may_go_to_safe_stop_and_only_off_leads_out() -> None:
    assert all(Mode.SAFE_STOP in allowed for allowed in ALLOWED.values())
    assert ALLOWED[Mode.SAFE_STOP] - {Mode.SAFE_STOP} == {Mode.OFF}


@pytest.mark.parametrize("interrupted", [Mode.PLACING, Mode.RUNNING])
def test_a_hold_leads_back_only_to_what_it_interrupted(interrupted: Mode) -> None:
    for to in (Mode.PLACING, Mode.RUNNING):
        machine = ModeMachine()
        machine.mode = interrupted
        machine.go(Mode.HOLD)
        if to is interrupted:
            machine.go(to)
            assert machine.held_from is None
        else:
            with pytest.raises(BenchError, match=f"cannot go from hold to {to.value}"):
                machine.go(to)


def test_running_is_reached_only_from_armed_and_from_its_own_hold() -> None:
    assert [mode for mode in Mode if Mode.RUNNING in ALLOWED[mode]] == [Mode.ARMED, Mode.HOLD]


def test_only_standby_comes_after_the_devices_were_opened() -> None:
    assert ALLOWED[Mode.OFF] == {Mode.STANDBY, Mode.SAFE_STOP}


def test_table_of_moves_has_a_row_for_each_mode() -> None:
    assert set(ALLOWED) == set(Mode)


def test_machine_starts_off() -> None:
    assert ModeMachine().mode is Mode.OFF
