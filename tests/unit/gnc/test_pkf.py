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
from hil.gnc import akf, pkf
from hil.maths import quat
from hil.params import dynamics as dynamics_params
from hil.params import gnc as gnc_params
from tests.support.hill_steps import on_circle

KNOWN, STAYS = np.zeros((6, 6)), np.eye(6)  # covariance and transition of an attitude without error
HILL = on_circle(8.2e-4, 0.02)


@pytest.fixture
def params(scheme_1: Scenario) -> np.record:
    """Return the shipped parameters."""
    return gnc_params.navigation(scheme_1).fusion.pkf


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
    return params.sigma_accelerometer**2 * psi @ psi.T + block_diag(
        np.zeros((6, 6)), (params.dt_s * params.sigma_bias) ** 2 * np.eye(3)
    )


def turned(q: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return (Rotation.from_quat(q) * Rotation.from_rotvec(turn)).as_quat()


def pose_of(z: np.ndarray, q: np.ndarray, covariance: np.ndarray) -> np.record:
    pose = new(POSE)
    pose.z_TC_C, pose.q_CH, pose.covariance_position = z, q, covariance
    return pose


def joint(state: np.record, attitude_p: np.ndarray) -> np.ndarray:
    """Return the covariance (15, 15) of this filter's and the attitude filter's error."""
    return np.block([[state.p, state.c], [state.c.T, attitude_p]])


def new_state(rng: np.random.Generator) -> tuple[np.record, np.ndarray]:
    """Return a state that is correlated with an attitude's error, and the covariance of the latter."""
    state, root = new(pkf.PKF_STATE), rng.standard_normal((15, 15))
    whole = root @ root.T
    state.x, state.p, state.c = rng.standard_normal(9), whole[:9, :9], whole[:9, 9:]
    return state, whole[9:, 9:].copy()


def fuse(
    state: np.record, z: np.ndarray, r: np.ndarray, delta_s: float, q: np.ndarray, attitude_p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Let a measured position in; return its sensitivity (3, 15), innovation, gain (9, 3) and NIS."""
    h, h_turn, gain, innovation = np.empty((3, 9)), np.empty((3, 3)), np.empty((9, 3)), np.empty(3)
    nis = pkf.innovate(state, z, r, delta_s, q, attitude_p, h, h_turn, gain, innovation)
    pkf.update(state, r, attitude_p, h, h_turn, gain, innovation)
    return np.hstack([h, h_turn, np.zeros((3, 3))]), innovation, gain, nis


def test_transition_is_the_matrix_exponential_of_the_process(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    phi = np.empty((9, 9))
    for q in Rotation.random(5, rng=rng).as_quat():
        pkf.transition(params, q, phi)
        exact, response = discrete(scheme_1, q)
        np.testing.assert_allclose(phi, exact, atol=1e-9)
        np.testing.assert_allclose(phi[:6, 6:], -response[:6], atol=1e-9)


def test_step_carries_state_and_joint_covariance_by_its_own_derivative(
    params: np.record, rng: np.random.Generator
) -> None:
    params.dt_s, params.sigma_bias, params.sigma_accelerometer = 0.5, 0.3, 0.2
    params.hill_transition[:3, 3:], params.hill_response[3:] = 0.5 * np.eye(3), 0.5 * np.eye(3)
    params.hill_response[:3] = 0.125 * np.eye(3)
    q, force = Rotation.random(rng=rng).as_quat(), rng.standard_normal(3)
    state, attitude_p = new_state(rng)
    before, attitude_phi, phi = state.copy(), np.eye(6), np.empty((9, 9))
    attitude_phi[:3] += 0.1 * rng.standard_normal((3, 6))  # the drift stays

    def after(dx: np.ndarray, turn: np.ndarray) -> np.ndarray:
        other = before.copy()
        other.x += dx
        pkf.predict(params, other, force, turned(q, turn), attitude_p, attitude_phi, HILL)
        return other.x.copy()

    f = block_diag(np.zeros((9, 9)), attitude_phi)
    for i in range(9):
        f[:9, i] = (after(np.eye(9)[i], np.zeros(3)) - after(-np.eye(9)[i], np.zeros(3))) / 2.0
    for i in range(3):
        f[:9, 9 + i] = (after(np.zeros(9), 1e-5 * np.eye(3)[i]) - after(np.zeros(9), -1e-5 * np.eye(3)[i])) / 2e-5
    pkf.transition(params, q, phi)
    np.testing.assert_allclose(phi, f[:9, :9], atol=1e-12)
    assert np.abs(f[3:6, 9:12]).max() > 0.1
    expected = f @ joint(before, attitude_p) @ f.T
    expected[:9, :9] += process_noise(params, np.vstack([phi[:6, 6:], np.zeros((3, 3))]))
    pkf.predict(params, state, force, q, attitude_p, attitude_phi, HILL)
    np.testing.assert_allclose(state.p, expected[:9, :9], atol=1e-8)
    np.testing.assert_allclose(state.c, expected[:9, 9:], atol=1e-8)
    np.testing.assert_array_equal(state.p, state.p.T)


def test_measured_force_moves_the_state_as_thrust_does(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    q, force, state = Rotation.random(rng=rng).as_quat(), np.array([0.01, -0.02, 0.03]), new(pkf.PKF_STATE)
    state.x[6:] = [1e-3, 2e-3, 3e-3]
    pkf.predict(params, state, force + state.x[6:], q, KNOWN, STAYS, HILL)
    np.testing.assert_allclose(state.x[:6], discrete(scheme_1, q)[1][:6] @ force, atol=1e-10)


@pytest.mark.parametrize("delta_s", [0.0, 0.01, -0.3])
def test_update_agrees_with_the_derivative_of_what_the_camera_sees(rng: np.random.Generator, delta_s: float) -> None:
    q, z, r = Rotation.random(rng=rng).as_quat(), rng.standard_normal(3), np.diag([0.1, 0.2, 0.3])
    state, attitude_p = new_state(rng)
    x, whole = state.x.copy(), joint(state, attitude_p)

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
    found_h, innovation, gain, nis = fuse(state, z, r, delta_s, q, attitude_p)
    np.testing.assert_allclose(found_h, h, atol=1e-9)
    np.testing.assert_allclose(innovation, z - seen(np.zeros(9), np.zeros(3)), atol=1e-14)
    np.testing.assert_allclose(gain, best[:9], atol=1e-8)
    np.testing.assert_allclose(state.x, x + best[:9] @ innovation, atol=1e-8)
    assert nis == pytest.approx(innovation @ np.linalg.solve(s, innovation), rel=1e-8)
    keep = np.eye(15) - np.vstack([best[:9], np.zeros((6, 3))]) @ h
    expected = keep @ whole @ keep.T
    expected[:9, :9] += best[:9] @ r @ best[:9].T
    np.testing.assert_allclose(joint(state, attitude_p), expected, atol=1e-7)
    np.testing.assert_array_equal(state.p, state.p.T)


def test_innovation_alone_changes_nothing(rng: np.random.Generator) -> None:
    state, attitude_p = new_state(rng)
    before = state.copy()
    q, h, h_turn = Rotation.random(rng=rng).as_quat(), np.empty((3, 9)), np.empty((3, 3))
    pkf.innovate(state, np.ones(3), np.eye(3), 0.0, q, attitude_p, h, h_turn, np.empty((9, 3)), np.empty(3))
    assert state.tobytes() == before.tobytes()


def test_filter_with_a_known_attitude_stays_equal_to_filterpy_on_the_same_data(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    r = np.diag([1.0, 2.0, 3.0]) * 0.005**2
    attitude, rate = Rotation.from_euler("ZYX", [0.2, -0.1, 0.15]), np.array([0.02, -0.03, 0.01])
    state = new(pkf.PKF_STATE)
    pkf.start(params, pose_of(np.array([-5.0, 0.3, -0.3]), attitude.as_quat(), r), KNOWN, state)
    reference = KalmanFilter(dim_x=9, dim_z=3)
    reference.x, reference.P = state.x.copy(), state.p.copy()
    for k in range(400):
        attitude = attitude * Rotation.from_rotvec(0.02 * rate)
        q, force = attitude.as_quat(), 5e-3 * rng.standard_normal(3)
        phi, psi = discrete(scheme_1, q)
        reference.predict(u=force, B=psi, F=phi, Q=process_noise(params, psi))
        pkf.predict(params, state, force, q, KNOWN, STAYS, HILL)
        if k % 8 == 7:
            z = np.array([-5.0, 0.3, -0.3]) + 0.005 * rng.standard_normal(3)
            h = np.hstack([-quat.to_matrix(q), np.zeros((3, 6))])
            reference.update(z, R=r, H=h)
            *_, nis = fuse(state, z, r, 0.0, q, KNOWN)
            assert nis == pytest.approx(reference.y @ reference.SI @ reference.y, rel=1e-6)
        np.testing.assert_allclose(state.x, reference.x, atol=1e-9)
        np.testing.assert_allclose(state.p, reference.P, atol=1e-11)
        np.testing.assert_array_equal(state.c, 0.0)
        assert np.linalg.eigvalsh(state.p).min() > 0.0


def test_filter_stays_equal_to_a_joint_filter_that_does_not_correct_the_attitude(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    """Fifteen states in numpy, the attitude's corrected by measured attitudes alone (Schmidt 1966)."""
    own = gnc_params.navigation(scheme_1).fusion.akf
    own.sigma_gyro, own.sigma_drift, own.initial_drift_sigma = 1e-3, 1e-4, 1e-3
    r, r_turn = np.diag([1.0, 2.0, 3.0]) * 0.005**2, np.diag([2.0, 1.0, 3.0]) * 5e-4**2
    pose = pose_of(np.array([-10.0, 0.5, -0.5]), Rotation.from_euler("ZYX", [0.2, -0.1, 0.15]).as_quat(), r)
    pose.covariance_attitude = r_turn
    attitude, state = new(akf.AKF_STATE), new(pkf.PKF_STATE)
    akf.start(own, pose, attitude)
    pkf.start(params, pose, attitude.p, state)
    x, whole, h_turn = state.x.copy(), joint(state, attitude.p), np.eye(3, 15, 9)
    gain_a, innovation_a, smallest = np.empty((6, 3)), np.empty(3), math.inf
    for k in range(400):
        before, middle = attitude.p.copy(), attitude.x[:4].copy()
        akf.predict(own, attitude, np.array([0.02, -0.03, 0.01]) + 1e-3 * rng.standard_normal(3), HILL)
        force = np.array([0.02, -0.05, 0.03]) * math.sin(0.05 * k)
        pkf.predict(params, state, force, middle, before, attitude.phi, HILL)
        phi, psi = discrete(scheme_1, middle)
        f = block_diag(phi, attitude.phi)
        for i in range(3):
            # A(turned q) = A - [turn]x A: the force in H gains A.T (turn x force)
            f[:9, 9 + i] = psi @ np.cross(np.eye(3)[i], force - x[6:])
        x = phi @ x + psi @ force
        whole = f @ whole @ f.T + block_diag(
            process_noise(params, psi), 0.02**2 * 1e-6 * np.eye(3), 0.02**2 * 1e-8 * np.eye(3)
        )
        if k % 8 == 7:
            seen = turned(attitude.x[:4], 5e-4 * rng.standard_normal(3))
            akf.innovate(attitude, seen, r_turn, gain_a, innovation_a)
            akf.update(attitude, r_turn, gain_a, innovation_a)
            pkf.follow_attitude_update(state, attitude.keep)
            gain = np.vstack([np.zeros((9, 3)), (whole @ h_turn.T @ np.linalg.inv(whole[9:12, 9:12] + r_turn))[9:]])
            keep = np.eye(15) - gain @ h_turn
            whole = keep @ whole @ keep.T + gain @ r_turn @ gain.T
            z, a = pose.z_TC_C + 0.005 * rng.standard_normal(3), quat.to_matrix(attitude.x[:4])
            h = np.hstack([-a, np.zeros((3, 6)), np.cross(np.eye(3), a @ x[:3]).T, np.zeros((3, 3))])
            s = h @ whole @ h.T + r
            gain = np.vstack([(whole @ h.T @ np.linalg.inv(s))[:9], np.zeros((6, 3))])
            y = z + a @ x[:3]
            x, keep = x + gain[:9] @ y, np.eye(15) - gain @ h
            whole = keep @ whole @ keep.T + gain @ r @ gain.T
            *_, nis = fuse(state, z, r, 0.0, attitude.x[:4], attitude.p)
            assert nis == pytest.approx(y @ np.linalg.solve(s, y), rel=1e-7)
        np.testing.assert_allclose(state.x, x, atol=1e-10)
        np.testing.assert_allclose(joint(state, attitude.p), whole, rtol=1e-8, atol=1e-12)
        smallest = min(smallest, np.linalg.eigvalsh(joint(state, attitude.p)).min())
    assert smallest > 0.0
    # what is carried along matters: without it the filter would trust itself more than it may
    assert np.abs(state.c[:3, :3]).max() > 0.1 * math.sqrt(state.p[0, 0] * attitude.p[0, 0])


@pytest.mark.parametrize("correlated", [0.0, 1.0])
def test_start_stands_at_the_first_pose_at_rest(params: np.record, rng: np.random.Generator, correlated: float) -> None:
    q, root, state = Rotation.random(rng=rng).as_quat(), rng.standard_normal((3, 3)), new(pkf.PKF_STATE)
    r_CT_H = np.array([5.0, -0.3, 0.3])
    z, lever = -quat.to_matrix(q) @ r_CT_H, np.zeros((3, 6))
    for i in range(3):
        d = 1e-5 * np.eye(3)[i]
        lever[:, i] = (quat.to_matrix(turned(q, -d)).T @ z - quat.to_matrix(turned(q, d)).T @ z) / 2e-5
    half = correlated * block_diag(*rng.standard_normal((2, 3, 3)))  # the AKF starts with its drift apart
    pkf.start(params, pose_of(z, q, root @ root.T), half @ half.T, state)
    np.testing.assert_allclose(state.x, [*r_CT_H, 0, 0, 0, 3e-4, 3e-4, 3e-4], atol=1e-14)
    back = quat.to_matrix(q).T
    expected = back @ root @ root.T @ back.T + lever @ half @ half.T @ lever.T
    np.testing.assert_allclose(state.p[:3, :3], expected, atol=1e-7)
    np.testing.assert_allclose(np.diag(state.p)[3:], np.repeat([0.02**2, 5e-4**2], 3))
    np.testing.assert_allclose(state.c, np.vstack([lever @ half @ half.T, np.zeros((6, 6))]), atol=1e-7)


def test_sigma_is_the_root_of_the_diagonal(rng: np.random.Generator) -> None:
    (state, _), out = new_state(rng), np.empty(3)
    for first in (0, 3, 6):
        pkf.sigma(state, first, out)
        np.testing.assert_allclose(out, np.sqrt(np.diag(state.p)[first : first + 3]))


def test_errors_with_a_known_attitude_are_as_large_as_the_covariance_says(
    params: np.record, scheme_1: Scenario, rng: np.random.Generator
) -> None:
    runs, marks = 30, (8, 400, 1504)
    q, r, root = np.array([0.0, 0.0, 0.0, 1.0]), 0.005**2 * np.diag([1.0, 4.0, 9.0]), 0.005 * np.arange(1.0, 4.0)
    (phi, psi), total = discrete(scheme_1, q), dict.fromkeys(marks, 0.0)
    for _ in range(runs):
        state, truth = new(pkf.PKF_STATE), np.zeros(9)
        truth[:3] = [5.0, -0.3, 0.3]
        truth[3:6] = params.initial_velocity_sigma * rng.standard_normal(3)
        truth[6:] = params.initial_bias + params.initial_bias_sigma * rng.standard_normal(3)
        pkf.start(params, pose_of(root * rng.standard_normal(3) - truth[:3], q, r), KNOWN, state)
        noise = rng.standard_normal((max(marks) + 1, 9))
        for k in range(1, max(marks) + 1):
            force = np.array([5e-3 * math.sin(0.01 * k), 2e-3, -3e-3])
            sample = force + truth[6:] + params.sigma_accelerometer * noise[k, :3]
            pkf.predict(params, state, sample, q, KNOWN, STAYS, HILL)
            truth[:6] = phi[:6, :6] @ truth[:6] + psi[:6] @ force
            truth[6:] += 0.02 * params.sigma_bias * noise[k, 3:6]
            if k % 8 == 0:
                fuse(state, root * noise[k, 6:] - truth[:3], r, 0.0, q, KNOWN)
            if k in total:
                total[k] += (truth - state.x) @ np.linalg.solve(state.p, truth - state.x)
    for mark in marks:
        assert chi2.ppf(0.0005, 9 * runs) < total[mark] < chi2.ppf(0.9995, 9 * runs), mark
