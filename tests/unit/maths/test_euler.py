"""Tait-Bryan angles of all six orders against scipy."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.maths import euler, quat

ORDERS = list(permutations(range(3)))
YAW_PITCH_ROLL = np.array([2, 1, 0])


def drawn_angles(order: tuple[int, ...], count: int, seed: int) -> np.ndarray:
    """Return angles by axis whose middle angle stays 5 deg away from the lock."""
    angles = np.random.default_rng(seed).uniform(-math.pi, math.pi, (count, 3))
    angles[:, order[1]] *= 85.0 / 180.0
    return angles


def scipy_rotation(angles: np.ndarray, order: tuple[int, ...]) -> Rotation:
    return Rotation.from_euler("".join("XYZ"[axis] for axis in order), [angles[axis] for axis in order])


@pytest.mark.parametrize("order", ORDERS)
def test_quaternion_of_angles_agrees_with_scipy(order: tuple[int, ...]) -> None:
    for angles in drawn_angles(order, 30, 1):
        a = quat.to_matrix(euler.to_quaternion(angles, np.array(order)))
        np.testing.assert_allclose(a, scipy_rotation(angles, order).as_matrix().T, atol=1e-14)


@pytest.mark.parametrize("order", ORDERS)
def test_angles_survive_the_round_trip(order: tuple[int, ...]) -> None:
    for angles in drawn_angles(order, 30, 2):
        q = scipy_rotation(angles, order).as_quat()
        np.testing.assert_allclose(euler.from_quaternion(q, np.array(order)), angles, atol=1e-12)
        np.testing.assert_allclose(euler.from_quaternion(-q, np.array(order)), angles, atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("off_deg", [0.0, 1e-9, 1e-5, 1e-2])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_angles_at_gimbal_lock_still_give_the_attitude(order: tuple[int, ...], off_deg: float, side: float) -> None:
    angles = np.empty(3)
    angles[order[0]], angles[order[2]] = 0.7, -0.4
    angles[order[1]] = side * (math.pi / 2 - math.radians(off_deg))
    q = scipy_rotation(angles, order).as_quat()
    found = euler.from_quaternion(q, np.array(order))
    assert abs(found[order[1]]) <= math.pi / 2
    np.testing.assert_allclose(
        quat.to_matrix(euler.to_quaternion(found, np.array(order))), quat.to_matrix(q), atol=3e-6
    )


@pytest.mark.parametrize("order", ORDERS)
def test_inner_angle_is_zero_at_gimbal_lock(order: tuple[int, ...]) -> None:
    angles = np.empty(3)
    angles[order[0]], angles[order[1]], angles[order[2]] = 0.7, math.pi / 2, -0.4
    found = euler.from_quaternion(scipy_rotation(angles, order).as_quat(), np.array(order))
    assert found[order[2]] == 0.0
    assert found[order[1]] == pytest.approx(math.pi / 2, abs=1e-7)


@pytest.mark.parametrize("order", ORDERS)
def test_rate_jacobian_is_the_derivative_of_the_angles(order: tuple[int, ...]) -> None:
    step = 1e-6
    rates = np.random.default_rng(3).standard_normal((20, 3))
    for angles, w in zip(drawn_angles(order, 20, 4) * 0.9, rates, strict=True):
        attitude = scipy_rotation(angles, order)
        ends = [
            euler.from_quaternion((attitude * Rotation.from_rotvec(h * w)).as_quat(), np.array(order))
            for h in (-step, step)
        ]
        expected = (ends[1] - ends[0]) / (2.0 * step)
        np.testing.assert_allclose(euler.rate_jacobian(angles, np.array(order)) @ w, expected, rtol=1e-6, atol=1e-7)


def test_yaw_pitch_roll_angles_turn_about_z_y_x_in_the_positive_sense() -> None:
    small = 1e-3
    for axis in range(3):
        turn = np.zeros(3)
        turn[axis] = small
        found = euler.from_quaternion(quat.from_rotation_vector(turn), YAW_PITCH_ROLL)
        np.testing.assert_allclose(found, turn, atol=1e-12)


def test_axis_quaternion_turns_about_its_own_axis_alone() -> None:
    for axis in range(3):
        rotvec = np.zeros(3)
        rotvec[axis] = 0.6
        np.testing.assert_allclose(euler.axis_quaternion(axis, 0.6), Rotation.from_rotvec(rotvec).as_quat(), atol=1e-15)
