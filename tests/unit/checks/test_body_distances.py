"""Bodies of chaser, target and bench along the plan; bodies that no file may have."""

from __future__ import annotations

import numpy as np
import pytest

from hil.checks.bodies import _chaser, _Nearest, _points, check_bodies
from hil.checks.planned_trajectory import moments
from hil.checks.reachability import position_margin
from hil.config.load import load_rig, load_scenario
from hil.errors import BadInput

MAST = '{on = "target", vertices_m = [[0.1, 0.0, -1.0], [0.1, 0.0, 1.0]], radius_m = 0.02}'


def camera(reach_m: float) -> str:
    return f'{{on = "chaser", vertices_m = [[0.0, -0.1, 0.0], [0.0, 0.1, 0.0], [-{reach_m}, 0.0, 0.0]]}}'


def keep_out(reach_m: float) -> str:
    return f"keep_out.bodies=[{MAST}, {camera(reach_m)}]"


DISTANCE = "keep_out.distance_m=0.05"


def bench(reach_m: float) -> tuple[str, ...]:
    arm = f'{{on = "turntable", vertices_m = [[0.0, 0.0, 0.0], [-{reach_m}, 0.0, 0.0]]}}'
    ring = '{on = "lab", vertices_m = [[0.1, 0.0, -1.0], [0.1, 0.0, 1.0]], radius_m = 0.02}'
    return (f"rig.bench.bodies=[{arm}, {ring}]",)


def test_plan_keeps_bodies_apart_or_is_refused() -> None:
    rig = load_rig("mock")
    assert check_bodies(load_scenario("scheme-1"), rig) == []
    assert check_bodies(load_scenario("scheme-1", (keep_out(0.1), DISTANCE)), rig) == []
    (problem,) = check_bodies(load_scenario("scheme-1", (keep_out(0.18), DISTANCE)), rig)
    assert problem.key == "keep_out.bodies"
    assert problem.message.startswith("2 and 1 would be 0.0")
    assert problem.message.endswith("with the band about the plan and after braking; allowed 0.05 m or more")
    nearer = load_scenario("scheme-1", (keep_out(0.18), "keep_out.distance_m=0.001"))
    assert check_bodies(nearer, rig) == []


def test_plan_keeps_the_bench_apart_or_is_refused() -> None:
    scenario = load_scenario("scheme-1")
    assert check_bodies(scenario, load_rig("mock", bench(0.1))) == []
    (problem,) = check_bodies(scenario, load_rig("mock", bench(0.3)))
    assert problem.key == "rig.bench.bodies"
    assert problem.message.startswith("1 and 2 would be ")


@pytest.mark.parametrize(
    ("bodies", "text"),
    [
        (MAST, 'all have on = "target", allowed is "target" together with one that moves'),
        (", ".join([MAST, *[camera(0.1)] * 9]), 'bodies: 9 with on = "chaser", allowed 8'),
        ('{on = "chaser", vertices_m = []}', "keep_out.bodies[0].vertices_m: []: must have at least 1 item, not 0"),
        (f'{MAST}, {{on = "chaser", vertices_m = [{", ".join(["[0.0, 0.0, 0.0]"] * 17)}]}}', "at most 16"),
        (f'{MAST}, {{on = "moon", vertices_m = [[0.0, 0.0, 0.0]]}}', "'chaser' or 'target'"),
        (f'{MAST}, {{on = "chaser", vertices_m = [[0.0, 0.0, nan]]}}', "finite"),
    ],
)
def test_bodies_that_are_none_are_refused_with_key_and_value(bodies: str, text: str) -> None:
    with pytest.raises(BadInput) as refused:
        load_scenario("scheme-1", (f"keep_out.bodies=[{bodies}]",))
    assert text in str(refused.value)
    assert "keep_out" in str(refused.value)


def test_spheres_about_bodies_bound_their_distance_from_below() -> None:
    """The check computes distances from the least bound on, and stops at the first bound beyond the least distance.

    Of bodies that are spheres the bound is the distance of a chaser that approaches them head-on.
    """
    ball = '{{on = "{}", vertices_m = [[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0]], radius_m = 0.1}}'.format
    balls = [f"keep_out.bodies=[{ball('target')}, {ball('chaser')}]"]
    brake_mps2, arm_m = 0.001, np.array([0.3, 0.1, -0.2])
    for settings, lever_arm_m, is_tight in (((), None, False), ((), arm_m, False), (balls, None, True)):
        given = load_scenario("scheme-1", [*settings, "reachability.attitude_margin_deg=5.0"]).value
        plan = moments(given)
        points = _points(plan, position_margin(given, np.array([moment.far_m for moment in plan])))
        nearest = _Nearest(given, _chaser(given), brake_mps2, lever_arm_m)
        every = range(0, len(points.r), 7)
        above = np.array([nearest.at(points, k)[0] for k in every]) - nearest.bounds(points)[::7]
        assert above.min() >= -1e-9
        assert bool(above.min() < 1e-4) is is_tight
