"""Rails of the target: with the chaser's they show exactly the relative position, by a stated rule."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench import manipulator
from hil.bench.manipulator import ChaserMotion
from hil.config.load import load_rig
from hil.config.motion_digest import motion_digest
from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths import quat
from hil.params import bench as bench_params

RIG = "mock-two-vehicles"
PATH = (
    'rig.target_manipulator.sharing="path"',
    "rig.target_manipulator.path_s=[10.0, 20.0]",
    "rig.target_manipulator.path_m=[[0.0, 0.0, 0.0], [-1.0, 0.5, 0.0]]",
)
VECTORS = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)
REST, STRAIGHT = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])


def parts(settings: tuple[str, ...] = ()) -> tuple[np.record, np.record, np.record]:
    rig = load_rig(RIG, settings).value
    params = bench_params.manipulator(rig)
    assert params is not None
    return params, bench_params.bench(rig, 0.02), bench_params.manipulator_limits(rig, 0.02)


@given(VECTORS, VECTORS, VECTORS, VECTORS)
def test_both_vehicles_together_show_the_wanted_position_and_velocity(
    at: Array, rate: Array, r: Array, v: Array
) -> None:
    params, _, _ = parts()
    q = quat.from_rotation_vector(np.array([0.0, 0.3, 0.0]))
    shown = manipulator.shown_motion(params, at, rate, ChaserMotion(r, v, q, REST))
    np.testing.assert_allclose(manipulator.relative_pose(params, at, shown.r, shown.q)[0], r, atol=1e-12)
    later = manipulator.shown_motion(params, at + 1e-3 * rate, rate, ChaserMotion(r + 1e-3 * v, v, q, REST))
    np.testing.assert_allclose(later.r - shown.r, 1e-3 * shown.v, atol=1e-12)


@pytest.mark.parametrize("x_m", [-0.6, 0.3, 2.0, 5.9])
def test_both_vehicles_have_the_same_fraction_of_their_travel_left(x_m: float) -> None:
    params, bench, limits = parts()
    relative = ChaserMotion(np.array([x_m, 0.0, 0.4]), np.array([-0.2, 0.0, 0.0]), STRAIGHT, REST)
    at, rates = manipulator.wanted_axes(params, bench, relative, REST)
    shown = manipulator.shown_motion(params, at, rates, relative)
    rails = params.to_H.T @ shown.r  # the lever arm is zero
    for axis in (0, 1):
        chaser = (rails[axis] - bench.low[axis]) / (bench.high[axis] - bench.low[axis])
        target = (limits.high[axis] - at[axis]) / (limits.high[axis] - limits.low[axis])
        assert chaser == pytest.approx(target, abs=1e-12)
        assert -1e-9 <= chaser <= 1.0 + 1e-9
    speeds = np.abs([rates[0], shown.v[0]])
    assert speeds.sum() == pytest.approx(0.2)
    assert speeds.min() > 0.08


@pytest.mark.parametrize(
    ("t_s", "x_m", "speed_mps"), [(0.0, 0.0, 0.0), (10.0, 0.0, 0.1), (15.0, -0.5, 0.1), (20.0, -1.0, 0.0)]
)
def test_target_follows_its_path_and_stands_before_and_after_it(t_s: float, x_m: float, speed_mps: float) -> None:
    params, bench, _ = parts(PATH)
    relative = ChaserMotion(np.array([3.0, 0.0, 0.4]), REST, STRAIGHT, REST, t_s)
    at, rates = manipulator.wanted_axes(params, bench, relative, REST)
    assert at[0] == pytest.approx(x_m)
    assert abs(rates[0]) == pytest.approx(speed_mps)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (PATH[:1], "path_s: allowed with sharing"),
        (PATH[1:], "path_s: allowed with sharing"),
        ((*PATH[:2], "rig.target_manipulator.path_m=[[0.0, 0.0, 0.0]]"), "with a point of path_m for each"),
        ((PATH[0], "rig.target_manipulator.path_s=[9.0, 9.0]", PATH[2]), "path_s: must rise"),
        (
            (*PATH[:2], "rig.target_manipulator.path_m=[[0.0, 0.0, 0.0], [-4.0, 0.0, 0.0]]"),
            "path_m: x -4, allowed -3 to 0.2",
        ),
        ((PATH[0], "rig.target_manipulator.path_s=[10.0, 11.0]", PATH[2]), "x at 1 m/s from 10 s, allowed 0.5"),
    ],
)
def test_path_that_the_target_cannot_follow_is_refused(settings: tuple[str, ...], text: str) -> None:
    with pytest.raises(BadInput, match=text):
        load_rig(RIG, settings)


def test_rule_of_sharing_is_part_of_the_sign_off() -> None:
    shared, held = load_rig(RIG).value, load_rig(RIG, ('rig.target_manipulator.sharing="none"',)).value
    assert motion_digest(shared) != motion_digest(held)
