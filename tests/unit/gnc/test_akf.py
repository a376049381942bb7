"""The attitude filter with its six-component error: derivatives, an independent implementation, honest covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from hil.config.scenario import Scenario
from hil.core.messages import POSE, new
from hil.gnc.estimation import akf
from hil.maths import quat
from hil.params import gnc as gnc_params
from tests.support.hill_steps import on_circle
from tests.support.joint_filter import NO_FORCE, JointFilter

SIGMA = math.radians(0.033)
ORBIT_RATE = 8.2e-4  # rad/s


@pytest.fixture
def params(plain_filters_1: Scenario) -> np.record:
    """Return the shipped parameters, for a frame H whose rate is known."""
    fusion: np.record = gnc_params.navigation(plain_filters_1).fusion
    fusion.akf.rate_sigma = fusion.akf.rate_noise = 0.0
    return fusion


def started(params: np.record, q: np.ndarray, covariance: np.ndarray) -> JointFilter:
    pose = new(POSE)
    pose.q_CH, pose.covariance_attitude, pose.covariance_position = q, covariance, np.eye(3)
    return JointFilter(params, pose)


def fuse(state: JointFilter, q: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Let a measured attitude in; return innovation (3,), gain (6, 3) and NIS."""
    nis = state.innovate_attitude(q, covariance)
    state.update()
    return state.found.value.copy(), state.gain(9, 6), nis


def cross(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def moved(q: np.ndarray, rate: np.ndarray, w0: float, dt: float) -> np.ndarray:
    """Return q after ``dt`` at the constant rate (3,) of c against inertial space: eq. (3) by matrix exponential."""
    w1, w2, w3 = rate
    omega = np.array([[0, w3, -w2, w1], [-w3, 0, w1, w2], [w2, -w1, 0, w3], [-w1, -w2, -w3, 0]])
    hill = w0 * np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])
    return expm(0.5 * dt * (omega + hill)) @ q


def turned(q: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return the attitude of a c that stands turned by ``turn`` from that of ``q``."""
    return (Rotation.from_quat(q) * Rotation.from_rotvec(turn)).as_quat()


def test_step_turns_c_and_hills_frame_exactly(params: np.record, rng: np.random.Generator) -> None:
    hill = on_circle(0.4, params.akf.dt_s)
    for rate in (np.array([0.5, -1.0, 0.7]), np.array([200.0, -90.0, 10.0]), np.zeros(3)):
        q, drift = Rotation.random(rng=rng).as_quat(), 0.1 * rng.standard_normal(3)
        state = started(params, q, np.eye(3))
        state.akf.x[4:] = drift
        state.predict(rate, NO_FORCE, hill)
        np.testing.assert_allclose(state.akf.x[:4], moved(q, rate - drift, 0.4, params.akf.dt_s), atol=1e-14)
        np.testing.assert_array_equal(state.akf.x[4:], drift)


def test_transition_is_the_derivative_of_the_error_over_a_step(params: np.record, rng: np.random.Generator) -> None:
    dt, w0, h = params.akf.dt_s, 0.05, 1e-5
    rate, drift = np.array([0.6, -1.0, 0.4]), np.array([0.01, -0.02, 0.03])
    q = Rotation.random(rng=rng).as_quat()
    state = started(params, q, np.eye(3))
    state.akf.x[4:] = drift
    state.predict(rate, NO_FORCE, on_circle(w0, dt))
    slope, off, phi = np.zeros((6, 6)), np.empty(6), np.empty((3, 6))
    for column in range(6):
        for sign in (1.0, -1.0):
            d = sign * h * np.eye(6)[column]
            q_true = moved(turned(q, d[:3]), rate - drift - d[3:], w0, dt)
            akf.error(state.akf, q_true, drift + d[3:], off)
            slope[:, column] += sign * off / (2.0 * h)
    turn = np.linalg.norm(rate - drift) * dt  # 0.025 rad: its square over six is left out, its half is not
    akf.transition(dt * (rate - drift), dt, phi)
    np.testing.assert_allclose(phi[:, :3], slope[:3, :3], atol=1e-9)
    np.testing.assert_allclose(phi[:, 3:], slope[:3, 3:], atol=dt * turn**2 / 6.0 + 1e-12)
    np.testing.assert_allclose(slope[3:], np.eye(3, 6, 3), atol=1e-9)
    assert np.abs(slope[:3, 3:] + dt * np.eye(3)).max() > 50.0 * dt * turn**2 / 6.0


def test_filter_stays_equal_to_filterpy_on_the_same_data(params: np.record, rng: np.random.Generator) -> None:
    params.akf.sigma_gyro, params.akf.sigma_drift, params.akf.initial_drift_sigma = 1e-4, 1e-5, 1e-4
    dt, turn_of_h = params.akf.dt_s, Rotation.from_rotvec([0.0, ORBIT_RATE * params.akf.dt_s, 0.0])
    hill = on_circle(ORBIT_RATE, dt)
    root = SIGMA * (np.diag([1.0, 1.5, 2.0]) + 0.2 * rng.standard_normal((3, 3)))
    covariance = root @ root.T
    true = Rotation.from_euler("ZYX", [0.2, -0.1, 0.15])
    state = started(params, true.as_quat(), covariance)
    estimate, drift = true, params.akf.initial_drift.copy()
    reference = KalmanFilter(dim_x=6, dim_z=3)
    phi = np.empty((3, 6))
    reference.H = np.hstack([np.eye(3), np.zeros((3, 3))])
    reference.P = np.zeros((6, 6))
    reference.P[:3, :3], reference.P[3:, 3:] = covariance, 1e-8 * np.eye(3)
    reference.Q = dt**2 * np.diag([1e-8] * 3 + [1e-10] * 3)
    for k in range(400):
        w = np.array([0.5, -0.4, 0.3]) * math.sin(0.02 * k) + 1e-4 * rng.standard_normal(3)
        true = turn_of_h * true * Rotation.from_rotvec(dt * w)
        turn = dt * (w - drift)
        step = Rotation.from_rotvec(turn)
        estimate = turn_of_h * estimate * step
        reference.F = np.eye(6)
        reference.F[:3, :3], reference.F[:3, 3:] = step.as_matrix().T, -dt * (np.eye(3) - 0.5 * cross(turn))
        reference.x = np.zeros(6)
        reference.predict()
        state.predict(w, NO_FORCE, hill)
        akf.transition(turn, dt, phi)
        np.testing.assert_allclose(phi, reference.F[:3], atol=1e-15)
        if k % 8 == 7:
            seen = true * Rotation.from_rotvec(root @ rng.standard_normal(3))
            reference.update((estimate.inv() * seen).as_rotvec(), R=covariance)
            innovation, gain, nis = fuse(state, -seen.as_quat() if k % 16 == 7 else seen.as_quat(), covariance)
            np.testing.assert_allclose(innovation, (estimate.inv() * seen).as_rotvec(), atol=1e-12)
            np.testing.assert_allclose(gain, reference.K, rtol=1e-8, atol=1e-12)
            assert nis == pytest.approx(reference.y @ reference.SI @ reference.y, rel=1e-7)
            estimate = estimate * Rotation.from_rotvec(reference.x[:3])
            drift = drift + reference.x[3:]
        assert (estimate.inv() * Rotation.from_quat(state.akf.x[:4])).magnitude() < 1e-12
        np.testing.assert_allclose(state.akf.x[4:], drift, atol=1e-12)
        np.testing.assert_allclose(state.p_akf, reference.P, rtol=1e-9, atol=1e-18)
        np.testing.assert_array_equal(state.p_akf, state.p_akf.T)
        assert np.linalg.eigvalsh(state.p_akf).min() > 0.0
        assert np.linalg.norm(state.akf.x[:4]) == pytest.approx(1.0, abs=4e-16)
    assert np.abs(drift - params.akf.initial_drift).max() > 1e-6  # the updates did move it


def test_innovation_alone_changes_nothing(params: np.record, rng: np.random.Generator) -> None:
    state = started(params, Rotation.random(rng=rng).as_quat(), SIGMA**2 * np.eye(3))
    before = state.filters.copy()
    state.innovate_attitude(Rotation.random(rng=rng).as_quat(), SIGMA**2 * np.eye(3))
    assert state.filters.tobytes() == before.tobytes()


@pytest.mark.parametrize("angle_deg", [-180.0, -179.95, 0.0, 90.0, 179.95, 180.0, 269.0, 359.95])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -2, 2)])
def test_no_attitude_is_special_and_the_short_way_is_taken(
    params: np.record, angle_deg: float, axis: tuple[int, int, int]
) -> None:
    attitude = Rotation.from_rotvec(math.radians(angle_deg) * np.array(axis) / np.linalg.norm(axis))
    small = np.radians([0.2, -0.1, 0.05])
    seen = (attitude * Rotation.from_rotvec(small)).as_quat()
    for sign in (1.0, -1.0):
        state = started(params, attitude.as_quat(), SIGMA**2 * np.eye(3))
        innovation, _, nis = fuse(state, sign * seen, SIGMA**2 * np.eye(3))
        np.testing.assert_allclose(innovation, small, atol=1e-14)
        assert nis == pytest.approx(small @ small / (2.0 * SIGMA**2), rel=1e-9)
        left = Rotation.from_quat(state.akf.x[:4]).inv() * Rotation.from_quat(seen)
        np.testing.assert_allclose(left.as_rotvec(), 0.5 * small, atol=1e-12)


def test_measurement_half_a_turn_away_still_gives_a_unit_quaternion(params: np.record) -> None:
    for turn in (math.pi, -math.pi, 3.1):
        state = started(params, np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3))
        innovation, _, nis = fuse(state, Rotation.from_rotvec([0.0, turn, 0.0]).as_quat(), np.eye(3))
        assert abs(innovation[1]) == pytest.approx(abs(turn))
        assert nis == pytest.approx(turn**2 / 2.0)
        assert np.linalg.norm(state.akf.x[:4]) == pytest.approx(1.0, abs=4e-16)
        assert Rotation.from_quat(state.akf.x[:4]).magnitude() == pytest.approx(abs(turn) / 2.0)


def test_start_has_the_covariance_of_the_first_pose_and_of_the_drift(
    params: np.record, rng: np.random.Generator
) -> None:
    q, root = Rotation.random(rng=rng).as_quat(), rng.standard_normal((3, 3))
    state = started(params, q, root @ root.T)
    np.testing.assert_array_equal(state.akf.x[:4], q)
    np.testing.assert_array_equal(state.p_akf[:3, :3], root @ root.T)
    np.testing.assert_allclose(state.p_akf[3:, 3:], math.radians(1e-5) ** 2 * np.eye(3))
    np.testing.assert_array_equal(state.p_akf[:3, 3:], 0.0)
    np.testing.assert_allclose(np.degrees(state.akf.x[4:]), 2.78e-6)


def test_error_is_the_small_rotation_from_the_estimate_to_the_truth(
    params: np.record, rng: np.random.Generator
) -> None:
    q, turn, found = Rotation.random(rng=rng).as_quat(), np.array([1e-3, -2e-3, 3e-3]), np.empty(6)
    state = started(params, q, np.eye(3))
    state.akf.x[4:] = [1.0, 2.0, 3.0]
    akf.error(state.akf, -turned(q, turn), np.array([1.5, 2.0, 2.5]), found)
    np.testing.assert_allclose(found, [*turn, 0.5, 0.0, -0.5], atol=1e-12)


def test_rate_is_the_gyros_without_drift_and_without_hills_turn(params: np.record, rng: np.random.Generator) -> None:
    drift, w_CH, q = np.array([1e-3, 2e-3, -1e-3]), np.array([0.01, -0.02, 0.03]), Rotation.random(rng=rng).as_quat()
    state = started(params, q, np.eye(3))
    state.akf.x[4:] = drift
    after = turned(q, params.akf.dt_s * w_CH)
    rate = w_CH + Rotation.from_quat(after).inv().apply([0.0, -0.1, 0.0]) + drift
    state.predict(rate, NO_FORCE, on_circle(0.1, params.akf.dt_s))
    np.testing.assert_allclose(state.akf.w_CH_C, w_CH, atol=1e-5)  # the turns of c and of H do not commute


def test_errors_are_as_large_as_the_covariance(params: np.record, rng: np.random.Generator) -> None:
    runs, steps, marks = 30, 1504, (8, 400, 1504)
    w, dt = np.array([0.004, -0.003, 0.005]), params.akf.dt_s
    r, sigma_gyro, sigma_drift = SIGMA**2 * np.eye(3), params.akf.sigma_gyro, dt * params.akf.sigma_drift
    true = [Rotation.from_euler("ZYX", [-0.05, 0.05, 0.05]).as_quat()]
    hill, step = quat.from_rotation_vector(np.array([0.0, ORBIT_RATE * dt, 0.0])), on_circle(ORBIT_RATE, dt)
    for _ in range(steps):
        true.append(quat.multiply(quat.from_rotation_vector(w * dt), quat.multiply(true[-1], hill)))
    total, found = dict.fromkeys(marks, 0.0), np.empty(6)
    for _ in range(runs):
        state = started(params, turned(true[0], SIGMA * rng.standard_normal(3)), r)
        drift = params.akf.initial_drift + params.akf.initial_drift_sigma * rng.standard_normal(3)
        noise = rng.standard_normal((steps, 6))
        for k in range(1, steps + 1):
            state.predict(w + drift + sigma_gyro * noise[k - 1, :3], NO_FORCE, step)
            drift = drift + sigma_drift * noise[k - 1, 3:]
            if k % 8 == 0:
                fuse(state, turned(true[k], SIGMA * rng.standard_normal(3)), r)
            if k in total:
                akf.error(state.akf, true[k], drift, found)
                total[k] += found @ np.linalg.solve(state.p_akf, found)
    for mark in marks:
        assert chi2.ppf(0.0005, 6 * runs) < total[mark] < chi2.ppf(0.9995, 6 * runs), mark
