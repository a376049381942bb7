"""Division of a motion between the chaser's rig and a rotary manipulator: what either and both can show."""

from __future__ import annotations

import pytest

from hil.errors import BadInput, Problem
from hil.session.build import check
from tests.support.run_settings import make_job

ALONE, BOTH = "mock", "mock-manipulator"
SLOW_RAILS = "rig.rails.y.rate_max_mps=0.12"  # 3 deg/s at 3 m are 0.157 m/s
NARROW = ("initial.attitude_deg=[0, 0, 15]", "rig.turntable.yaw.travel_deg=[-12, 12]")


def problems(scenario: str, rig: str, *settings: str) -> list[Problem]:
    """Return what is refused of a run."""
    try:
        check(make_job(1.0, settings, scenario=scenario, rig=rig))
    except BadInput as error:
        return error.problems
    return []


def test_tumble_that_the_chaser_s_rig_cannot_show_passes_with_a_manipulator() -> None:
    (problem,) = problems("tumbling-3", ALONE, SLOW_RAILS)
    assert problem.key == "target.rate_degps"
    assert "would move at 0.157 m/s in the target's axes, allowed 0.12 m/s by rig.rails.y.rate_max_mps" in str(problem)
    assert problems("tumbling-3", BOTH, SLOW_RAILS) == []


@pytest.mark.parametrize("axis", ["roll", "pitch", "yaw"])
def test_tumble_that_both_cannot_show_names_both_axes_value_and_limits(axis: str) -> None:
    slow = f"rig.rotary_manipulator.{axis}.rate_max_degps"
    (problem,) = problems("tumbling-3", BOTH, SLOW_RAILS, f"{slow}=0.5")
    assert problem.key == "target.rate_degps"
    assert problem.message == (
        "[0.45, 0.6, 2.9]: a chaser that coasts at 3.00 m would move at 0.131 m/s in the lab (3 deg/s less "
        f"0.5 deg/s by {slow}, which shows the rest), allowed 0.12 m/s by rig.rails.y.rate_max_mps"
    )
    assert problems("tumbling-3", BOTH, SLOW_RAILS, f"{slow}=0.8") == []  # 2.2 deg/s are left, 0.115 m/s


def test_attitude_beyond_the_turntable_passes_where_the_manipulator_shows_a_part_of_it() -> None:
    (problem,) = problems("scheme-1", ALONE, *NARROW)
    assert "turntable.yaw would go to 16.01 deg (planned 15.00 deg)" in problem.message
    assert problems("scheme-1", BOTH, *NARROW, "rig.rotary_manipulator.yaw.travel_deg=[-5, 5]") == []


def test_attitude_beyond_both_names_the_axis_value_limit_and_the_manipulator_s_angles() -> None:
    (problem,) = problems("scheme-1", BOTH, *NARROW, "rig.rotary_manipulator.yaw.travel_deg=[-2, 2]")
    assert problem.key == "initial.attitude_deg"
    assert problem.message == (
        "turntable.yaw would go to 14.01 deg (planned 13.00 deg) at 0.0 s with rotary_manipulator at roll 0.0, "
        "pitch 0.0, yaw -2.0 deg, allowed -12 to 12 deg by rig.turntable.yaw.travel_deg"
    )


def test_whole_attitude_shown_by_the_manipulator_moves_the_rails_by_the_range() -> None:
    (problem,) = problems("scheme-1", BOTH, *NARROW)
    assert "rails.y would go to -1.750 m" in problem.message
    assert "with rotary_manipulator at roll 0.0, pitch 0.0, yaw -15.0 deg, allowed -1.5 to 1.5 m" in problem.message
