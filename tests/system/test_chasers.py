"""Ten chasers from a CubeSat of 6 kg to a space station of 400 t: each can fly its plan, may have a go, and flies it.

The flights take a minute of a core: ``pytest -m slow tests/system/test_chasers.py``.
"""

from __future__ import annotations

import pytest

import hil
from hil.checks.abort import check_abort
from hil.checks.compatibility import check_plan
from hil.checks.go_level import go_warnings
from hil.config.load import load_rig, load_scenario
from hil.parts.campaigns.api.benchmark import CHASERS

RIG = load_rig("mock")


@pytest.mark.parametrize("name", CHASERS)
def test_chaser_can_fly_its_plan_and_may_have_a_go(name: str) -> None:
    scenario = load_scenario(name)
    assert check_plan(scenario, RIG) == []
    assert check_abort(scenario) == []
    assert go_warnings(scenario.value, RIG.value) == []


def test_chasers_cover_five_decades_of_mass() -> None:
    masses = [load_scenario(name).value.chaser.mass_kg for name in CHASERS]
    assert masses == sorted(masses)
    assert (masses[0], masses[-1]) == (6.0, 400e3)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHASERS)
def test_chaser_is_accepted_and_no_device_is_accused(name: str) -> None:
    for seed in (1, 2):
        run = hil.run(name, seed=seed)
        assert run.accepted
        assert run.summary["decision"]["go_s"] is not None
        assert not int(run.navigation.health.max())
