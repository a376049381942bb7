"""Navigation as the cycle calls it: what it shows, whether its sigmas are honest, what a wrong sensor looks like."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from hil.config.load import load_scenario
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import IMU, MAX_POSES, NAVIGATION, POSE, TRUTH, new
from hil.gnc.estimation import navigation
from hil.gnc.estimation.error_state import FILTERS
from hil.gnc.estimation.navigation import VISION_ALONE
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc.estimation.target_orbit import TARGET_ORBIT
from hil.maths import quat
from hil.params import gnc as gnc_params
from hil.sensors.mounting import camera_pose, chaser_pose
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.model import add_noise
from tests.support.plain_filters import WITHOUT_BUDGET

SIGMA_M, SIGMA_RAD = 0.005, math.radians(0.033)


class Navigator:
    """Navigation with all that it works in, fed with a chaser that hangs still at 10 m."""

    def __init__(self, params: np.record, rng: np.random.Generator, scale: float = 1.0) -> None:
        self.params, self.out = params, new(NAVIGATION)
        self.state, self._memory = new(navigation.NAVIGATION_STATE), new_memory(params.fusion)
        self._poses = np.zeros(MAX_POSES, POSE).view(np.recarray)
        self._rng, self._scale, self.wrong = rng, scale, 0.0
        self.r, self.q = np.array([10.0, -0.5, 0.5]), Rotation.from_euler("ZYX", [-5, 5, 5], degrees=True).as_quat()

    def pose(self, t_s: float, off_m: float = 0.0, off_rad: float = 0.0) -> np.record:
        """Return a noisy pose, wrong by ``off_m`` and ``off_rad``, that claims ``scale`` times its sigmas."""
        pose, noise = new(POSE), self._rng.standard_normal(6)
        noise = noise + np.array([off_m / SIGMA_M, 0, 0, off_rad / SIGMA_RAD, 0, 0])
        pose.t_s, pose.z_TC_C = t_s, SIGMA_M * noise[:3] - quat.transform(self.q, self.r)
        pose.q_CH = quat.multiply(quat.from_rotation_vector(SIGMA_RAD * noise[3:]), self.q)
        pose.covariance_position = (self._scale * SIGMA_M) ** 2 * np.eye(3)
        pose.covariance_attitude = (self._scale * SIGMA_RAD) ** 2 * np.eye(3)
        return pose

    def step(self, *poses: np.record) -> np.record:
        own, samples = self.params.fusion, np.zeros(1, IMU).view(np.recarray)
        imu = samples[0]
        for i, pose in enumerate(poses):
            self._poses[i] = pose
        w0 = own.orbit.mean_motion
        still = np.array([0.0, w0**2 * self.r[1], -3.0 * w0**2 * self.r[2]])
        imu.rate_C = quat.transform(self.q, np.array([0.0, -w0, 0.0])) + own.akf.initial_drift
        imu.rate_C += own.akf.sigma_gyro * self._rng.standard_normal(3)
        imu.force_C = quat.transform(self.q, still) + own.pkf.initial_bias
        imu.force_C += own.pkf.sigma_accelerometer * self._rng.standard_normal(3)
        imu.rate_C, imu.force_C = imu.rate_C + self.wrong, imu.force_C + self.wrong
        navigation.navigate(self.params, self.state, self._memory, samples, self._poses, len(poses), self.out)
        return self.out


@pytest.fixture
def params(plain_filters_2: Scenario) -> np.record:
    """Return the shipped parameters of navigation by vision and IMU."""
    return gnc_params.navigation(plain_filters_2)


def test_nothing_is_known_until_a_pose_comes_and_one_too_old_does_not_start(
    params: np.record, rng: np.random.Generator
) -> None:
    navigator = Navigator(params, rng)
    for _ in range(70):
        assert navigator.step().valid == 0
    assert navigator.step(navigator.pose(0.12)).valid == 0
    assert navigator.state.fusion.too_late == 1
    assert navigator.step(navigator.pose(0.8)).valid == 1  # 31 steps late
    assert navigator.state.fusion.start_cycle == 40
    out = navigator.out
    assert np.abs((out.r_CT_H - navigator.r) / out.sigma_r_m).max() < 4.0


def test_what_is_shown_is_what_the_filters_hold(params: np.record, rng: np.random.Generator) -> None:
    navigator = Navigator(params, rng)
    for k in range(40):
        out = navigator.step(*([navigator.pose(0.02 * k)] if k % 8 == 0 else []))
        held = navigator.state.fusion.filters
        np.testing.assert_array_equal([*out.r_CT_H, *out.v_CT_H], held.pkf.x[:6])
        np.testing.assert_array_equal([*out.q_CH, *out.w_CH_C], [*held.akf.x[:4], *held.akf.w_CH_C])
        np.testing.assert_allclose([*out.sigma_r_m, *out.sigma_v_mps], np.sqrt(np.diag(held.p)[:6]))
        np.testing.assert_allclose(out.sigma_attitude_rad, np.sqrt(np.diag(held.p)[9:12]))
        updated = k % 8 == 0 and k > 0
        assert math.isfinite(out.nis_position) == math.isfinite(out.nis_attitude) == updated
    assert navigator.state.fusion.cycle == 40


def test_all_poses_of_a_step_are_fused_and_no_more(params: np.record, rng: np.random.Generator) -> None:
    navigator = Navigator(params, rng)
    navigator.step(navigator.pose(0.0))
    for _ in range(20):
        navigator.step()
    navigator.step(*(navigator.pose(t_s) for t_s in (0.32, 0.08, 0.2, 0.4)))
    assert (navigator.state.fusion.accepted, navigator.state.fusion.duplicates) == (4, 0)
    navigator.step()  # the places of the four are still full
    assert (navigator.state.fusion.accepted, navigator.state.fusion.duplicates) == (4, 0)


@pytest.mark.parametrize("part", ["position", "attitude"])
def test_gate_is_at_the_value_of_its_parameter(params: np.record, part: str) -> None:
    name = "pkf" if part == "position" else "akf"

    def fused(gate: float) -> np.record:
        params.fusion.akf.gate = params.fusion.pkf.gate = 1e9
        params.fusion[name].gate = gate
        navigator = Navigator(params, np.random.default_rng(3))
        navigator.step(navigator.pose(0.0))
        navigator.step(navigator.pose(0.02, off_m=0.02, off_rad=2e-3))
        return navigator

    nis = fused(1e9).out[f"nis_{part}"]
    assert nis > 3.0
    assert fused(nis * 1.0001).state.fusion.accepted == 1
    kept_out = fused(nis * 0.9999)
    assert (kept_out.state.fusion.accepted, kept_out.state.fusion[f"rejected_{part}"]) == (0, 1)
    assert kept_out.out[f"nis_{part}"] == pytest.approx(nis, rel=1e-12)


def test_shipped_gate_is_five_sigma(params: np.record) -> None:
    rare = math.erfc(5.0 / math.sqrt(2.0))
    assert chi2.sf(params.fusion.akf.gate, 3) == pytest.approx(rare, rel=1e-6)
    assert params.fusion.pkf.gate == params.fusion.akf.gate


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_wrong_measurement_covariance_shows_as_a_mean_nis_off_three(
    params: np.record, rng: np.random.Generator, scale: float
) -> None:
    params.fusion.akf.gate = params.fusion.pkf.gate = 1e9
    navigator, nis = Navigator(params, rng, scale), []
    for k in range(2400):
        out = navigator.step(*([navigator.pose(0.02 * k)] if k % 8 == 0 else []))
        if k % 8 == 0 and k > 0:
            nis.append((out.nis_position, out.nis_attitude))
    low, high = (chi2.ppf(p, 3 * len(nis)) / len(nis) for p in (0.0005, 0.9995))
    for mean in np.mean(nis, axis=0):
        assert (low < mean < high) == (scale == 1.0)
        assert mean == pytest.approx(3.0 / scale**2, rel=0.2)


def test_errors_at_ten_metres_are_as_large_as_the_covariances(
    plain_filters_2: Scenario, mock_rig: Rig, rng: np.random.Generator
) -> None:
    """The attitude is estimated: its error, which lasts from frame to frame, is 10 m long."""
    runs, marks = 40, (0, 80, 400)
    params, mounting = gnc_params.navigation(plain_filters_2), vmu_params.mounting(mock_rig)
    vision, akf, pkf = vmu_params.model(plain_filters_2), params.fusion.akf, params.fusion.pkf
    vision.reference_range = 1e3  # noise as in Table I at every range
    hill_rate, samples = np.array([0.0, -params.fusion.orbit.mean_motion, 0.0]), np.zeros(1, IMU).view(np.recarray)
    truth, out, two = new(TRUTH), new(NAVIGATION), np.empty(2)
    poses = np.zeros(MAX_POSES, POSE).view(np.recarray)
    truth.q_CH, truth.w_HI_H = [0.0, 0.0, 0.0, 1.0], hill_rate
    t_v, q_vt, covariance = np.empty(3), np.empty(4), np.empty((6, 6))
    total = {mark: np.zeros(2) for mark in marks}
    for _ in range(runs):
        state, memory = new(navigation.NAVIGATION_STATE), new_memory(params.fusion)
        imu = samples[0]
        x = np.concatenate([[10.0, -0.5, 0.5], pkf.initial_velocity_sigma * rng.standard_normal(3)])
        imu.bias_C = pkf.initial_bias + pkf.initial_bias_sigma * rng.standard_normal(3)
        imu.drift_C = akf.initial_drift + akf.initial_drift_sigma * rng.standard_normal(3)
        for k in range(max(marks) + 1):
            if k > 0:
                x = pkf.hill_transition @ x
                imu.rate_C = hill_rate + imu.drift_C + akf.sigma_gyro * rng.standard_normal(3)
                imu.force_C = imu.bias_C + pkf.sigma_accelerometer * rng.standard_normal(3)
                imu.bias_C += 0.02 * pkf.sigma_bias * rng.standard_normal(3)
                imu.drift_C += 0.02 * akf.sigma_drift * rng.standard_normal(3)
            truth.r_CT_H, truth.v_CT_H = x[:3], x[3:]
            if k % 8 == 0:
                camera_pose(mounting, truth.r_CT_H, truth.q_CH, t_v, q_vt)
                add_noise(vision, truth.r_CT_H, rng.standard_normal(6), t_v, q_vt, covariance)
                chaser_pose(mounting, t_v, q_vt, covariance, poses[0])
                poses[0].t_s = 0.02 * k
            navigation.navigate(params, state, memory, samples, poses, int(k % 8 == 0), out)
            if k in total:
                held = state.fusion.filters
                navigation.normalised_errors(held, params.fusion.orbit, truth, imu, two)
                total[k] += two
                joint = held.p[:15, :15]
                sigma = np.sqrt(np.diag(joint))
                assert np.linalg.eigvalsh(joint / np.outer(sigma, sigma)).min() > 0.0
    for mark in marks:
        for found, freedom in zip(total[mark], (9 * runs, 6 * runs), strict=True):
            assert chi2.ppf(0.0005, freedom) < found < chi2.ppf(0.9995, freedom), mark


def test_normalised_errors_are_those_of_nine_and_six_states(params: np.record, rng: np.random.Generator) -> None:
    filters, orbit, truth = new(FILTERS), new(TARGET_ORBIT), new(TRUTH)
    imu, found = new(IMU), np.empty(2)
    parts = [root @ root.T for root in (rng.standard_normal((9, 9)), rng.standard_normal((6, 6)))]
    filters.p[:9, :9], filters.p[9:15, 9:15] = parts
    error, turn = rng.standard_normal(9), np.array([0.02, -0.01, 0.03])
    filters.pkf.x, filters.akf.x = rng.standard_normal(9), [0.0, 0.0, 0.0, 1.0, 0.1, 0.2, 0.3]
    truth.r_CT_H, truth.v_CT_H, imu.bias_C = (filters.pkf.x + error).reshape(3, 3)
    truth.q_CH, imu.drift_C = Rotation.from_rotvec(turn).as_quat(), [0.2, 0.2, 0.1]
    # at apoapsis, where the area that the orbit sweeps gives (1 - e)^2 / (1 - e^2)^1.5 of the mean motion
    orbit.mean_motion, orbit.eccentricity, truth.t_s, e = 1e-3, 0.09, 1e3 * math.pi, 0.09
    unknown = [0.0, 0.0, 0.3]
    truth.w_HI_H = np.array([0.0, -1e-3 * (1.0 - e) ** 2 / (1.0 - e * e) ** 1.5, 0.0]) + unknown
    six = np.array([*turn, *(np.array([0.1, 0.0, -0.2]) + Rotation.from_rotvec(turn).inv().apply(unknown))])
    navigation.normalised_errors(filters, orbit, truth, imu, found)
    np.testing.assert_allclose(found, [error @ np.linalg.solve(parts[0], error), six @ np.linalg.solve(parts[1], six)])


def test_vision_alone_estimates_with_the_commands_whatever_the_imu_reads() -> None:
    scenario = load_scenario("scheme-2", (*WITHOUT_BUDGET, "gnc.navigation.backend=vision_alone")).value
    navigators = [Navigator(gnc_params.navigation(scenario), np.random.default_rng(5)) for _ in range(2)]
    navigators[1].wrong = math.nan
    assert navigators[0].params.sensors == VISION_ALONE
    for navigator in navigators:
        assert navigator.step().valid == 0
    for k in range(1, 1200):
        shown = [each.step(*([each.pose(0.02 * k)] if k % 8 == 0 else [])).copy() for each in navigators]
        assert shown[0].tobytes() == shown[1].tobytes()
        assert shown[0].valid == (k >= 8)
        assert math.isfinite(shown[0].nis_position) == math.isfinite(shown[0].nis_attitude) == (k % 8 == 0 and k > 8)
    out, sound = navigators[0].out, navigators[0]
    assert sound.state.fusion.accepted == 148
    for error, sigma in (
        (out.r_CT_H - sound.r, out.sigma_r_m),
        (out.v_CT_H, out.sigma_v_mps),
        (out.w_CH_C, np.full(3, 1e-4)),
    ):
        assert np.abs(error / sigma).max() < 4.0
    assert out.sigma_r_m.max() < SIGMA_M
    assert 0.0 < out.sigma_v_mps.max() < 5e-4
