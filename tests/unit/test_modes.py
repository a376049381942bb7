"""Which mode may follow which."""

from __future__ import annotations

from itertools import product

import pytest

from hil.errors import BenchError
from hil.modes import ALLOWED, Mode, ModeMachine

FORWARD = {
    (Mode.OFF, Mode.STANDBY),
    (Mode.STANDBY, Mode.PLACING),
    (Mode.PLACING, Mode.ARMED),
    (Mode.ARMED, Mode.RUNNING),
}
BACK = {
    (Mode.STANDBY, Mode.OFF),
    (Mode.PLACING, Mode.STANDBY),
    (Mode.ARMED, Mode.STANDBY),
    (Mode.RUNNING, Mode.STANDBY),
    (Mode.SAFE_STOP, Mode.OFF),
}
STOP = {(mode, Mode.SAFE_STOP) for mode in Mode}


@pytest.mark.parametrize(("here", "to"), list(product(Mode, Mode)))
def test_every_pair_of_modes_is_allowed_or_refused_as_the_table_of_moves_says(here: Mode, to: Mode) -> None:
    machine = ModeMachine()
    machine.mode = here
    if (here, to) in FORWARD | BACK | STOP:
        machine.go(to)
        assert machine.mode is to
    else:
        with pytest.raises(BenchError, match=f"bench: cannot go from {here.value} to {to.value}"):
            machine.go(to)
        assert machine.mode is here


def test_every_mode_may_go_to_safe_stop_and_only_off_leads_out() -> None:
    assert all(Mode.SAFE_STOP in allowed for allowed in ALLOWED.values())
    assert ALLOWED[Mode.SAFE_STOP] - {Mode.SAFE_STOP} == {Mode.OFF}


def test_running_is_reached_only_from_armed() -> None:
    assert [mode for mode in Mode if Mode.RUNNING in ALLOWED[mode]] == [Mode.ARMED]


def test_machine_starts_off() -> None:
    assert ModeMachine().mode is Mode.OFF
