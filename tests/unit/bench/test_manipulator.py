"""Motion divided between the target's rotary manipulator and the chaser's rig: together exactly the wanted one."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench import manipulator
from hil.bench.manipulator import MANIPULATOR, ChaserMotion
from hil.config.load import load_rig
from hil.core.messages import Array, new
from hil.errors import BadInput
from hil.maths import quat
from hil.params import bench as bench_params

ORDERS = list(permutations(range(3)))
ANGLES = st.tuples(*[st.floats(-3.1, 3.1)] * 3).map(np.array)
VECTORS = st.tuples(*[st.floats(-5.0, 5.0)] * 3).map(np.array)
REST = np.zeros(3)


def params_of(order: tuple[int, ...], arm: Array) -> np.record:
    params = new(MANIPULATOR)
    params.order, params.arm = order, arm
    return params


def shown(
    params: np.record, angles: Array, rates: Array, r: Array, v: Array, q: Array, w: Array
) -> tuple[Array, Array, Array, Array]:
    return manipulator.shown_motion(params, angles, rates, ChaserMotion(r, v, q, w))[:4]


@given(st.sampled_from(ORDERS), ANGLES, VECTORS, VECTORS, VECTORS)
def test_both_machines_together_show_the_wanted_pose_at_any_angles(
    order: tuple[int, ...], angles: Array, arm: Array, r: Array, turn: Array
) -> None:
    params, q = params_of(order, arm), quat.from_rotation_vector(turn)
    r_L, _, q_CL, _ = shown(params, angles, REST, r, REST, q, REST)
    r_back, q_back = manipulator.relative_pose(params, angles, r_L, q_CL)
    np.testing.assert_allclose(r_back, r, atol=1e-12)
    np.testing.assert_allclose(q_back, q, atol=1e-12)


@given(st.sampled_from(ORDERS), ANGLES, VECTORS, VECTORS, VECTORS, VECTORS, VECTORS)
def test_rates_are_those_of_the_shown_pose(
    order: tuple[int, ...], angles: Array, rates: Array, r: Array, v: Array, turn: Array, w: Array
) -> None:
    params, h = params_of(order, np.array([0.3, -0.2, 0.1])), 1e-6

    def at(s: float) -> tuple[Array, Array]:
        q = quat.multiply(quat.from_rotation_vector(s * w), quat.from_rotation_vector(turn))
        r_L, _, q_CL, _ = shown(params, angles + s * rates, rates, r + s * v, v, q, w)
        return r_L, q_CL

    _, v_L, _, w_CL = shown(params, angles, rates, r, v, quat.from_rotation_vector(turn), w)
    (before, q_before), (after, q_after) = at(-h), at(h)
    np.testing.assert_allclose((after - before) / (2.0 * h), v_L, atol=1e-6)
    turned = quat.to_rotation_vector(quat.multiply(q_after, quat.conjugate(q_before)))
    np.testing.assert_allclose(turned / (2.0 * h), w_CL, atol=1e-6)


@given(st.sampled_from(ORDERS), VECTORS, VECTORS, ANGLES)
def test_wanted_angles_leave_no_rotation_to_the_turntable(
    order: tuple[int, ...], turn: Array, w: Array, near: Array
) -> None:
    params, q = params_of(order, np.array([0.3, -0.2, 0.1])), quat.from_rotation_vector(turn)
    angles, rates = manipulator.wanted_angles(params, q, w, near)
    _, _, q_CL, w_CL = shown(params, angles, rates, np.ones(3), REST, q, w)
    assert np.abs(q_CL[:3]).max() < 1e-6  # at the pole the angles themselves are known to 1e-6
    assert (np.abs(angles - near) <= np.pi + 1e-9).all()
    if abs(np.cos(angles[order[1]])) > 0.06:
        np.testing.assert_allclose(w_CL, 0.0, atol=1e-9)
    assert np.isfinite(rates).all()


def test_tumbling_target_and_coasting_chaser_are_shown_by_a_bench_at_rest() -> None:
    params = params_of((2, 1, 0), REST)
    w, r_0 = np.radians([1.0, -2.0, 5.0]), np.array([3.0, -0.1, 0.1])  # of the target, and where the chaser is
    for t_s in np.linspace(0.0, 5.0, 6):
        q_CH = quat.from_rotation_vector(-t_s * w)  # the chaser keeps its attitude
        r = quat.transform_back(q_CH, r_0)
        v = -np.cross(w, r)
        angles, rates = manipulator.wanted_angles(params, q_CH, -quat.transform(q_CH, w), REST)
        r_L, v_L, q_CL, w_CL = shown(params, angles, rates, r, v, q_CH, -quat.transform(q_CH, w))
        np.testing.assert_allclose(r_L, r_0, atol=1e-12)
        np.testing.assert_allclose(v_L, 0.0, atol=1e-12)
        np.testing.assert_allclose(np.abs(q_CL), [0.0, 0.0, 0.0, 1.0], atol=1e-12)
        np.testing.assert_allclose(w_CL, 0.0, atol=1e-12)


def test_axes_relative_to_the_target_are_those_themselves_without_a_manipulator(rng: np.random.Generator) -> None:
    rig = load_rig("emulated-manipulator").value
    bench, params = bench_params.bench(rig, 0.02), bench_params.manipulator(rig)
    rails, gimbals = rng.standard_normal(3), 0.3 * rng.standard_normal(3)
    assert manipulator.relative_axes(bench, None, rails, gimbals, REST)[0] is rails
    same = manipulator.relative_axes(bench, params, rails, gimbals, np.zeros(3))
    np.testing.assert_allclose(same, (rails, gimbals), atol=1e-12)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["pitch.travel_deg=[-90, 90]"], ("pitch.travel_deg", "-85 to 85")),
        (["roll.travel_deg=[5, 90]", "roll.park_deg=10"], ("roll.travel_deg", "must contain 0")),
    ],
)
def test_manipulator_without_a_middle_or_at_its_pole_is_refused(settings: list[str], words: tuple[str, ...]) -> None:
    with pytest.raises(BadInput) as refused:
        load_rig("emulated-manipulator", tuple(f"rig.rotary_manipulator.{setting}" for setting in settings))
    assert all(word in str(refused.value) for word in words)
