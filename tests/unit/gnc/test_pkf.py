"""The position filter: derivatives, independent implementations, and honest covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.linalg import block_diag, expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from hil.config.scenario import Scenario
from hil.core.messages import POSE, new
from hil.gnc.estimation import akf, joint_filter
from hil.gnc.estimation.error_state import BIAS, ROTATION, R, V
from hil.maths import quat
from hil.params import dynamics as dynamics_params
from hil.params import gnc as gnc_params
from tests.support.hill_steps import on_circle
from tests.support.joint_filter import JointFilter

HILL = on_circle(8.2e-4, 0.02)
STILL = on_circle(0.0, 0.02)  # of a frame that is at rest


@pytest.fixture
def params(plain_filters_1: Scenario) -> np.record:
    """Return the shipped parameters."""
    return gnc_params.navigation(plain_filters_1).fusion


def known_attitude(params: np.record) -> None:
    """Let the attitude filter have no noise and no uncertain drift, and estimate none."""
    own = params.akf
    own.sigma_gyro = own.sigma_drift = own.initial_drift_sigma = 0.0
    own.rate_sigma = own.rate_noise = own.initial_drift = 0.0


def discrete(scenario: Scenario, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Phi (9, 9) and Psi (9, 3) of one step from the continuous F and B of eq. (14) (Van Loan)."""
    w0 = dynamics_params.orbit_rate(scenario)
    to_h = quat.to_matrix(q).T
    f = np.zeros((12, 12))
    f[0:3, 3:6] = np.eye(3)
    f[3:6, 0:3] = np.diag([0.0, -(w0**2), 3.0 * w0**2])
    f[3:6, 3:6] = [[0, 0, 2 * w0], [0, 0, 0], [-2 * w0, 0, 0]]
    f[3:6, 6:9], f[3:6, 9:12] = -to_h, to_h
    whole = expm(f * scenario.step_s)
    return whole[:9, :9], whole[:9, 9:]


def process_noise(params: np.record, psi: np.ndarray) -> np.ndarray:
    """Return the process noise (9, 9) of PKF_PARAMS ``params``."""
    return params.sigma_accelerometer**2 * psi @ psi.T + block_diag(
        np.zeros((6, 6)), (params.dt_s * params.sigma_bias) ** 2 * np.eye(3)
    )


def turned(q: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return (Rotation.from_quat(q) * Rotation.from_rotvec(turn)).as_quat()


def pose_of(z: np.ndarray, q: np.ndarray, covariance: np.ndarray) -> np.record:
    pose = new(POSE)
    pose.z_TC_C, pose.q_CH, pose.covariance_position = z, q, covariance
    return pose


def middle(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the attitude half way."""
    total = before + after
    return total / np.linalg.norm(total)


def test_transition_is_the_matrix_exponential_of_the_process(
    params: np.record, plain_filters_1: Scenario, rng: np.random.Generator
) -> None:
    """Of the covariance, from the errors one at a time."""
    known_attitude(params)
    params.pkf.sigma_accelerometer = params.pkf.sigma_bias = 0.0
    for q in Rotation.random(5, rng=rng).as_quat():
        exact, _ = discrete(plain_filters_1, q)
        for i in range(9):
            state = JointFilter(params)
            state.akf.x[:4], state.p[i, i] = q, 1.0
            state.predict(np.zeros(3), np.zeros(3), STILL)
            np.testing.assert_allclose(state.p_pkf, np.outer(exact[:, i], exact[:, i]), atol=1e-9)


def new_filter(params: np.record, rng: np.random.Generator, q: np.ndarray) -> JointFilter:
    """Return filters whose errors are all correlated, at the attitude ``q``."""
    state, root = JointFilter(params), rng.standard_normal((15, 15))
    state.pkf.x, state.akf.x, state.p[:] = rng.standard_normal(9), [*q, 0.0, 0.0, 0.0], root @ root.T
    return state


def test_step_carries_state_and_joint_covariance_by_its_own_derivative(
    params: np.record, rng: np.random.Generator
) -> None:
    own = params.pkf
    own.dt_s, own.sigma_bias, own.sigma_accelerometer = 0.5, 0.3, 0.2
    own.hill_transition[:3, 3:], own.hill_response[3:] = 0.5 * np.eye(3), 0.5 * np.eye(3)
    own.hill_response[:3] = 0.125 * np.eye(3)
    known_attitude(params)
    q, force, rate = Rotation.random(rng=rng).as_quat(), rng.standard_normal(3), np.zeros(3)
    state = new_filter(params, rng, q)
    before = state.filters.copy()

    def after(dx: np.ndarray) -> tuple[np.ndarray, Rotation]:
        other = JointFilter(params)
        other.pkf.x = before.pkf.x + dx[:9]
        other.akf.x = [*turned(q, dx[9:12]), *dx[12:]]
        other.predict(rate, force, STILL)
        return other.pkf.x.copy(), Rotation.from_quat(other.akf.x[:4].copy())

    f, still = np.zeros((15, 15)), after(np.zeros(15))[1]
    for i in range(15):
        step = (1.0 if i < 9 else 1e-5) * np.eye(15)[i]
        (up, q_up), (down, q_down) = after(step), after(-step)
        f[:9, i] = (up - down) / (2.0 * step.max())
        f[9:12, i] = ((still.inv() * q_up).as_rotvec() - (still.inv() * q_down).as_rotvec()) / (2.0 * step.max())
    f[12:, 12:] = np.eye(3)
    assert np.abs(f[3:6, 9:12]).max() > 0.1
    f[:9, 12:] = 0.0  # the filter neglects what the drift turns within the step
    response = -f[:6, 6:9]
    np.testing.assert_allclose(f[:6, :6], own.hill_transition, atol=1e-12)
    expected = f @ before["p"][:15, :15] @ f.T
    expected[:9, :9] += process_noise(own, np.vstack([response, np.zeros((3, 3))]))
    state.predict(rate, force, STILL)
    np.testing.assert_allclose(state.p, expected, atol=1e-7)
    np.testing.assert_array_equal(state.p, state.p.T)


def test_measured_force_moves_the_state_as_thrust_does(
    params: np.record, plain_filters_1: Scenario, rng: np.random.Generator
) -> None:
    q, force = Rotation.random(rng=rng).as_quat(), np.array([0.01, -0.02, 0.03])
    known_attitude(params)
    state = JointFilter(params)
    state.pkf.x[6:], state.akf.x[:4] = [1e-3, 2e-3, 3e-3], q
    state.predict(np.zeros(3), force + state.pkf.x[6:], STILL)
    np.testing.assert_allclose(state.pkf.x[:6], discrete(plain_filters_1, q)[1][:6] @ force, atol=1e-10)


@pytest.mark.parametrize("delta_s", [0.0, 0.01, -0.3])
def test_update_agrees_with_the_derivative_of_what_the_camera_sees(
    params: np.record, rng: np.random.Generator, delta_s: float
) -> None:
    q, z, r = Rotation.random(rng=rng).as_quat(), rng.standard_normal(3), np.diag([0.1, 0.2, 0.3])
    state = new_filter(params, rng, q)
    x, whole = state.pkf.x.copy(), state.p.copy()

    def seen(dx: np.ndarray, turn: np.ndarray) -> np.ndarray:
        moved = x + dx
        return quat.to_matrix(turned(q, turn)) @ -(moved[:3] + delta_s * moved[3:6])

    h = np.zeros((3, 15))
    for i in range(9):
        h[:, i] = (seen(np.eye(9)[i], np.zeros(3)) - seen(-np.eye(9)[i], np.zeros(3))) / 2.0
    for i in range(3):
        h[:, 9 + i] = (seen(np.zeros(9), 1e-5 * np.eye(3)[i]) - seen(np.zeros(9), -1e-5 * np.eye(3)[i])) / 2e-5
    s = h @ whole @ h.T + r
    best = whole @ h.T @ np.linalg.inv(s)
    nis = state.innovate_position(z, r, delta_s)
    innovation = state.found.value.copy()
    state.update()
    np.testing.assert_allclose(state.found.h[:, :15], h, atol=1e-9)
    np.testing.assert_allclose(innovation, z - seen(np.zeros(9), np.zeros(3)), atol=1e-14)
    np.testing.assert_allclose(state.gain(0, 9), best[:9], atol=1e-8)
    np.testing.assert_array_equal(state.gain(9, 6), 0.0)
    np.testing.assert_allclose(state.pkf.x, x + best[:9] @ innovation, atol=1e-8)
    assert nis == pytest.approx(innovation @ np.linalg.solve(s, innovation), rel=1e-8)
    keep = np.eye(15) - np.vstack([best[:9], np.zeros((6, 3))]) @ h
    expected = keep @ whole @ keep.T
    expected[:9, :9] += best[:9] @ r @ best[:9].T
    np.testing.assert_allclose(state.p, expected, atol=1e-7)
    np.testing.assert_array_equal(state.p, state.p.T)


def test_innovation_alone_changes_nothing(params: np.record, rng: np.random.Generator) -> None:
    state = new_filter(params, rng, Rotation.random(rng=rng).as_quat())
    before = state.filters.copy()
    state.innovate_position(np.ones(3), np.eye(3))
    assert state.filters.tobytes() == before.tobytes()


def test_filter_with_a_known_attitude_stays_equal_to_filterpy_on_the_same_data(
    params: np.record, plain_filters_1: Scenario, rng: np.random.Generator
) -> None:
    known_attitude(params)
    r, rate = np.diag([1.0, 2.0, 3.0]) * 0.005**2, np.array([0.02, -0.03, 0.01])
    q = Rotation.from_euler("ZYX", [0.2, -0.1, 0.15]).as_quat()
    state = JointFilter(params, pose_of(np.array([-5.0, 0.3, -0.3]), q, r))
    reference = KalmanFilter(dim_x=9, dim_z=3)
    reference.x, reference.P = state.pkf.x.copy(), state.p_pkf.copy()
    for k in range(400):
        before, force = state.akf.x[:4].copy(), 5e-3 * rng.standard_normal(3)
        state.predict(rate, force, HILL)
        phi, psi = discrete(plain_filters_1, middle(before, state.akf.x[:4]))
        reference.predict(u=force, B=psi, F=phi, Q=process_noise(params.pkf, psi))
        if k % 8 == 7:
            z = np.array([-5.0, 0.3, -0.3]) + 0.005 * rng.standard_normal(3)
            h = np.hstack([-quat.to_matrix(state.akf.x[:4].copy()), np.zeros((3, 6))])
            reference.update(z, R=r, H=h)
            nis = state.innovate_position(z, r)
            state.update()
            assert nis == pytest.approx(reference.y @ reference.SI @ reference.y, rel=1e-6)
        np.testing.assert_allclose(state.pkf.x, reference.x, atol=1e-9)
        np.testing.assert_allclose(state.p_pkf, reference.P, atol=1e-11)
        np.testing.assert_array_equal(state.p[:9, 9:], 0.0)
        assert np.linalg.eigvalsh(state.p_pkf).min() > 0.0


def test_filter_stays_equal_to_a_joint_filter_that_does_not_correct_the_attitude(
    params: np.record, plain_filters_1: Scenario, rng: np.random.Generator
) -> None:
    """Fifteen states in numpy, the attitude's corrected by measured attitudes alone (Schmidt 1966)."""
    own = params.akf
    own.sigma_gyro, own.sigma_drift, own.initial_drift_sigma = 1e-3, 1e-4, 1e-3
    own.rate_sigma = own.rate_noise = 0.0
    r, r_turn = np.diag([1.0, 2.0, 3.0]) * 0.005**2, np.diag([2.0, 1.0, 3.0]) * 5e-4**2
    pose = pose_of(np.array([-10.0, 0.5, -0.5]), Rotation.from_euler("ZYX", [0.2, -0.1, 0.15]).as_quat(), r)
    pose.covariance_attitude = r_turn
    state = JointFilter(params, pose)
    x, whole, h_turn = state.pkf.x.copy(), state.p.copy(), np.eye(3, 15, 9)
    smallest, rotation = math.inf, np.empty((3, 6))
    for k in range(400):
        before, drift = state.akf.x[:4].copy(), state.akf.x[4:].copy()
        rate = np.array([0.02, -0.03, 0.01]) + 1e-3 * rng.standard_normal(3)
        force = np.array([0.02, -0.05, 0.03]) * math.sin(0.05 * k)
        state.predict(rate, force, HILL)
        akf.transition(0.02 * (rate - drift), 0.02, rotation)
        phi, psi = discrete(plain_filters_1, middle(before, state.akf.x[:4]))
        f = block_diag(phi, np.vstack([rotation, np.eye(3, 6, 3)]))
        for i in range(3):
            # A(turned q) = A - [turn]x A: the force in H gains A.T (turn x force)
            f[:9, 9 + i] = psi @ np.cross(np.eye(3)[i], force - x[6:])
        x = phi @ x + psi @ force
        whole = f @ whole @ f.T + block_diag(
            process_noise(params.pkf, psi), 0.02**2 * 1e-6 * np.eye(3), 0.02**2 * 1e-8 * np.eye(3)
        )
        if k % 8 == 7:
            state.innovate_attitude(turned(state.akf.x[:4], 5e-4 * rng.standard_normal(3)), r_turn)
            state.update()
            gain = np.vstack([np.zeros((9, 3)), (whole @ h_turn.T @ np.linalg.inv(whole[9:12, 9:12] + r_turn))[9:]])
            keep = np.eye(15) - gain @ h_turn
            whole = keep @ whole @ keep.T + gain @ r_turn @ gain.T
            z, a = pose.z_TC_C + 0.005 * rng.standard_normal(3), quat.to_matrix(state.akf.x[:4].copy())
            h = np.hstack([-a, np.zeros((3, 6)), np.cross(np.eye(3), a @ x[:3]).T, np.zeros((3, 3))])
            s = h @ whole @ h.T + r
            gain = np.vstack([(whole @ h.T @ np.linalg.inv(s))[:9], np.zeros((6, 3))])
            y = z + a @ x[:3]
            x, keep = x + gain[:9] @ y, np.eye(15) - gain @ h
            whole = keep @ whole @ keep.T + gain @ r @ gain.T
            nis = state.innovate_position(z, r)
            state.update()
            assert nis == pytest.approx(y @ np.linalg.solve(s, y), rel=1e-7)
        np.testing.assert_allclose(state.pkf.x, x, atol=1e-10)
        np.testing.assert_allclose(state.p, whole, rtol=1e-8, atol=1e-12)
        smallest = min(smallest, np.linalg.eigvalsh(state.p).min())
    assert smallest > 0.0
    # what is carried along matters: without it the filter would trust itself more than it may
    assert np.abs(state.p[:3, 9:12]).max() > 0.1 * math.sqrt(state.p[0, 0] * state.p[9, 9])


def test_start_stands_at_the_first_pose_at_rest(params: np.record, rng: np.random.Generator) -> None:
    q, root, half = Rotation.random(rng=rng).as_quat(), *(rng.standard_normal((2, 3, 3)))
    r_CT_H = np.array([5.0, -0.3, 0.3])
    z, lever = -quat.to_matrix(q) @ r_CT_H, np.zeros((3, 3))
    for i in range(3):
        d = 1e-5 * np.eye(3)[i]
        lever[:, i] = (quat.to_matrix(turned(q, -d)).T @ z - quat.to_matrix(turned(q, d)).T @ z) / 2e-5
    pose = pose_of(z, q, root @ root.T)
    pose.covariance_attitude = half @ half.T
    state = JointFilter(params, pose)
    np.testing.assert_allclose(state.pkf.x, [*r_CT_H, 0, 0, 0, 3e-4, 3e-4, 3e-4], atol=1e-14)
    back = quat.to_matrix(q).T
    expected = back @ root @ root.T @ back.T + lever @ half @ half.T @ lever.T
    np.testing.assert_allclose(state.p[:3, :3], expected, atol=1e-7)
    np.testing.assert_allclose(np.diag(state.p)[3:9], np.repeat([0.02**2, 5e-4**2], 3))
    np.testing.assert_allclose(state.p[:3, 9:12], lever @ half @ half.T, atol=1e-7)
    np.testing.assert_array_equal(state.p[3:9, 9:], 0.0)


def test_sigma_is_the_root_of_the_diagonal(params: np.record, rng: np.random.Generator) -> None:
    state, out = new_filter(params, rng, np.array([0.0, 0.0, 0.0, 1.0])), np.empty(3)
    for first in (R, V, BIAS, ROTATION):
        joint_filter.sigma(state.filters, first, out)
        np.testing.assert_allclose(out, np.sqrt(np.diag(state.p)[first : first + 3]))


def test_errors_with_a_known_attitude_are_as_large_as_the_covariance(
    params: np.record, plain_filters_1: Scenario, rng: np.random.Generator
) -> None:
    known_attitude(params)
    own, runs, marks = params.pkf, 30, (8, 400, 1504)
    q, r, root = np.array([0.0, 0.0, 0.0, 1.0]), 0.005**2 * np.diag([1.0, 4.0, 9.0]), 0.005 * np.arange(1.0, 4.0)
    (phi, psi), total = discrete(plain_filters_1, q), dict.fromkeys(marks, 0.0)
    for _ in range(runs):
        truth = np.zeros(9)
        truth[:3] = [5.0, -0.3, 0.3]
        truth[3:6] = own.initial_velocity_sigma * rng.standard_normal(3)
        truth[6:] = own.initial_bias + own.initial_bias_sigma * rng.standard_normal(3)
        state = JointFilter(params, pose_of(root * rng.standard_normal(3) - truth[:3], q, r))
        noise = rng.standard_normal((max(marks) + 1, 9))
        for k in range(1, max(marks) + 1):
            force = np.array([5e-3 * math.sin(0.01 * k), 2e-3, -3e-3])
            sample = force + truth[6:] + own.sigma_accelerometer * noise[k, :3]
            state.predict(np.zeros(3), sample, STILL)
            truth[:6] = phi[:6, :6] @ truth[:6] + psi[:6] @ force
            truth[6:] += 0.02 * own.sigma_bias * noise[k, 3:6]
            if k % 8 == 0:
                state.innovate_position(root * noise[k, 6:] - truth[:3], r)
                state.update()
            if k in total:
                total[k] += (truth - state.pkf.x) @ np.linalg.solve(state.p_pkf, truth - state.pkf.x)
    for mark in marks:
        assert chi2.ppf(0.0005, 9 * runs) < total[mark] < chi2.ppf(0.9995, 9 * runs), mark
