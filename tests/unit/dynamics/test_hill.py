"""Relative motion in H against the closed form and against two bodies in inertial space."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from hil.dynamics.hill import hill_acceleration, input_response, transition
from tests.support.moon_reference import GM as MOON_GM_M3PS2
from tests.support.moon_reference import RADIUS_M as MOON_RADIUS_M

RADIUS_M = MOON_RADIUS_M + 200e3
W0 = math.sqrt(MOON_GM_M3PS2 / RADIUS_M**3)
HILL_RATE_H = np.array([0.0, -W0, 0.0])
PERIOD_S = 2.0 * math.pi / W0


def system_matrix() -> np.ndarray:
    f = np.zeros((6, 6))
    f[0:3, 3:6] = np.eye(3)
    out = np.empty(3)
    for column in range(6):
        state = np.eye(6)[column]
        hill_acceleration(state[:3].copy(), state[3:].copy(), W0, out)
        f[3:, column] = out
    return f


def inertial_axes(t_s: float) -> np.ndarray:
    """Return R (3, 3) that takes vectors in H to inertial space."""
    return Rotation.from_rotvec(HILL_RATE_H * t_s).as_matrix()


def after_in_inertial_space(r_CT_H: np.ndarray, v_CT_H: np.ndarray, t_s: float) -> np.ndarray:
    """Return [r, v] in H after ``t_s`` of two-body motion of chaser and target (DOP853)."""

    def gravity(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], -MOON_GM_M3PS2 * y[:3] / np.linalg.norm(y[:3]) ** 3])

    target_h = np.array([0.0, 0.0, -RADIUS_M])  # z points to the Moon
    r0 = target_h + r_CT_H
    v0 = v_CT_H + np.cross(HILL_RATE_H, r0)
    y = solve_ivp(gravity, (0.0, t_s), np.concatenate([r0, v0]), method="DOP853", rtol=3e-14, atol=1e-9).y[:, -1]
    back = inertial_axes(t_s).T
    r = back @ y[:3] - target_h
    return np.concatenate([r, back @ y[3:] - np.cross(HILL_RATE_H, target_h + r)])


def test_target_orbit_runs_along_plus_x_with_the_moon_at_plus_z() -> None:
    np.testing.assert_allclose(np.cross(HILL_RATE_H, [0.0, 0.0, -RADIUS_M]), [W0 * RADIUS_M, 0.0, 0.0])


def test_transition_is_the_matrix_exponential_of_the_acceleration() -> None:
    for t_s in (0.02, 10.0, 1000.0, PERIOD_S):
        scale = np.array([1.0, 1.0, 1.0, W0, W0, W0])
        found, exact = transition(W0, t_s), expm(system_matrix() * t_s)
        np.testing.assert_allclose(found / scale[:, None] * scale, exact / scale[:, None] * scale, atol=1e-10)


def test_transition_of_two_steps_is_their_product() -> None:
    np.testing.assert_allclose(transition(W0, 700.0), transition(W0, 300.0) @ transition(W0, 400.0), rtol=1e-9)


def test_input_response_is_the_integral_of_the_transition() -> None:
    # Van Loan: the upper right block of the exponential of [[F, B], [0, 0]]
    for t_s in (0.02, 10.0, 1000.0):
        block = np.zeros((9, 9))
        block[:6, :6] = system_matrix()
        block[3:6, 6:9] = np.eye(3)
        exact = expm(block * t_s)[:6, 6:9]
        size = np.repeat([0.5 * t_s**2, t_s], 3)[:, None]
        # cosine and sine cancel in the closed form: six digits are left of a step of 0.02 s
        np.testing.assert_allclose(input_response(W0, t_s) / size, exact / size, atol=1e-5)


@pytest.mark.parametrize("axis", range(3))
def test_motion_agrees_with_two_bodies_in_inertial_space(axis: int) -> None:
    r = np.array([10.0, -0.5, 0.5])
    v = np.zeros(3)
    v[axis] = 0.02
    found = transition(W0, 1000.0) @ np.concatenate([r, v])
    exact = after_in_inertial_space(r, v, 1000.0)
    assert np.linalg.norm(found[:3] - r) > 3.0
    np.testing.assert_allclose(found[:3], exact[:3], atol=1e-3)
    np.testing.assert_allclose(found[3:], exact[3:], atol=1e-6)


def test_error_of_the_linear_model_grows_with_the_square_of_the_range() -> None:
    r = np.array([0.6, 0.48, 0.64])
    errors = [
        np.linalg.norm(
            (transition(W0, 1000.0) @ np.concatenate([s * r, np.zeros(3)]))[:3]
            - after_in_inertial_space(s * r, np.zeros(3), 1000.0)[:3]
        )
        for s in (500.0, 1000.0)
    ]
    assert errors[1] / errors[0] == pytest.approx(4.0, rel=0.01)


def test_chaser_on_the_v_bar_stays_where_it_is() -> None:
    state = np.array([10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(transition(W0, 5000.0) @ state, state, atol=1e-12)


def test_chaser_below_the_target_moves_ahead() -> None:
    # z points to the Moon: lower means faster
    assert (transition(W0, 100.0) @ np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0]))[0] > 0.0
