"""The position filter: derivatives, an independent implementation, and honest covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from hil import parameters
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.dynamics.vision import see
from hil.gnc import navigation, pkf
from hil.maths import quat
from hil.maths.stations import chaser_pose
from hil.messages import IMU, NAVIGATION, POSE, TRUTH, new

NO_TURN = np.zeros((6, 6))


@pytest.fixture
def params(scheme_1: Scenario) -> np.record:
    """Return the shipped parameters."""
    return parameters.navigation(scheme_1).pkf


def discrete(scenario: Scenario, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Phi (9, 9) and Psi (9, 3) of one step from the continuous F and B of eq. (14) (Van Loan)."""
    w0 = parameters.orbit_rate(scenario)
    to_h = quat.to_matrix(q).T
    f = np.zeros((12, 12))
    f[0:3, 3:6] = np.eye(3)
    f[3:6, 0:3] = np.diag([0.0, -(w0**2), 3.0 * w0**2])
    f[3:6, 3:6] = [[0, 0, 2 * w0], [0, 0, 0], [-2 * w0, 0, 0]]
    f[3:6, 6:9], f[3:6, 9:12] = -to_h, to_h
    whole = expm(f * scenario.step_s)
    return whole[:9, :9], whole[:9, 9:]


def pose_of(z: np.ndarray, q: np.ndarray, covariance: np.ndarray) -> np.record:
    pose = new(POSE)
    pose.z_TC_C, pose.q_CH, pose.covariance_position = z, q, covariance
    return pose


def new_state(rng: np.random.Generator) -> np.record:
    state, root = new(pkf.PKF_STATE), rng.standard_normal((9, 9))
    state.x, state.p = rng.standard_normal(9), root @ root.T
    return state


def test_transition_is_the_matrix_exponential_of_the_process(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    phi = np.empty((9, 9))
    for q in Rotation.random(5, rng=rng).as_quat():
        pkf.transition(params, q, phi)
        exact, response = discrete(scheme_1, q)
        np.testing.assert_allclose(phi, exact, atol=1e-9)
        np.testing.assert_allclose(phi[:6, 6:], -response[:6], atol=1e-9)


def test_transition_is_the_derivative_of_the_step(params: np.record, rng: np.random.Generator) -> None:
    q, force, phi = Rotation.random(rng=rng).as_quat(), rng.standard_normal(3), np.empty((9, 9))
    pkf.transition(params, q, phi)
    start = new_state(rng)
    for column in range(9):
        ends = []
        for sign in (1.0, -1.0):
            state = start.copy()
            state.x[column] += sign
            pkf.predict(params, state, force, q)
            ends.append(state.x.copy())
        np.testing.assert_allclose(phi[:, column], (ends[0] - ends[1]) / 2.0, atol=1e-12)


def test_measured_force_moves_the_state_as_thrust_does(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    q, force, state = Rotation.random(rng=rng).as_quat(), np.array([0.01, -0.02, 0.03]), new(pkf.PKF_STATE)
    state.x[6:] = [1e-3, 2e-3, 3e-3]
    pkf.predict(params, state, force + state.x[6:], q)
    np.testing.assert_allclose(state.x[:6], discrete(scheme_1, q)[1][:6] @ force, atol=1e-10)


def test_update_agrees_with_the_derivative_of_what_the_camera_sees(rng: np.random.Generator) -> None:
    q = Rotation.random(rng=rng).as_quat()
    state, root = new_state(rng), rng.standard_normal((6, 6))
    turn_covariance, r = 1e-2 * root @ root.T, np.diag([0.1, 0.2, 0.3])
    x, p = state.x.copy(), state.p.copy()
    z = rng.standard_normal(3)

    def seen(r_CT_H: np.ndarray, turn: np.ndarray) -> np.ndarray:
        return quat.to_matrix(quat.multiply(quat.from_rotation_vector(turn), q)) @ -r_CT_H

    h, arm = np.zeros((3, 9)), np.empty((3, 3))
    for i in range(3):
        d = 1e-6 * np.eye(3)[i]
        h[:, i] = (seen(x[:3] + d, np.zeros(3)) - seen(x[:3] - d, np.zeros(3))) / 2e-6
        arm[:, i] = (seen(x[:3], d) - seen(x[:3], -d)) / 2e-6
    s = h @ p @ h.T + r + arm @ turn_covariance[:3, :3] @ arm.T
    gain, innovation = p @ h.T @ np.linalg.inv(s), z - seen(x[:3], np.zeros(3))
    pkf.update(state, pose_of(z, q, r), q, turn_covariance)
    np.testing.assert_allclose(state.x, x + gain @ innovation, atol=1e-8)
    np.testing.assert_allclose(state.p, (np.eye(9) - gain @ h) @ p, atol=1e-7)
    assert state.nis == pytest.approx(innovation @ np.linalg.solve(s, innovation), rel=1e-7)


def test_filter_stays_equal_to_filterpy_on_the_same_data(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    r = np.diag([1.0, 2.0, 3.0]) * 0.005**2
    attitude, rate = Rotation.from_euler("ZYX", [0.2, -0.1, 0.15]), np.array([0.02, -0.03, 0.01])
    state = new(pkf.PKF_STATE)
    pkf.start(params, pose_of(np.array([-5.0, 0.3, -0.3]), attitude.as_quat(), r), state)
    reference = KalmanFilter(dim_x=9, dim_z=3)
    reference.x, reference.P = state.x.copy(), state.p.copy()
    for k in range(400):
        attitude = attitude * Rotation.from_rotvec(0.02 * rate)
        q, force = attitude.as_quat(), 5e-3 * rng.standard_normal(3)
        phi, psi = discrete(scheme_1, q)
        g = psi * params.sigma_accelerometer
        noise = g @ g.T
        noise[6:, 6:] += (0.02 * params.sigma_bias) ** 2 * np.eye(3)
        reference.predict(u=force, B=psi, F=phi, Q=noise)
        pkf.predict(params, state, force, q)
        if k % 8 == 7:
            z = np.array([-5.0, 0.3, -0.3]) + 0.005 * rng.standard_normal(3)
            h = np.hstack([-quat.to_matrix(q), np.zeros((3, 6))])
            reference.update(z, R=r, H=h)
            pkf.update(state, pose_of(z, q, r), q, NO_TURN)
            assert state.nis == pytest.approx(reference.y @ reference.SI @ reference.y, rel=1e-6)
        np.testing.assert_allclose(state.x, reference.x, atol=1e-9)
        np.testing.assert_allclose(state.p, reference.P, atol=1e-11)
        np.testing.assert_array_equal(state.p, state.p.T)
        assert np.linalg.eigvalsh(state.p).min() > 0.0


def test_start_stands_at_the_first_pose_at_rest(params: np.record, rng: np.random.Generator) -> None:
    q, root, state = Rotation.random(rng=rng).as_quat(), rng.standard_normal((3, 3)), new(pkf.PKF_STATE)
    r_CT_H = np.array([5.0, -0.3, 0.3])
    pkf.start(params, pose_of(-quat.to_matrix(q) @ r_CT_H, q, root @ root.T), state)
    np.testing.assert_allclose(state.x, [*r_CT_H, 0, 0, 0, 3e-4, 3e-4, 3e-4], atol=1e-14)
    back = quat.to_matrix(q).T
    np.testing.assert_allclose(state.p[:3, :3], back @ (root @ root.T) @ back.T, atol=1e-13)
    np.testing.assert_allclose(np.diag(state.p)[3:], np.repeat([0.02**2, 5e-4**2], 3))


def test_sigma_is_the_root_of_the_diagonal(rng: np.random.Generator) -> None:
    state, out = new_state(rng), np.empty(3)
    for first in (0, 3, 6):
        pkf.sigma(state, first, out)
        np.testing.assert_allclose(out, np.sqrt(np.diag(state.p)[first : first + 3]))


def test_errors_are_as_large_as_the_covariance_says(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    runs, steps, marks = 30, 3000, (8, 400, 1504, 3000)
    w = np.array([0.004, -0.003, 0.005])
    start = Rotation.from_euler("ZYX", [-0.05, 0.05, 0.05])
    middle = (start * Rotation.from_rotvec(0.02 * (np.arange(steps)[:, None] + 0.5) * w)).as_quat()
    after = (start * Rotation.from_rotvec(0.02 * (np.arange(steps)[:, None] + 1.0) * w)).as_quat()
    phi_psi = [discrete(scheme_1, q) for q in middle[::50]]  # the turn over 50 steps is below 1 %
    r, root = 0.005**2 * np.diag([1.0, 4.0, 9.0]), 0.005 * np.array([1.0, 2.0, 3.0])
    total = dict.fromkeys(marks, 0.0)

    def look(q: np.ndarray, r_CT_H: np.ndarray) -> np.record:
        return pose_of(-quat.to_matrix(q) @ r_CT_H + root * rng.standard_normal(3), q, r)

    for _ in range(runs):
        state, truth = new(pkf.PKF_STATE), np.zeros(9)
        truth[:3] = [5.0, -0.3, 0.3]
        truth[3:6] = params.initial_velocity_sigma * rng.standard_normal(3)
        truth[6:] = params.initial_bias + params.initial_bias_sigma * rng.standard_normal(3)
        pkf.start(params, look(start.as_quat(), truth[:3]), state)
        noise = rng.standard_normal((steps, 6))
        for k in range(1, steps + 1):
            force = np.array([5e-3 * math.sin(0.01 * k), 2e-3, -3e-3])
            pkf.predict(params, state, force + truth[6:] + params.sigma_accelerometer * noise[k - 1, :3], middle[k - 1])
            phi, psi = phi_psi[(k - 1) // 50]
            truth = np.concatenate([phi[:6, :6] @ truth[:6] + psi[:6] @ force, truth[6:]])
            truth[6:] += 0.02 * params.sigma_bias * noise[k - 1, 3:]
            if k % 8 == 0:
                pkf.update(state, look(after[k - 1], truth[:3]), after[k - 1], NO_TURN)
            if k in total:
                error = truth - state.x
                total[k] += error @ np.linalg.solve(state.p, error)
    for mark in marks:
        assert chi2.ppf(0.0005, 9 * runs) < total[mark] < chi2.ppf(0.9995, 9 * runs), mark


@pytest.mark.xfail(strict=True, reason="pkf takes the attitude error, which lasts from frame to frame, for white noise")
def test_errors_are_as_large_as_the_covariance_says_with_an_estimated_attitude(
    scheme_2: Scenario, mock_rig: Rig, rng: np.random.Generator
) -> None:
    runs, marks = 40, (0, 80, 400)
    params, stations = parameters.navigation(scheme_2), parameters.stations(mock_rig)
    vision = parameters.vision(scheme_2)
    vision.reference_range = 1e3  # noise as in Table I at every range
    hill_rate = np.array([0.0, -params.akf.orbit_rate, 0.0])
    truth, imu, pose, out, two = new(TRUTH), new(IMU), new(POSE), new(NAVIGATION), np.empty(2)
    truth.q_CH = [0.0, 0.0, 0.0, 1.0]
    t_v, q_vt, covariance = np.empty(3), np.empty(4), np.empty((6, 6))
    total = dict.fromkeys(marks, 0.0)
    for _ in range(runs):
        state = new(navigation.NAVIGATION_STATE)
        x = np.concatenate([[10.0, -0.5, 0.5], params.pkf.initial_velocity_sigma * rng.standard_normal(3)])
        imu.bias_C = params.pkf.initial_bias + params.pkf.initial_bias_sigma * rng.standard_normal(3)
        imu.drift_C = params.akf.initial_drift + params.akf.initial_drift_sigma * rng.standard_normal(3)
        for k in range(max(marks) + 1):
            if k > 0:
                x = params.pkf.hill_transition @ x
                imu.rate_C = hill_rate + imu.drift_C + params.akf.sigma_gyro * rng.standard_normal(3)
                imu.force_C = imu.bias_C + params.pkf.sigma_accelerometer * rng.standard_normal(3)
                imu.bias_C += 0.02 * params.pkf.sigma_bias * rng.standard_normal(3)
            truth.r_CT_H, truth.v_CT_H = x[:3], x[3:]
            pose.fresh = int(k % 8 == 0)
            if pose.fresh:
                see(vision, stations, truth.r_CT_H, truth.q_CH, rng.standard_normal(6), t_v, q_vt, covariance)
                chaser_pose(stations, t_v, q_vt, covariance, pose)
            navigation.navigate(params, state, imu, pose, out)
            if k in total:
                navigation.normalised_errors(state, truth, imu, two)
                total[k] += two[0]
    for mark in marks:
        assert chi2.ppf(0.0005, 9 * runs) < total[mark] < chi2.ppf(0.9995, 9 * runs), mark
