"""The least level of a go: below that of a flight, and reported before a run whose requirement is tighter."""

from __future__ import annotations

import numpy as np
import pytest

from hil.checks.go_level import go_warnings, least_levels
from hil.config.load import load_rig, load_scenario
from hil.parts.campaigns.case_runner import CaseRunner

RIG = load_rig("mock").value
RANGE_FINDER = (
    'sensors.range={kind="range_finder"}',
    "requirements.radial_distance_m=0.002",
)


@pytest.mark.xdist_group("campaign")
@pytest.mark.parametrize("name", ["scheme-1", "scheme-2"])
def test_the_levels_of_a_flight_are_above_the_least_ones_and_near_them(name: str) -> None:
    scenario = load_scenario(name).value
    runner = CaseRunner(scenario, RIG, scenario.duration_s)
    runner.run(scenario, 3)
    flown = np.array(runner._state.gnc.navigation.integrity.go_m)
    least, _, _ = least_levels(scenario, RIG)
    assert (flown > least).all()
    assert (flown < 2.0 * least).all()


def test_a_requirement_that_is_tighter_is_named_with_both_numbers() -> None:
    scenario = load_scenario("scheme-1", ("requirements.radial_distance_m=0.002",)).value
    (line,) = go_warnings(scenario, RIG)
    assert (
        line == "requirements.radial_distance_m = 0.002: the level of a go is 0.0038 m at least, so there will be none"
    )


def test_a_firing_that_exceeds_a_rate_is_named_for_the_axes_that_a_planar_chaser_turns_about() -> None:
    scenario = load_scenario("planar", ("requirements.angular_rate_degps=0.001",)).value
    (line,) = (line for line in go_warnings(scenario, load_rig("mock-planar").value) if "angular_rate" in line)
    assert line.startswith("requirements.angular_rate_degps = 0.001: the smallest firing changes the rate about y by ")
    assert line.endswith(" deg/s, a go allows 0.00075, so there will be none")


@pytest.mark.parametrize("settings", [(), RANGE_FINDER, ("gnc.navigation.backend=vision_alone",)])
def test_no_warning_for_a_reachable_or_unknown_level(settings: tuple[str, ...]) -> None:
    assert go_warnings(load_scenario("scheme-1", settings).value, RIG) == []
