"""The attitude filter: derivatives, an independent implementation, and honest covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from hil import parameters
from hil.config.scenario import Scenario
from hil.gnc import akf
from hil.maths import quat
from hil.messages import POSE, new

SIGMA = math.radians(0.033)


@pytest.fixture
def params(scheme_1: Scenario) -> np.record:
    """Return the shipped parameters."""
    return parameters.navigation(scheme_1).akf


def new_state(q: np.ndarray, drift: np.ndarray, p: np.ndarray) -> np.record:
    state = new(akf.AKF_STATE)
    state.x[:4], state.x[4:], state.p = q, drift, p
    return state


def pose_of(q: np.ndarray, covariance: np.ndarray) -> np.record:
    pose = new(POSE)
    pose.q_CH, pose.covariance_attitude = q, covariance
    return pose


def xi(q: np.ndarray) -> np.ndarray:
    return np.array([[q[3], -q[2], q[1]], [q[2], q[3], -q[0]], [-q[1], q[0], q[3]], [-q[0], -q[1], -q[2]]])


def omega(w: np.ndarray) -> np.ndarray:
    """Return Omega(w) (4, 4) of the bench paper's eq. (3)."""
    return np.array([[0, w[2], -w[1], w[0]], [-w[2], 0, w[0], w[1]], [w[1], -w[0], 0, w[2]], [-w[0], -w[1], -w[2], 0]])


def hill_turn(w0: float) -> np.ndarray:
    """Return the part of dq/dt that comes from the turn [0, -w0, 0] of H, (4, 4)."""
    return 0.5 * w0 * np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])


def angles(q: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(q).as_euler("ZYX")[::-1]


def jacobian(q: np.ndarray) -> np.ndarray:
    """Return d(theta)/d(q) (3, 4) as the kernel gives it, which a test holds against differences."""
    h = np.zeros((3, 7))
    akf.angle_jacobian(q, h)
    return h[:, :4]


def test_hill_part_of_the_process_is_eq_3(rng: np.random.Generator) -> None:
    for q in Rotation.random(10, rng=rng).as_quat():
        w, w0 = rng.standard_normal(3), 0.3
        expected = 0.5 * omega(w - quat.to_matrix(q) @ np.array([0.0, -w0, 0.0])) @ q
        np.testing.assert_allclose((0.5 * omega(w) + hill_turn(w0)) @ q, expected, atol=1e-14)


def test_turn_response_is_the_change_of_q_under_a_small_turn(rng: np.random.Generator) -> None:
    found = np.empty((4, 3))
    for q in Rotation.random(10, rng=rng).as_quat():
        akf.turn_response(q, found)
        for axis in range(3):
            turn = np.zeros(3)
            turn[axis] = 1e-6
            ends = [quat.multiply(quat.from_rotation_vector(s * turn), q) for s in (1.0, -1.0)]
            np.testing.assert_allclose(0.5 * found[:, axis], (ends[0] - ends[1]) / 2e-6, atol=1e-9)


def test_angles_are_scipys_yaw_pitch_roll(rng: np.random.Generator) -> None:
    for rotation in Rotation.random(100, rng=rng):
        q = rotation.as_quat()
        np.testing.assert_allclose(akf.angles(q), angles(q), atol=1e-9)


def test_angle_jacobian_is_the_derivative_of_the_angles(rng: np.random.Generator) -> None:
    step = 1e-6
    for theta in rng.uniform(-1.2, 1.2, (20, 3)):
        q = Rotation.from_euler("ZYX", theta).as_quat()
        for column in range(4):  # each component is free: eq. (9) does not ask for unit length
            d = np.zeros(4)
            d[column] = step
            slope = (akf.angles(q + d) - akf.angles(q - d)) / (2.0 * step)
            np.testing.assert_allclose(jacobian(q)[:, column], slope, rtol=1e-6, atol=1e-7)


def test_transition_is_the_derivative_of_the_step(params: np.record, rng: np.random.Generator) -> None:
    params.orbit_rate = 0.05
    rate = np.array([0.03, -0.05, 0.02])
    x = np.concatenate([Rotation.random(rng=rng).as_quat(), [1e-3, -2e-3, 3e-3]])
    q_next, phi, other = np.empty(4), np.empty((7, 7)), np.empty((7, 7))
    akf.transition(params, x, rate, q_next, phi)
    np.testing.assert_allclose(
        q_next, expm(params.dt_s * (0.5 * omega(rate - x[4:]) + hill_turn(0.05))) @ x[:4], atol=1e-15
    )
    for column in range(7):
        d, ends = np.zeros(7), []
        d[column] = 1e-5
        for sign in (1.0, -1.0):
            q = np.empty(4)
            akf.transition(params, x + sign * d, rate, q, other)
            ends.append(np.concatenate([q, x[4:] + sign * d[4:]]))
        slope = (ends[0] - ends[1]) / 2e-5
        # the drift's columns leave out half the turn within the step, 0.6 mrad here
        np.testing.assert_allclose(phi[:, column], slope, atol=1e-9 if column < 4 else 0.01 * 1e-3)
    assert np.abs(phi[:4, 4:]).max() > 0.005


def test_filter_stays_equal_to_filterpy_on_the_same_data(params: np.record, rng: np.random.Generator) -> None:
    params.sigma_gyro, params.sigma_drift = 1e-4, 1e-5
    true = Rotation.from_euler("ZYX", [0.2, -0.1, 0.15])
    covariance = np.diag([1.0, 2.0, 3.0]) * SIGMA**2
    state = new(akf.AKF_STATE)
    akf.start(params, pose_of(true.as_quat(), covariance), state)
    ekf = ExtendedKalmanFilter(dim_x=7, dim_z=3)
    ekf.x, ekf.P = state.x.copy(), state.p.copy()
    dt = params.dt_s
    for k in range(400):
        rate = np.array([0.02, -0.03, 0.01]) + 1e-4 * rng.standard_normal(3)
        true = true * Rotation.from_rotvec(dt * rate)
        f = expm(dt * (0.5 * omega(rate - ekf.x[4:]) + hill_turn(params.orbit_rate)))
        q_next = f @ ekf.x[:4]
        ekf.F = np.eye(7)
        ekf.F[:4, :4], ekf.F[:4, 4:] = f, -0.5 * dt * xi(q_next)
        gyro, drift = 0.25 * dt**2 * params.sigma_gyro**2, dt**2 * params.sigma_drift**2
        ekf.Q = np.zeros((7, 7))
        ekf.Q[:4, :4], ekf.Q[4:, 4:] = gyro * xi(q_next) @ xi(q_next).T, drift * np.eye(3)
        ekf.predict_x = lambda u=0, q=q_next: setattr(ekf, "x", np.concatenate([q / np.linalg.norm(q), ekf.x[4:]]))
        ekf.predict()
        akf.predict(params, state, rate)
        if k % 8 == 7:
            seen = (true * Rotation.from_rotvec(SIGMA * rng.standard_normal(3))).as_quat()
            e = 0.5 * jacobian(ekf.x[:4]) @ xi(ekf.x[:4])
            ekf.update(
                angles(seen),
                lambda x: np.hstack([jacobian(x[:4]), np.zeros((3, 3))]),
                lambda x: angles(x[:4]),
                R=e @ covariance @ e.T,
            )
            ekf.x[:4] /= np.linalg.norm(ekf.x[:4])
            akf.update(state, pose_of(seen, covariance))
            assert state.nis == pytest.approx(ekf.y @ ekf.SI @ ekf.y, rel=1e-7)
        np.testing.assert_allclose(state.x, ekf.x, atol=1e-11)
        np.testing.assert_allclose(state.p, ekf.P, rtol=1e-9, atol=1e-17)
        np.testing.assert_array_equal(state.p, state.p.T)
        assert np.linalg.eigvalsh(state.p).min() > -1e-18


def test_update_takes_the_short_way_across_half_a_turn(params: np.record) -> None:
    before = Rotation.from_euler("ZYX", [179.9, 0.0, 0.0], degrees=True).as_quat()
    seen = Rotation.from_euler("ZYX", [-179.9, 0.0, 0.0], degrees=True).as_quat()
    state = new(akf.AKF_STATE)
    akf.start(params, pose_of(before, SIGMA**2 * np.eye(3)), state)
    akf.update(state, pose_of(seen, SIGMA**2 * np.eye(3)))
    assert abs(math.degrees(akf.angles(state.x[:4].copy())[2])) == pytest.approx(180.0, abs=1e-3)
    assert state.nis == pytest.approx(0.2**2 / (2.0 * 0.033**2), rel=1e-3)


def test_angle_covariance_is_the_scatter_of_the_angles(rng: np.random.Generator) -> None:
    q = Rotation.from_euler("ZYX", [0.4, 0.6, -0.3]).as_quat()
    root = 1e-4 * rng.standard_normal((3, 3))
    found = np.empty((3, 3))
    akf.angle_covariance(q, root @ root.T, found)
    turns = rng.standard_normal((4000, 3)) @ root.T
    off = np.array([akf.angles(quat.multiply(quat.from_rotation_vector(t), q)) for t in turns]) - akf.angles(q)
    whitened = np.linalg.solve(np.linalg.cholesky(found), off.T)
    np.testing.assert_allclose(whitened @ whitened.T / len(turns), np.eye(3), atol=0.1)


def test_start_has_the_covariance_of_the_first_pose_and_of_the_drift(
    params: np.record, rng: np.random.Generator
) -> None:
    q, root = Rotation.random(rng=rng).as_quat(), rng.standard_normal((3, 3))
    state, found = new(akf.AKF_STATE), np.empty((6, 6))
    akf.start(params, pose_of(q, root @ root.T), state)
    akf.error_covariance(state, found)
    np.testing.assert_allclose(found[:3, :3], root @ root.T, atol=1e-13)
    np.testing.assert_allclose(found[3:, 3:], math.radians(1e-5) ** 2 * np.eye(3))
    np.testing.assert_array_equal(found[:3, 3:], 0.0)
    np.testing.assert_allclose(np.degrees(state.x[4:]), 2.78e-6)


def test_error_is_the_small_turn_from_the_estimate_to_the_truth(rng: np.random.Generator) -> None:
    q, turn, found = Rotation.random(rng=rng).as_quat(), np.array([1e-3, -2e-3, 3e-3]), np.empty(6)
    state = new_state(q, np.array([1.0, 2.0, 3.0]), np.eye(7))
    akf.error(state, quat.multiply(quat.from_rotation_vector(turn), q), np.array([1.5, 2.0, 2.5]), found)
    np.testing.assert_allclose(found, [*turn, 0.5, 0.0, -0.5], atol=1e-12)


def test_rate_is_the_gyros_without_drift_and_without_hills_turn(params: np.record, rng: np.random.Generator) -> None:
    q, drift = Rotation.random(rng=rng).as_quat(), np.array([1e-3, 2e-3, -1e-3])
    state, w_CH = new_state(q, drift, np.eye(7)), np.array([0.01, -0.02, 0.03])
    rate = w_CH + Rotation.from_quat(q).inv().apply([0.0, -params.orbit_rate, 0.0]) + drift
    akf.predict(params, state, rate)
    np.testing.assert_allclose(state.w_CH_C, w_CH, atol=params.orbit_rate * 1e-3)


def test_errors_are_as_large_as_the_covariance_says(params: np.record, rng: np.random.Generator) -> None:
    runs, steps, marks = 30, 3000, (8, 400, 1504, 3000)
    w, dt = np.array([0.004, -0.003, 0.005]), params.dt_s
    hill = quat.from_rotation_vector(np.array([0.0, params.orbit_rate * dt, 0.0]))
    true = [Rotation.from_euler("ZYX", [-0.05, 0.05, 0.05]).as_quat()]
    for _ in range(steps):
        true.append(quat.multiply(quat.from_rotation_vector(w * dt), quat.multiply(true[-1], hill)))
    total = dict.fromkeys(marks, 0.0)
    found, p = np.empty(6), np.empty((6, 6))

    def look(q: np.ndarray) -> np.record:
        return pose_of(
            quat.multiply(quat.from_rotation_vector(SIGMA * rng.standard_normal(3)), q), SIGMA**2 * np.eye(3)
        )

    for _ in range(runs):
        state = new(akf.AKF_STATE)
        akf.start(params, look(true[0]), state)
        drift = params.initial_drift + params.initial_drift_sigma * rng.standard_normal(3)
        noise = rng.standard_normal((steps, 6))
        for k in range(1, steps + 1):
            akf.predict(params, state, w + drift + params.sigma_gyro * noise[k - 1, :3])
            drift = drift + dt * params.sigma_drift * noise[k - 1, 3:]
            if k % 8 == 0:
                akf.update(state, look(true[k]))
            if k in total:
                akf.error(state, true[k], drift, found)
                akf.error_covariance(state, p)
                total[k] += found @ np.linalg.solve(p, found)
    for mark in marks:
        assert chi2.ppf(0.0005, 6 * runs) < total[mark] < chi2.ppf(0.9995, 6 * runs), mark
