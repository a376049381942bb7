"""The virtual IMU: what it measures and how its errors are distributed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import IMU, MAX_THRUSTERS, TRUTH, new
from hil.dynamics import truth as truth_kernels
from hil.dynamics.imu import IMU_NOISE, IMU_PARAMS, propagate, sample
from hil.dynamics.imu_faults import IMU_MEMORY
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths.random_streams import NormalRows, stream
from hil.params import dynamics as dynamics_params

TS = 0.02
NO_FIELD = np.zeros((1, 1, 6))  # the linear model reads no gravity field


@pytest.fixture
def params() -> np.record:
    """Return errors of distinct sizes."""
    params = new(IMU_PARAMS)
    params.dt_s = TS
    params.sigma_gyro, params.sigma_drift = 2.0, 3.0
    params.sigma_accelerometer, params.sigma_bias = 5.0, 7.0
    return params


def test_sample_is_truth_plus_error_of_the_step_plus_noise(params: np.record) -> None:
    truth, imu = new(TRUTH), new(IMU)
    truth.mean_rate_C, truth.mean_force_C = [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]
    imu.drift_C, imu.bias_C = [0.1, 0.2, 0.3], [0.4, 0.5, 0.6]
    noise = np.arange(12.0)
    sample(params, truth, noise, imu)
    np.testing.assert_allclose(imu.rate_C, [1.1 + 0.0, 2.2 + 2.0, 3.3 + 4.0])
    np.testing.assert_allclose(imu.force_C, [4.4 + 15.0, 5.5 + 20.0, 6.6 + 25.0])


def test_drift_and_bias_walk_by_step_times_sigma_times_normal(params: np.record) -> None:
    truth, imu = new(TRUTH), new(IMU)
    imu.drift_C, imu.bias_C = [0.1, 0.2, 0.3], [0.4, 0.5, 0.6]
    noise = np.arange(12.0)
    sample(params, truth, noise, imu)
    np.testing.assert_allclose(imu.drift_C, np.array([0.1, 0.2, 0.3]) + TS * 3.0 * noise[6:9])
    np.testing.assert_allclose(imu.bias_C, np.array([0.4, 0.5, 0.6]) + TS * 7.0 * noise[9:12])


def test_noise_and_walks_have_the_stated_spread_and_are_white(params: np.record) -> None:
    truth, imu, rows = new(TRUTH), new(IMU), NormalRows(stream(3, "imu"), IMU_NOISE)
    n = 4000
    found = np.empty((n, 12))
    for k in range(n):
        drift, bias = imu.drift_C.copy(), imu.bias_C.copy()
        sample(params, truth, rows.next_row(), imu)
        found[k] = np.concatenate([imu.rate_C - drift, imu.force_C - bias, imu.drift_C - drift, imu.bias_C - bias])
    whitened = found / np.repeat([2.0, 5.0, TS * 3.0, TS * 7.0], 3)
    squares = np.sum(whitened**2, axis=0)
    assert (squares > chi2.ppf(1e-4, n)).all()
    assert (squares < chi2.ppf(1 - 1e-4, n)).all()
    assert (np.abs(whitened.mean(axis=0)) < 4.0 / math.sqrt(n)).all()
    correlation = whitened.T @ whitened / n - np.diag(squares / n)
    assert np.abs(correlation).max() < 4.5 / math.sqrt(n)
    assert np.abs((whitened[1:] * whitened[:-1]).mean(axis=0)).max() < 4.5 / math.sqrt(n)


def test_gyro_sees_the_mean_rate_of_a_step_and_not_its_end(plain_1: Scenario) -> None:
    dss, truth, imu = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1), new(IMU)
    perfect = new(IMU_PARAMS)
    on = np.zeros(MAX_THRUSTERS, dtype=np.int64)
    on[:2] = [1, 0]
    on[5] = 1  # +x at +y and -x at -y: a rotation about -z
    before = truth.w_CI_C.copy()
    truth_kernels.step(dss, NO_FIELD, new(TRUTH_MEMORY), truth, on)
    sample(perfect, truth, np.zeros(12), imu)
    # thrust, and with it the angular acceleration, is constant over the step
    np.testing.assert_allclose(imu.rate_C, 0.5 * (before + truth.w_CI_C), rtol=1e-5)
    assert abs(imu.rate_C[2] - truth.w_CI_C[2]) > 1e-5


def test_accelerometer_feels_thrust_and_not_gravity(plain_1: Scenario) -> None:
    dss, truth, imu = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1), new(IMU)
    dss.minimum_on_s = 0.0
    on = np.zeros(MAX_THRUSTERS, dtype=np.int64)
    truth_kernels.step(dss, NO_FIELD, new(TRUTH_MEMORY), truth, on)
    sample(new(IMU_PARAMS), truth, np.zeros(12), imu)
    np.testing.assert_array_equal(imu.force_C, 0.0)
    on[0] = 1
    truth_kernels.step(dss, NO_FIELD, new(TRUTH_MEMORY), truth, on)
    sample(new(IMU_PARAMS), truth, np.zeros(12), imu)
    force = plain_1.chaser.thrusters.force_n / plain_1.chaser.mass_kg
    np.testing.assert_allclose(imu.force_C, [force, 0.0, 0.0])


def test_shipped_sensor_has_the_numbers_of_table_i(scheme_1: Scenario) -> None:
    params = dynamics_params.imu(scheme_1)
    assert math.degrees(params.sigma_gyro) == pytest.approx(8.33e-7)
    assert math.degrees(params.sigma_drift) == pytest.approx(8.33e-8)
    assert params.sigma_accelerometer == 1.0e-4
    assert params.sigma_bias == 1.0e-5
    assert scheme_1.imu.gyro_drift_degps == (2.78e-6,) * 3
    assert scheme_1.imu.accelerometer_bias_mps2 == (3.0e-4,) * 3
    assert params.dt_s == 0.02


def test_streams_of_one_seed_repeat_and_do_not_depend_on_the_block() -> None:
    short = NormalRows(stream(7, "imu"), 12, block=3)
    long = NormalRows(stream(7, "imu"), 12, block=50)
    for _ in range(10):
        np.testing.assert_array_equal(short.next_row(), long.next_row())
    assert not np.array_equal(
        NormalRows(stream(7, "vision"), 12).next_row(), NormalRows(stream(7, "imu"), 12).next_row()
    )
    assert not np.array_equal(NormalRows(stream(8, "imu"), 12).next_row(), NormalRows(stream(7, "imu"), 12).next_row())


def test_fast_imu_takes_one_step_of_the_truth_per_sample() -> None:
    linear = load_scenario("scheme-1", ("truth.relative_motion=hill", "truth.gravity_degree=0")).value
    fast = linear.model_copy(update={"imu": linear.imu.model_copy(update={"rate_hz": 200.0})})
    on = np.ones(MAX_THRUSTERS, np.int64)
    found = []
    for scenario in (linear, fast):
        truth, imu = dynamics_params.initial_truth(scenario), new(IMU)
        samples = np.zeros(scenario.imu_samples, IMU)
        propagate(
            dynamics_params.dss(scenario), dynamics_params.imu(scenario), NO_FIELD, new(TRUTH_MEMORY), truth, on,
            np.zeros((len(samples), IMU_NOISE)), new(IMU_MEMORY), samples, imu,
        )  # fmt: skip
        found.append((truth, imu, samples))
    (one, slow, _), (four, mean, samples) = found
    assert len(samples) == 4
    np.testing.assert_allclose(four.r_CT_H, one.r_CT_H, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(four.q_CH, one.q_CH, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(four.thrust_fraction, one.thrust_fraction, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(samples["rate_C"].mean(axis=0), mean.rate_C, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(mean.rate_C, slow.rate_C, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(mean.force_C, slow.force_C, rtol=0.0, atol=1e-9)
    assert not np.array_equal(samples["rate_C"][0], samples["rate_C"][3])
