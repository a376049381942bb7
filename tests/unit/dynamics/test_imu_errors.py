"""Error model of the IMU: each term alone, in the units of its key."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.load import load_scenario
from hil.core.messages import IMU, TRUTH, new
from hil.dynamics.imu import sample_with_errors
from hil.dynamics.imu_faults import IMU_MEMORY
from hil.params import dynamics as dynamics_params

DT = 0.02
RATE, FORCE = np.array([0.01, -0.02, 0.03]), np.array([0.3, 0.1, -0.2])


def readings(
    *settings: str, n: int = 1, noise: float = 0.0, rates: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rate (n, 3), force (n, 3) and true drift (n, 3), rad/s and m/s^2, at constant rate and force."""
    params = dynamics_params.imu(load_scenario("scheme-1", settings).value, 7)
    for name in ("sigma_gyro", "sigma_drift", "sigma_accelerometer", "sigma_bias"):
        setattr(params, name, noise)
    truth, imu, memory = new(TRUTH), new(IMU), new(IMU_MEMORY)
    truth.mean_rate_C, truth.mean_force_C, truth.w_CI_C = RATE, FORCE, RATE
    found = np.empty((3, n, 3))
    before = RATE.copy()
    for k in range(n):
        truth.t_s = (k + 1) * DT
        if rates is not None:
            truth.w_CI_C, truth.mean_rate_C = rates[k + 1], 0.5 * (rates[k] + rates[k + 1])
            before = rates[k]
        sample_with_errors(params, truth, before, np.zeros(12), memory, imu)
        found[:, k] = imu.rate_C, imu.force_C, imu.drift_C
    return found[0], found[1], found[2]


def test_scale_and_misalignment_multiply_the_true_rate_and_force() -> None:
    rate, force, _ = readings(
        "imu.errors.gyro_scale_error=[0.01, 0.02, -0.03]",
        "imu.errors.gyro_misalignment_deg=[1.0, 2.0, 3.0]",
        "imu.errors.accelerometer_scale_error=[0.001, 0.0, 0.0]",
        "imu.errors.accelerometer_misalignment_deg=[0.0, 0.0, 1.0]",
    )
    turned = Rotation.from_rotvec(np.radians([1.0, 2.0, 3.0])).as_matrix().T  # sensor axes against c
    np.testing.assert_allclose(rate[0], np.diag([1.01, 1.02, 0.97]) @ turned @ RATE, rtol=1e-12)
    turned = Rotation.from_rotvec(np.radians([0.0, 0.0, 1.0])).as_matrix().T
    np.testing.assert_allclose(force[0], np.diag([1.001, 1.0, 1.0]) @ turned @ FORCE, rtol=1e-12)


def test_quantum_cuts_readings_and_loses_nothing() -> None:
    n = 1000
    rate, force, _ = readings(
        "imu.errors.gyro_quantum_degps=1.0", "imu.errors.accelerometer_quantum_mps2=0.25", n=n
    )  # fmt: skip
    for found, quantum, true in ((rate, math.radians(1.0), RATE), (force, 0.25, FORCE)):
        np.testing.assert_allclose(found / quantum, np.round(found / quantum), atol=1e-9)
        assert np.abs(found.sum(axis=0) - n * true).max() <= 0.5 * quantum * (1.0 + 1e-9)


def test_accelerometers_off_the_reference_point_measure_its_rotation() -> None:
    arm = np.array([0.3, -0.4, 0.5])
    rates = np.array([0.2, 0.1, -0.3]) + np.outer(np.arange(3) * DT, [1.0, -2.0, 0.5])
    _, force, _ = readings(f"imu.errors.lever_arm_m={arm.tolist()}", n=2, rates=rates)
    for k in range(2):
        gained, mean = (rates[k + 1] - rates[k]) / DT, 0.5 * (rates[k] + rates[k + 1])
        expected = FORCE + np.cross(gained, arm) + np.cross(mean, np.cross(mean, arm))
        np.testing.assert_allclose(force[k], expected, rtol=1e-12)


def test_instability_is_a_gauss_markov_process_in_the_true_drift() -> None:
    n = 40_000
    settings = ("imu.errors.gyro_instability_degps=2.0", "imu.errors.gyro_instability_time_s=0.5")
    rate, _, drift = readings(*settings, n=n)
    np.testing.assert_allclose(rate - drift, np.tile(RATE, (n, 1)), atol=1e-12)
    unit = np.degrees(drift) / 2.0
    assert unit.var() == pytest.approx(1.0, abs=0.06)
    assert np.mean(unit[25:] * unit[:-25]) == pytest.approx(math.exp(-1.0), abs=0.06)  # one correlation time
