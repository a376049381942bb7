"""Check of a plan in the axes of a target that tumbles: thrust and motion of the rig."""

from __future__ import annotations

import numpy as np
import pytest

from hil.checks import target_motion
from hil.checks.target_motion import THRUST_FRACTION, check_target_motion, plan_accelerations, planned, tumble_over
from hil.checks.truth import check_truth
from hil.config.load import load_rig, load_scenario
from hil.errors import BadInput
from hil.params import gnc as gnc_params
from hil.parts.campaigns.dispersions import Design
from tests.support.plain_filters import PLAIN

SLOW = tuple(
    f"gnc.{key}=0.004"
    for key in ("guidance.deceleration_mps2", "guidance.acceleration_mps2", "abort.acceleration_mps2")
)


@pytest.mark.parametrize("name", ["tumbling-1", "tumbling-3", "tumbling-5"])
def test_shipped_scenarios_take_at_most_the_allowed_thrust(name: str) -> None:
    loaded = load_scenario(name)
    assert check_target_motion(loaded, load_rig("mock")) == []
    needed, _ = plan_accelerations(planned(loaded.value), *tumble_over(loaded.value))
    _, strength = gnc_params.allocation(loaded.value.chaser)
    assert (needed <= THRUST_FRACTION * strength[:3] / loaded.value.chaser.mass_kg).all()


def test_centripetal_acceleration_at_rest_is_that_of_the_circle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target_motion, "_INTERVAL_S", 100.0)  # of a plan of days
    settings = ("target.rate_degps=[0.0, 0.0, 3.0]", "target.principal_axes_deg=[0.0, 0.0, 0.0]")
    still = (
        "initial.position_m=[3.0, 0.0, 0.0]",
        "gnc.guidance.acceleration_mps2=1e-9",
        "gnc.abort.hold_distance_m=0.4",
    )
    scenario = load_scenario("tumbling-3", (*settings, *still, "gnc.guidance.approach_speed_mps=1e-5")).value
    needed, ranges = plan_accelerations(planned(scenario), np.radians([[0.0, 0.0, 3.0]]), np.zeros((1, 3)))
    assert needed[0] == pytest.approx(np.radians(3.0) ** 2 * 3.0, rel=1e-3)
    assert ranges[0] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            ("target.rate_degps=[0.9, 1.2, 5.8]",),
            ("% of what chaser.thrusters give, allowed 60 %", "along x at 3.00 m"),
        ),
        (("target.rate_degps=[1.5, 2.0, 9.7]",), ("a chaser that coasts at 3.00 m", "rig.rails.y.rate_max_mps")),
        (("chaser.thrusters.force_n=5.0",), ("% of what chaser.thrusters give, allowed 60 %",)),
    ],
)
def test_target_that_tumbles_too_fast_is_rejected_in_one_line(
    settings: tuple[str, ...], words: tuple[str, ...]
) -> None:
    (problem,) = check_target_motion(load_scenario("tumbling-3", settings), load_rig("mock"))
    assert "target.rate_degps: [" in str(problem)
    assert all(word in str(problem) for word in words)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ((), "; for a target at rest 80 %, by gnc.guidance.deceleration_mps2"),
        (SLOW[:2], "; for a target at rest 60 %, by gnc.abort.acceleration_mps2"),
        (SLOW, ""),
    ],
)
def test_plan_that_takes_too_much_without_the_rotation_is_named_by_its_key(
    settings: tuple[str, ...], words: str
) -> None:
    flat = ("target.motion=tumble", "target.rate_degps=[0.0, 0.1, 0.0]", "truth.relative_motion=nonlinear")
    scenario = load_scenario("planar", (*flat, *settings))
    assert check_truth(scenario) == []
    problems = check_target_motion(scenario, load_rig("mock-planar"))
    assert [str(each).endswith(words) for each in problems] == ([True] if words else [])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("target.motion=spin",), "target.motion"),
        (("target.rate_degps=[0.0, 0.0, 40.0]",), "target.rate_degps"),
        (("target.moments_kg_m2=[1.0, 1.0, 3.0]",), "must not exceed the sum of the others"),
        (("truth.relative_motion=hill",), "nonlinear"),
        ((*PLAIN, "gnc.shadow.enabled=true"), "does not go with gnc.shadow.enabled"),
        (("target.motion=aligned",), "rate_degps does not go with"),
        (("target.limit_cycle.rate_degps=[-0.1, 0.0, 0.0]",), "target.limit_cycle.rate_degps"),
        (("gnc.guidance.phases.approach.kind=slew",), "needs attitude_deg"),
        (("gnc.guidance.phases.approach.kind=fly_around",), "needs point_m"),
    ],
)
def test_motion_that_is_none_is_rejected(settings: tuple[str, ...], words: str) -> None:
    with pytest.raises(BadInput) as caught:
        load_scenario("tumbling-3", settings)
    assert words in str(caught.value)


def test_negative_spread_of_the_tumble_is_rejected() -> None:
    loaded = load_scenario("tumbling-3", ('dispersions.target.rate_degps={ kind = "normal", sigma = -0.1 }',))
    with pytest.raises(BadInput, match="must not be negative"):
        Design(loaded, 0)
