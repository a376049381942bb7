"""Rotation of the chaser: Euler's equations and what they conserve."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from hil.config.scenario import Scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.rigid_body import angular_acceleration
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import quat
from hil.params import dynamics as dynamics_params

NO_FIELD = np.zeros((1, 1, 6))  # the linear model reads no gravity field
J = np.array([[900.0, 12.0, -8.0], [12.0, 1100.0, 15.0], [-8.0, 15.0, 1050.0]])


def acceleration(inertia: np.ndarray, w: np.ndarray, torque: np.ndarray) -> np.ndarray:
    out = np.empty(3)
    angular_acceleration(inertia, np.linalg.inv(inertia), w, torque, out)
    return out


def test_acceleration_satisfies_eulers_equation(rng: np.random.Generator) -> None:
    for _ in range(20):
        w, torque = rng.standard_normal(3), 100.0 * rng.standard_normal(3)
        residual = J @ acceleration(J, w, torque) + np.cross(w, J @ w) - torque
        np.testing.assert_allclose(residual, 0.0, atol=1e-10)


def test_free_motion_changes_neither_energy_nor_the_size_of_the_momentum(rng: np.random.Generator) -> None:
    for _ in range(20):
        w = rng.standard_normal(3)
        dw = acceleration(J, w, np.zeros(3))
        assert w @ J @ dw == pytest.approx(0.0, abs=1e-10)
        assert (J @ w) @ (J @ dw) == pytest.approx(0.0, abs=1e-7)


def test_symmetric_body_precesses_at_the_textbook_rate() -> None:
    transverse, axial, spin = 1000.0, 600.0, 0.4
    rate = (axial - transverse) / transverse * spin
    inertia = np.diag([transverse, transverse, axial])
    dw = acceleration(inertia, np.array([0.1, 0.0, spin]), np.zeros(3))
    # w_x + i w_y turns with exp(i rate t): at w = (0.1, 0, spin) its derivative is i rate 0.1
    np.testing.assert_allclose(dw, [0.0, rate * 0.1, 0.0], atol=1e-15)


def test_torque_free_tumble_keeps_momentum_and_energy_in_inertial_space(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    params.orbit_rate = 0.02  # H itself must turn visibly
    truth.w_CI_C = [0.3, -0.4, 0.5]
    on = np.zeros(MAX_THRUSTERS, dtype=np.int64)

    def momentum() -> np.ndarray:
        to_inertial = Rotation.from_rotvec([0.0, -params.orbit_rate * truth.t_s, 0.0]).as_matrix()
        return to_inertial @ quat.to_matrix(truth.q_CH).T @ J @ truth.w_CI_C

    momentum_0, energy_0 = momentum(), 0.5 * truth.w_CI_C @ J @ truth.w_CI_C
    w_0 = truth.w_CI_C.copy()
    for _ in range(1500):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, on)
    assert np.linalg.norm(truth.w_CI_C - w_0) > 0.05
    np.testing.assert_allclose(momentum(), momentum_0, rtol=1e-8)
    assert 0.5 * truth.w_CI_C @ J @ truth.w_CI_C == pytest.approx(energy_0, rel=1e-10)
    assert np.linalg.norm(truth.q_CH) == pytest.approx(1.0, abs=1e-15)


def test_tumble_agrees_with_an_integrator_of_higher_order(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    truth.w_CI_C = [0.01, 0.5, 0.02]  # near the axis of largest inertia
    start = truth.w_CI_C.copy()
    for _ in range(1000):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, np.zeros(MAX_THRUSTERS, dtype=np.int64))
    exact = solve_ivp(
        lambda _, w: np.linalg.solve(J, -np.cross(w, J @ w)),
        (0.0, 20.0),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    ).y[:, -1]
    np.testing.assert_allclose(truth.w_CI_C, exact, atol=1e-10)


def test_constant_torque_about_a_principal_axis_spins_up_in_proportion() -> None:
    inertia = np.diag([900.0, 1100.0, 1050.0])
    for axis in range(3):
        torque = np.zeros(3)
        torque[axis] = 10.0
        assert acceleration(inertia, np.zeros(3), torque)[axis] == pytest.approx(10.0 / inertia[axis, axis])
        assert math.hypot(*np.delete(acceleration(inertia, np.zeros(3), torque), axis)) == 0.0
