"""The attitude filter as printed, with seven additive states: derivatives, an independent implementation, its worth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from hil.config.scenario import Scenario
from hil.core.messages import POSE, new
from hil.gnc import akf
from hil.maths import quat
from hil.monte_carlo import akf_additive as additive
from hil.params import gnc as gnc_params
from tests.support.hill_steps import on_circle
from tests.support.joint_filter import NO_FORCE, JointFilter

SIGMA = math.radians(0.033)
ORBIT_RATE = 8.2e-4  # rad/s


@pytest.fixture
def params(plain_filters_1: Scenario) -> np.record:
    """Return the shipped parameters, for a frame H whose rate is known."""
    own: np.record = gnc_params.navigation(plain_filters_1).fusion.akf
    own.rate_sigma = own.rate_noise = 0.0
    return own


def pose_of(q: np.ndarray, covariance: np.ndarray) -> np.record:
    pose = new(POSE)
    pose.q_CH, pose.covariance_attitude = q, covariance
    return pose


def xi(q: np.ndarray) -> np.ndarray:
    return np.array([[q[3], -q[2], q[1]], [q[2], q[3], -q[0]], [-q[1], q[0], q[3]], -q[:3]])


def omega(w: np.ndarray) -> np.ndarray:
    """Return Omega(w) (4, 4) of the bench paper's eq. (3)."""
    return np.array([[0, w[2], -w[1], w[0]], [-w[2], 0, w[0], w[1]], [w[1], -w[0], 0, w[2]], [-w[0], -w[1], -w[2], 0]])


def hill_turn(w0: float) -> np.ndarray:
    """Return the part of dq/dt that comes from the turn [0, -w0, 0] of H, (4, 4)."""
    return 0.5 * w0 * np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 0, 0], [0, -1, 0, 0]])


def angles(q: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(q).as_euler("ZYX")[::-1]


def angles_of(q: np.ndarray) -> np.ndarray:
    """Return the angles as the kernel gives them."""
    found = np.empty(3)
    additive.angles_into(q, found)
    return found


def jacobian(q: np.ndarray) -> np.ndarray:
    """Return d(theta)/d(q) (3, 4) as the kernel gives it, which a test holds against differences."""
    h = np.zeros((3, 7))
    additive.angle_jacobian(q, h)
    return h[:, :4]


def test_hill_part_of_the_process_is_eq_3(rng: np.random.Generator) -> None:
    for q in Rotation.random(10, rng=rng).as_quat():
        w, w0 = rng.standard_normal(3), 0.3
        expected = 0.5 * omega(w - quat.to_matrix(q) @ np.array([0.0, -w0, 0.0])) @ q
        np.testing.assert_allclose((0.5 * omega(w) + hill_turn(w0)) @ q, expected, atol=1e-14)


def test_turn_response_is_the_change_of_q_under_a_small_turn(rng: np.random.Generator) -> None:
    found = np.empty((4, 3))
    for q in Rotation.random(10, rng=rng).as_quat():
        additive.rotation_response(q, found)
        for axis in range(3):
            turn = np.zeros(3)
            turn[axis] = 1e-6
            ends = [quat.multiply(quat.from_rotation_vector(s * turn), q) for s in (1.0, -1.0)]
            np.testing.assert_allclose(0.5 * found[:, axis], (ends[0] - ends[1]) / 2e-6, atol=1e-9)


def test_angles_are_scipys_yaw_pitch_roll(rng: np.random.Generator) -> None:
    for rotation in Rotation.random(100, rng=rng):
        q = rotation.as_quat()
        np.testing.assert_allclose(angles_of(q), angles(q), atol=1e-9)


def test_angle_jacobian_is_the_derivative_of_the_angles(rng: np.random.Generator) -> None:
    step = 1e-6
    for theta in rng.uniform(-1.2, 1.2, (20, 3)):
        q = Rotation.from_euler("ZYX", theta).as_quat()
        for column in range(4):  # each component is free: eq. (9) does not ask for unit length
            d = np.zeros(4)
            d[column] = step
            slope = (angles_of(q + d) - angles_of(q - d)) / (2.0 * step)
            np.testing.assert_allclose(jacobian(q)[:, column], slope, rtol=1e-6, atol=1e-7)


def test_transition_is_the_derivative_of_the_step(params: np.record, rng: np.random.Generator) -> None:
    hill = on_circle(0.05, params.dt_s)
    rate = np.array([0.03, -0.05, 0.02])
    x = np.concatenate([Rotation.random(rng=rng).as_quat(), [1e-3, -2e-3, 3e-3]])
    q_next, phi, other = np.empty(4), np.empty((7, 7)), np.empty((7, 7))
    additive.transition(params, x, rate, hill, q_next, phi)
    np.testing.assert_allclose(
        q_next, expm(params.dt_s * (0.5 * omega(rate - x[4:]) + hill_turn(0.05))) @ x[:4], atol=1e-15
    )
    for column in range(7):
        d, ends = np.zeros(7), []
        d[column] = 1e-5
        for sign in (1.0, -1.0):
            q = np.empty(4)
            additive.transition(params, x + sign * d, rate, hill, q, other)
            ends.append(np.concatenate([q, x[4:] + sign * d[4:]]))
        slope = (ends[0] - ends[1]) / 2e-5
        # the drift's columns leave out half the turn within the step, 0.6 mrad here
        np.testing.assert_allclose(phi[:, column], slope, atol=1e-9 if column < 4 else 0.01 * 1e-3)
    assert np.abs(phi[:4, 4:]).max() > 0.005


def test_filter_stays_equal_to_filterpy_on_the_same_data(params: np.record, rng: np.random.Generator) -> None:
    params.sigma_gyro, params.sigma_drift = 1e-4, 1e-5
    true = Rotation.from_euler("ZYX", [0.2, -0.1, 0.15])
    covariance = np.diag([1.0, 2.0, 3.0]) * SIGMA**2
    state = new(additive.AKF_ADDITIVE_STATE)
    additive.start(params, pose_of(true.as_quat(), covariance), state)
    ekf = ExtendedKalmanFilter(dim_x=7, dim_z=3)
    ekf.x, ekf.P = state.x.copy(), state.p.copy()
    dt, hill = params.dt_s, on_circle(ORBIT_RATE, params.dt_s)
    for k in range(400):
        rate = np.array([0.02, -0.03, 0.01]) + 1e-4 * rng.standard_normal(3)
        true = true * Rotation.from_rotvec(dt * rate)
        f = expm(dt * (0.5 * omega(rate - ekf.x[4:]) + hill_turn(ORBIT_RATE)))
        q_next = f @ ekf.x[:4]
        ekf.F = np.eye(7)
        ekf.F[:4, :4], ekf.F[:4, 4:] = f, -0.5 * dt * xi(q_next)
        gyro, drift = 0.25 * dt**2 * params.sigma_gyro**2, dt**2 * params.sigma_drift**2
        ekf.Q = np.zeros((7, 7))
        ekf.Q[:4, :4], ekf.Q[4:, 4:] = gyro * xi(q_next) @ xi(q_next).T, drift * np.eye(3)
        ekf.predict_x = lambda u=0, q=q_next: setattr(ekf, "x", np.concatenate([q / np.linalg.norm(q), ekf.x[4:]]))
        ekf.predict()
        additive.predict(params, state, rate, hill)
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
            additive.update(state, seen, covariance)
            assert state.nis == pytest.approx(ekf.y @ ekf.SI @ ekf.y, rel=1e-7)
        np.testing.assert_allclose(state.x, ekf.x, atol=1e-11)
        np.testing.assert_allclose(state.p, ekf.P, rtol=1e-9, atol=1e-17)
        np.testing.assert_array_equal(state.p, state.p.T)
        assert np.linalg.eigvalsh(state.p).min() > -1e-18


def test_update_takes_the_short_way_across_half_a_turn(params: np.record) -> None:
    before = Rotation.from_euler("ZYX", [179.9, 0.0, 0.0], degrees=True).as_quat()
    seen = Rotation.from_euler("ZYX", [-179.9, 0.0, 0.0], degrees=True).as_quat()
    state = new(additive.AKF_ADDITIVE_STATE)
    additive.start(params, pose_of(before, SIGMA**2 * np.eye(3)), state)
    additive.update(state, seen, SIGMA**2 * np.eye(3))
    assert abs(math.degrees(angles_of(state.x[:4].copy())[2])) == pytest.approx(180.0, abs=1e-3)
    assert state.nis == pytest.approx(0.2**2 / (2.0 * 0.033**2), rel=1e-3)


def test_angle_covariance_is_the_scatter_of_the_angles(rng: np.random.Generator) -> None:
    q = Rotation.from_euler("ZYX", [0.4, 0.6, -0.3]).as_quat()
    root = 1e-4 * rng.standard_normal((3, 3))
    found = np.empty((3, 3))
    additive.angle_covariance(q, root @ root.T, found)
    turns = rng.standard_normal((4000, 3)) @ root.T
    seen = np.array([angles_of(quat.multiply(quat.from_rotation_vector(t), q)) for t in turns])
    whitened = np.linalg.solve(np.linalg.cholesky(found), (seen - angles_of(q)).T)
    np.testing.assert_allclose(whitened @ whitened.T / len(turns), np.eye(3), atol=0.1)


def test_start_has_the_covariance_of_the_first_pose_and_of_the_drift(
    params: np.record, rng: np.random.Generator
) -> None:
    q, root = Rotation.random(rng=rng).as_quat(), rng.standard_normal((3, 3))
    state, found = new(additive.AKF_ADDITIVE_STATE), np.empty((6, 6))
    additive.start(params, pose_of(q, root @ root.T), state)
    additive.error_covariance(state, found)
    np.testing.assert_allclose(found[:3, :3], root @ root.T, atol=1e-13)
    np.testing.assert_allclose(found[3:, 3:], math.radians(1e-5) ** 2 * np.eye(3))
    np.testing.assert_array_equal(found[:3, 3:], 0.0)
    np.testing.assert_allclose(np.degrees(state.x[4:]), 2.78e-6)


def test_rate_is_the_gyros_without_drift_and_without_hills_turn(params: np.record, rng: np.random.Generator) -> None:
    q, drift = Rotation.random(rng=rng).as_quat(), np.array([1e-3, 2e-3, -1e-3])
    state, w_CH = new(additive.AKF_ADDITIVE_STATE), np.array([0.01, -0.02, 0.03])
    state.x = [*q, *drift]
    rate = w_CH + Rotation.from_quat(q).inv().apply([0.0, -ORBIT_RATE, 0.0]) + drift
    additive.predict(params, state, rate, on_circle(ORBIT_RATE, params.dt_s))
    np.testing.assert_allclose(state.w_CH_C, w_CH, atol=ORBIT_RATE * 1e-3)


class Both:
    """The same motion and measurements through both forms of the attitude filter."""

    def __init__(self, scenario: Scenario, pitch_deg: float, rng: np.random.Generator) -> None:
        self.params: np.record = gnc_params.navigation(scenario).fusion
        self.params.akf.rate_sigma = self.params.akf.rate_noise = 0.0
        own = self.params.akf
        self._rng, self._steps = rng, 0
        self.drift = own.initial_drift + own.initial_drift_sigma * rng.standard_normal(3)
        self.q = Rotation.from_euler("ZYX", [-3.0, pitch_deg, 3.0], degrees=True).as_quat()
        turn = self.params.orbit.mean_motion * own.dt_s
        self._hill = quat.from_rotation_vector(np.array([0.0, turn, 0.0]))
        self._step = on_circle(self.params.orbit.mean_motion, own.dt_s)
        seen = pose_of(self._measured(), SIGMA**2 * np.eye(3))
        seen.covariance_position = np.eye(3)
        self.ours, self.printed = JointFilter(self.params, seen), new(additive.AKF_ADDITIVE_STATE)
        additive.start(own, seen, self.printed)

    def _measured(self) -> np.ndarray:
        return quat.multiply(quat.from_rotation_vector(SIGMA * self._rng.standard_normal(3)), self.q)

    def step(self) -> None:
        own, w = self.params.akf, np.array([0.004, -0.003, 0.005])
        self._steps += 1
        self.q = quat.multiply(quat.from_rotation_vector(w * own.dt_s), quat.multiply(self.q, self._hill))
        rate = w + self.drift + own.sigma_gyro * self._rng.standard_normal(3)
        self.ours.predict(rate, NO_FORCE, self._step)
        additive.predict(own, self.printed, rate, self._step)
        if self._steps % 8 == 0:
            seen = self._measured()
            self.ours.innovate_attitude(seen, SIGMA**2 * np.eye(3))
            self.ours.update()
            additive.update(self.printed, seen, SIGMA**2 * np.eye(3))

    def printed_p(self) -> np.ndarray:
        """Return the covariance (6, 6) of the additive filter."""
        p = np.empty((6, 6))
        additive.error_covariance(self.printed, p)
        return p

    def apart(self) -> np.ndarray:
        """Return the difference (6,) of the two estimates, in sigmas."""
        off = np.empty(6)
        akf.error(self.ours.akf, self.printed.x[:4].copy(), self.printed.x[4:].copy(), off)
        return np.abs(off) / np.sqrt(np.diag(self.ours.p_akf))

    def nees(self) -> np.ndarray:
        found, off = [], np.empty(6)
        for state, p in ((self.ours.akf, self.ours.p_akf), (self.printed, self.printed_p())):
            akf.error(state, self.q, self.drift, off)
            found.append(off @ np.linalg.solve(p, off))
        return np.array(found)


def test_both_forms_estimate_the_same_and_are_equally_honest(
    plain_filters_2: Scenario, rng: np.random.Generator
) -> None:
    """In an approach the multiplicative form wins nothing measurable: 0.3 % of a sigma, 0.01 % of a variance."""
    runs, marks = 30, (8, 120, 400)
    total, apart = {mark: np.zeros(2) for mark in marks}, np.zeros(6)
    for _ in range(runs):
        both = Both(plain_filters_2, 3.0, rng)
        for k in range(1, max(marks) + 1):
            both.step()
            apart = np.maximum(apart, both.apart())
            if k in total:
                total[k] += both.nees()
        np.testing.assert_allclose(np.diag(both.printed_p()), np.diag(both.ours.p_akf), rtol=1e-4)
    assert 1e-6 < apart.max() < 0.003  # not the same arithmetic, yet the same estimate
    for mark in marks:
        low, high = (chi2.ppf(p, 6 * runs) for p in (0.0005, 0.9995))
        assert np.all((low < total[mark]) & (total[mark] < high)), mark
        assert total[mark][0] == pytest.approx(total[mark][1], rel=1e-3)


def test_only_the_additive_form_suffers_where_pitch_is_near_a_right_angle(plain_filters_2: Scenario) -> None:
    worst = 0.0
    for seed in range(5):
        level, steep = (Both(plain_filters_2, pitch, np.random.default_rng(seed)) for pitch in (3.0, 89.95))
        for _ in range(200):
            level.step()
            steep.step()
            worst = max(worst, steep.apart().max())
        assert steep.nees()[0] == pytest.approx(level.nees()[0], rel=1e-6)  # no attitude is special
    assert worst > 0.3


def test_additive_covariance_has_a_direction_along_q_that_means_nothing(
    plain_filters_2: Scenario, rng: np.random.Generator
) -> None:
    both = Both(plain_filters_2, 3.0, rng)
    for k in range(401):
        if k > 0:
            both.step()
        q, p = both.printed.x[:4].copy(), both.printed.p[:4, :4].copy()
        across = np.empty((4, 3))
        additive.rotation_response(q, across)
        sigma_along, sigma_across = math.sqrt(max(0.0, q @ p @ q)), np.sqrt(np.diag(across.T @ p @ across))
        # no unit quaternion errs along itself; the filter holds rounding and leaks of its own updates there
        assert sigma_along < 1e-3 * sigma_across.min()
        assert np.linalg.norm(q) == pytest.approx(1.0, abs=4e-16)
        if k == 0:
            assert sigma_along < 1e-10
    assert sigma_along > 1e-10
    whole = both.printed.p
    assert np.linalg.cond(whole) > 1e10  # so that seven states have no NEES
    scaled = np.sqrt(np.diag(both.ours.p_akf))
    assert np.linalg.cond(both.ours.p_akf / np.outer(scaled, scaled)) < 1e3
