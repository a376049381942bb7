"""Bodies of chaser, target and bench along the plan; bodies that no file may have."""

from __future__ import annotations

import pytest

from hil.checks.bodies import check_bodies
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
