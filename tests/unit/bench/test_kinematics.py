"""Pose to axes and back, and the limits of setpoints."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hil.bench.kinematics import BENCH_PARAMS, MOTION, axes_of_pose, limit_setpoint, pose_of_axes
from hil.core.messages import AXES, new
from hil.maths import quat

DT = 0.02
ORDERS = list(permutations(range(3)))

triples = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
middle_angles = st.floats(-1.4, 1.4)
orders = st.sampled_from(ORDERS)


def bench(order: tuple[int, ...] = (2, 1, 0), lever_arm: tuple[float, ...] = (0.1, -0.2, 0.35)) -> np.record:
    params = new(BENCH_PARAMS)
    params.dt_s, params.lever_arm, params.order = DT, lever_arm, order
    params.low, params.high = [-1.0] * 6, [1.0] * 6
    params.rate_max, params.acceleration_max = [0.5] * 6, [0.6] * 6
    return params


def axes_at(params: np.record, r: np.ndarray, v: np.ndarray, q: np.ndarray, w: np.ndarray) -> np.record:
    axes = new(AXES)
    axes_of_pose(params, r, v, q, w, axes)
    return axes


@given(orders, triples, triples, triples, middle_angles)
def test_pose_survives_the_way_to_the_axes_and_back(
    order: tuple[int, ...], arm: tuple[float, ...], r: tuple[float, ...], angles: tuple[float, ...], middle: float
) -> None:
    params, euler = bench(order, arm), list(angles)
    euler[order[1]] = middle
    q = Rotation.from_euler("".join("XYZ"[a] for a in order), [euler[a] for a in order]).as_quat()
    axes = axes_at(params, np.array(r), np.zeros(3), q, np.zeros(3))
    np.testing.assert_allclose(axes.gimbal_rad, euler, atol=1e-9)
    found_r, found_q = np.empty(3), np.empty(4)
    pose_of_axes(params, axes.rail_m, axes.gimbal_rad, found_r, found_q)
    np.testing.assert_allclose(found_r, r, atol=1e-9)
    np.testing.assert_allclose(quat.to_matrix(found_q), quat.to_matrix(q), atol=1e-9)


def test_carriage_stands_off_by_the_lever_arm_seen_in_the_lab() -> None:
    # yawed by 90 deg, x_c points along y_L: an arm along x_c holds the carriage back along y_L
    q = Rotation.from_rotvec([0.0, 0.0, math.pi / 2]).as_quat()
    axes = axes_at(bench(lever_arm=(0.35, 0.0, 0.0)), np.array([5.0, 1.0, 2.0]), np.zeros(3), q, np.zeros(3))
    np.testing.assert_allclose(axes.rail_m, [5.0, 0.65, 2.0], atol=1e-12)
    np.testing.assert_allclose(axes.gimbal_rad, [0.0, 0.0, math.pi / 2], atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_rates_are_the_derivatives_of_the_positions(order: tuple[int, ...], rng: np.random.Generator) -> None:
    params, h = bench(order), 1e-6
    for _ in range(10):
        start = Rotation.from_euler("".join("XYZ"[a] for a in order), rng.uniform(-1.2, 1.2, 3))
        r, v, w = rng.standard_normal((3, 3))
        axes = axes_at(params, r, v, start.as_quat(), w)
        ends = [axes_at(params, r + s * v, v, (start * Rotation.from_rotvec(s * w)).as_quat(), w) for s in (-h, h)]
        np.testing.assert_allclose(axes.rail_mps, (ends[1].rail_m - ends[0].rail_m) / (2 * h), atol=1e-8)
        slope = (ends[1].gimbal_rad - ends[0].gimbal_rad) / (2 * h)
        np.testing.assert_allclose(axes.gimbal_radps, slope, rtol=1e-6, atol=1e-7)


def moving(position: float = 0.0, rate: float = 0.0) -> np.record:
    """The memory of six axes whose last setpoint was ``position``, reached at ``rate``."""
    motion = new(MOTION)
    motion.position = position
    motion.rate = rate
    return motion


def standing(position: float = 0.0) -> np.record:
    axes = new(AXES)
    axes.rail_m = axes.gimbal_rad = position
    return axes


def wanting(position: float, rate: float = 0.0) -> np.record:
    axes = standing(position)
    axes.rail_mps = axes.gimbal_radps = rate
    return axes


commands = st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), min_size=1, max_size=60)


@given(commands)
def test_setpoints_keep_travel_and_speed_whatever_is_wanted(wishes: list[tuple[float, float]]) -> None:
    params, motion, before = bench(), moving(), standing()
    for position, rate in wishes:
        out = new(AXES)
        limit_setpoint(params, motion, wanting(position, rate), out)
        for new_m, old_m in ((out.rail_m, before.rail_m), (out.gimbal_rad, before.gimbal_rad)):
            assert (np.abs(new_m) <= 1.0).all()
            assert (np.abs(new_m - old_m) <= 0.5 * DT + 1e-12).all()
        before = out


def accelerations(params: np.record, wishes: list[tuple[float, float]]) -> np.ndarray:
    """Return the accelerations, m/s^2, of one axis whose setpoints follow ``wishes`` as far as they may."""
    motion, out, track = moving(), new(AXES), [0.0, 0.0]
    for position, rate in wishes:
        limit_setpoint(params, motion, wanting(position, rate), out)
        track.append(float(out.rail_m[0]))
    return np.diff(track, 2) / DT**2


@given(st.floats(-0.5, 0.5), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_step_of_a_setpoint_keeps_the_acceleration_from_the_rate_before(rate: float, to: float, asked: float) -> None:
    out = new(AXES)
    limit_setpoint(bench(), moving(0.0, rate), wanting(to, asked), out)
    for new_m in (out.rail_m, out.gimbal_rad):
        assert (np.abs(new_m / DT - rate) <= 0.6 * DT + 1e-9).all()


@given(st.lists(st.floats(-0.9, 0.9), min_size=1, max_size=60))
def test_setpoints_keep_their_acceleration_inside_the_travel(wishes: list[float]) -> None:
    params = bench()
    params.low, params.high = [-100.0] * 6, [100.0] * 6
    assert np.abs(accelerations(params, [(p, 0.0) for p in wishes])).max() <= 0.6 + 1e-6


def test_setpoints_keep_their_acceleration_at_the_end_of_the_travel() -> None:
    assert np.abs(accelerations(bench(), [(2.0, 0.0)] * 200)).max() <= 0.6 + 1e-6


def test_far_setpoint_is_reached_without_overshoot() -> None:
    params, motion, out, track = bench(), moving(), new(AXES), []
    for _ in range(300):
        limit_setpoint(params, motion, wanting(0.8), out)
        track.append(float(out.rail_m[0]))
    assert max(track) <= 0.8 + 1e-9
    assert track[-1] == pytest.approx(0.8, abs=1e-9)


def test_moving_target_is_reached_from_rest() -> None:
    params, motion, out = bench(), moving(), new(AXES)
    limited = [limit_setpoint(params, motion, wanting(0.003 * k, 0.15), out) for k in range(1, 100)]
    assert limited[0] == 6
    assert limited[-50:] == [0] * 50
    assert out.rail_m[0] == pytest.approx(0.003 * 99)


def test_rate_that_goes_with_a_setpoint_never_exceeds_the_speed_limit() -> None:
    out = new(AXES)
    limit_setpoint(bench(), moving(), wanting(0.0, 5.0), out)
    assert np.abs(out.rail_mps).max() <= 0.5
    assert np.abs(out.gimbal_radps).max() <= 0.5


@given(st.floats(-0.4, 0.4), st.floats(-0.01, 0.01), triples)
def test_setpoint_within_the_limits_passes_bit_for_bit(rate: float, change: float, at: tuple[float, ...]) -> None:
    params, motion, wanted, out = bench(), moving(0.0, rate), new(AXES), new(AXES)
    motion.position[:3] = motion.position[3:] = np.array(at) / 3.0
    wanted.rail_mps = wanted.gimbal_radps = rate + change
    wanted.rail_m = motion.position[:3] + DT * (rate + 0.5 * change)
    wanted.gimbal_rad = motion.position[3:] + DT * (rate + 0.5 * change)
    assert limit_setpoint(params, motion, wanted, out) == 0
    assert out.tobytes() == wanted.tobytes()


def test_limited_axes_are_counted_and_the_others_left_alone() -> None:
    wanted, out = new(AXES), new(AXES)
    wanted.rail_m[1], wanted.gimbal_rad[2] = 0.5, -0.5
    assert limit_setpoint(bench(), moving(), wanted, out) == 2
    assert out.rail_m[1] == pytest.approx(0.6 * DT * DT)
    assert out.gimbal_rad[2] == pytest.approx(-0.6 * DT * DT)
    np.testing.assert_array_equal(np.delete(out.rail_m, 1), 0.0)


def test_setpoint_that_is_not_finite_is_passed_on_for_the_driver_to_refuse() -> None:
    out = new(AXES)
    limit_setpoint(bench(), moving(), wanting(math.nan), out)
    assert np.isnan(out.rail_m).all()
    assert np.isnan(out.gimbal_rad).all()
    limit_setpoint(bench(), moving(), wanting(0.0, math.nan), out)
    assert np.isnan(out.rail_mps).all()
