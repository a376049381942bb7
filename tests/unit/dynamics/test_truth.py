"""One step of the truth: attitude against H, Hill's motion and the thrusters together."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.scenario import Scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.hill import input_response, transition
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import quat
from hil.params import dynamics as dynamics_params

NO_FIELD = np.zeros((1, 1, 6))  # the linear model reads no gravity field
QUIET = np.zeros(MAX_THRUSTERS, dtype=np.int64)


def firing(*numbers: int) -> np.ndarray:
    on = np.zeros(MAX_THRUSTERS, dtype=np.int64)
    on[list(numbers)] = 1
    return on


def to_inertial(orbit_rate: float, t_s: float) -> Rotation:
    """Return the rotation of vectors from H to the inertial axes with which H coincided at t = 0."""
    return Rotation.from_rotvec([0.0, -orbit_rate * t_s, 0.0])


def test_free_drift_agrees_with_the_closed_form(plain_2: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_2), dynamics_params.initial_truth(plain_2)
    truth.v_CT_H = [-0.03, 0.01, 0.02]
    start = np.concatenate([truth.r_CT_H, truth.v_CT_H])
    for _ in range(5000):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, QUIET)
    exact = transition(params.orbit_rate, 100.0) @ start
    assert truth.t_s == pytest.approx(100.0)
    np.testing.assert_allclose(truth.r_CT_H, exact[:3], atol=1e-10)
    np.testing.assert_allclose(truth.v_CT_H, exact[3:], atol=1e-12)


def test_attitude_against_hill_includes_hills_own_turn(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    params.orbit_rate = 0.05
    params.inertia = params.inertia_inverse = np.eye(3)  # a sphere keeps its inertial rate
    truth.w_CI_C = [0.2, -0.1, 0.3]
    body_0 = Rotation.from_quat(truth.q_CH)  # c to H, which is inertial at t = 0
    for _ in range(1000):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, QUIET)
    inertial = body_0 * Rotation.from_rotvec(20.0 * np.array([0.2, -0.1, 0.3]))
    expected = to_inertial(0.05, 20.0).inv() * inertial
    np.testing.assert_allclose(quat.to_matrix(truth.q_CH), expected.as_matrix().T, atol=1e-9)


def test_scenario_at_relative_rest_keeps_its_attitude_against_hill(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    rate = np.empty(3)
    kernels.rate_against_hill(truth, rate)
    np.testing.assert_allclose(rate, 0.0, atol=1e-18)
    assert np.linalg.norm(truth.w_CI_C) == pytest.approx(params.orbit_rate)
    q_0 = truth.q_CH.copy()
    kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, QUIET)
    np.testing.assert_allclose(truth.q_CH, q_0, atol=1e-12)


def test_rate_against_hill_is_inertial_rate_minus_hills(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    truth.w_CI_C = [0.01, 0.02, -0.03]
    rate = np.empty(3)
    kernels.rate_against_hill(truth, rate)
    hill = Rotation.from_quat(truth.q_CH).inv().apply([0.0, -params.orbit_rate, 0.0])
    np.testing.assert_allclose(rate, truth.w_CI_C - hill, atol=1e-18)


def test_mean_rate_is_the_integral_of_the_rate_over_the_step(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    fine, fine_truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    fine.dt_s = params.dt_s / 200
    truth.w_CI_C = fine_truth.w_CI_C = [0.5, -0.7, 0.6]
    on = firing(0, 5)
    kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, on)
    ends = [fine_truth.w_CI_C.copy()]
    for _ in range(200):
        kernels.step(fine, NO_FIELD, new(TRUTH_MEMORY), fine_truth, on)
        ends.append(fine_truth.w_CI_C.copy())
    integral = np.trapezoid(np.array(ends), dx=1.0 / 200, axis=0)
    np.testing.assert_allclose(truth.mean_rate_C, integral, rtol=1e-7)
    np.testing.assert_allclose(truth.w_CI_C, ends[-1], rtol=1e-9)


def test_thrust_pushes_along_body_axes_seen_from_hill(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    start = np.concatenate([truth.r_CT_H, truth.v_CT_H])
    attitude = Rotation.from_quat(truth.q_CH)
    kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, firing(2, 6, 10, 14))  # two of +z, two of +y
    push = attitude.apply([0.0, 10.0, 10.0]) / plain_1.chaser.mass_kg
    dt, w0 = params.dt_s, params.orbit_rate
    expected = transition(w0, dt) @ start + input_response(w0, dt) @ push
    np.testing.assert_allclose(truth.v_CT_H, expected[3:], atol=1e-9)
    np.testing.assert_allclose(truth.r_CT_H, expected[:3], atol=1e-11)


def test_momentum_gained_is_the_impulse_of_the_thrusters(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    params.orbit_rate = 0.0  # H is inertial
    truth.v_CT_H = truth.w_CI_C = 0.0
    number = 3
    force = plain_1.chaser.thrusters.force_n * np.array(plain_1.chaser.thrusters.direction[number])
    torque = np.cross(plain_1.chaser.thrusters.position_m[number], force)
    linear, impulse, twist = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(400):
        mass, speed, start = truth.mass_kg, truth.v_CT_H.copy(), Rotation.from_quat(truth.q_CH)
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, firing(number))
        linear += mass * (truth.v_CT_H - speed)
        middle = Rotation.concatenate([start, Rotation.from_quat(truth.q_CH)]).mean()
        impulse += params.dt_s * middle.apply(force)
        twist += params.dt_s * middle.apply(torque)
    angular = Rotation.from_quat(truth.q_CH).apply(params.inertia @ truth.w_CI_C)
    assert np.linalg.norm(truth.w_CI_C) > 0.02
    # the attitude in mid-step is known to the rotation by half a step of acceleration
    np.testing.assert_allclose(linear, impulse, atol=3e-5)
    np.testing.assert_allclose(angular, twist, atol=3e-5)


def test_couple_turns_without_pushing(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    params.orbit_rate = 0.0
    truth.w_CI_C = 0.0
    kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, firing(0, 5))  # +x at +y, -x at -y
    np.testing.assert_allclose(truth.v_CT_H, 0.0, atol=1e-18)
    torque = np.array([0.0, 0.0, -2.0 * plain_1.chaser.thrusters.force_n])
    np.testing.assert_allclose(truth.w_CI_C, params.inertia_inverse @ torque * params.dt_s, atol=1e-10)


def test_records_have_the_times_of_the_valves(plain_1: Scenario) -> None:
    params, truth = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    params.minimum_on_s = 0.03
    for fraction in (1.0, 0.5, 0.0):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, firing(7) if fraction == 1.0 else QUIET)
        assert truth.thrust_fraction[7] == pytest.approx(fraction)
        assert np.count_nonzero(np.delete(truth.thrust_fraction, 7)) == 0
