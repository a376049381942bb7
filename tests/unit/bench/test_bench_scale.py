"""Bench that is scaled at a distance: what it shows, and back."""

from __future__ import annotations

import numpy as np
import pytest

from hil.bench.kinematics import axes_of_pose, pose_of_axes, show
from hil.config.load import load_rig
from hil.config.tables.machine import BenchScale
from hil.core.messages import AXES, Array, new
from hil.maths import quat
from hil.params import bench as bench_params

SCALED = bench_params.bench(load_rig("mock").value, 0.02, BenchScale(scaled_beyond_m=8.5, scale=0.025))
WHOLE = bench_params.bench(load_rig("mock").value, 0.02)
RANGES_M = (0.4, 8.4, 8.5, 8.6, 9.0, 9.4999, 9.5, 9.6, 30.0, 100.0)
DIRECTION = np.array([1.0, -0.02, 0.05]) / np.linalg.norm([1.0, -0.02, 0.05])
Q = quat.from_rotation_vector(np.array([0.02, -0.03, 0.01]))


def shown(r: Array, v: Array) -> tuple[Array, Array]:
    place, rate = np.empty(3), np.empty(3)
    show(SCALED, r, v, place, rate)
    return place, rate


@pytest.mark.parametrize("distance", RANGES_M)
def test_pose_of_the_axes_is_the_pose_that_they_were_commanded_for(distance: float) -> None:
    axes, r, q, rest = new(AXES), np.empty(3), np.empty(4), np.zeros(3)
    axes_of_pose(SCALED, distance * DIRECTION, rest, Q, rest, axes)
    pose_of_axes(SCALED, axes.rail_m, axes.gimbal_rad, r, q)
    np.testing.assert_allclose(r, distance * DIRECTION, rtol=1e-12)
    np.testing.assert_allclose(q, Q, atol=1e-12)


def test_near_the_target_nothing_is_scaled_to_the_last_bit() -> None:
    axes, same, rest = new(AXES), new(AXES), np.zeros(3)
    axes_of_pose(SCALED, 5.0 * DIRECTION, DIRECTION, Q, rest, axes)
    axes_of_pose(WHOLE, 5.0 * DIRECTION, DIRECTION, Q, rest, same)
    assert axes.tobytes() == same.tobytes()


@pytest.mark.parametrize("distance", RANGES_M)
def test_rate_is_the_derivative_of_the_position(distance: float) -> None:
    v, h = np.array([-0.15, 0.02, 0.01]), 1e-5
    r = distance * DIRECTION
    before, after = shown(r - h * v, v)[0], shown(r + h * v, v)[0]
    np.testing.assert_allclose(shown(r, v)[1], (after - before) / (2.0 * h), atol=1e-6)


def test_line_of_sight_stays_and_a_hundred_metres_fit_on_the_rails() -> None:
    place, _ = shown(100.0 * DIRECTION, np.zeros(3))
    np.testing.assert_allclose(place / np.linalg.norm(place), DIRECTION, rtol=1e-12)
    assert np.linalg.norm(place) == pytest.approx(8.5 + 0.025 * 91.5 + 0.5 * 0.975)
