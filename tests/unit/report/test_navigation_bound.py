"""Cramér-Rao bound of the navigation: against a dense covariance, and free of the parameters of any filter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE, Array
from hil.report.navigation_bound import NavigationBound

SIGMA_M, SIGMA_RAD, STEP_S, PERIOD = 0.004, 6e-4, 0.02, 8


def rows(cycles: int) -> np.ndarray:
    """Return cycles with a pose in each eighth of them."""
    found = np.zeros(cycles, CYCLE)
    found["t_s"] = found["pose"]["t_s"] = STEP_S * np.arange(cycles)
    found["pose"]["fresh"][::PERIOD] = 1
    found["pose"]["z_TC_C"] = (-2.0, 0.0, 0.0)
    bench = load_rig("mock").value.vmu
    found["pose"]["covariance_position"] = (SIGMA_M**2 + bench.bench_sigma_m**2) * np.eye(3)
    found["pose"]["covariance_attitude"] = (SIGMA_RAD**2 + math.radians(bench.bench_sigma_deg) ** 2) * np.eye(3)
    return found


def bound(
    cycles: int, *settings: str, settled_s: float = 100.0, parts: int = 1, scenario: str = "scheme-1-paper"
) -> dict[str, list[float] | None]:
    found = NavigationBound(load_scenario(scenario, settings).value, load_rig("mock").value, settled_s)
    for part in np.array_split(rows(cycles), parts):
        found.add(part)
    return found.rows()


def dense(cycles: int, start: Array, f: Array, noise: Array, sigma: float, settled_s: float) -> float:
    """Return the root mean variance of the first state, step by step of the IMU."""
    p, found = np.diag(start), []
    for k in range(cycles):
        if k:
            p = f @ p @ f.T + noise
        if k % PERIOD == 0 and k:
            p = p - np.outer(p[:, 0], p[:, 0]) / (p[0, 0] + sigma**2)
        if k * STEP_S >= settled_s:
            found.append(p[0, 0])
    return math.sqrt(float(np.mean(found)))


def test_bound_is_the_covariance_of_a_dense_filter_with_the_true_noise() -> None:
    imu, dt = load_scenario("scheme-1").value.imu, STEP_S
    found = bound(6000)
    f = np.array([[1.0, dt, -0.5 * dt * dt], [0.0, 1.0, -dt], [0.0, 0.0, 1.0]])
    push = imu.accelerometer_noise_mps2 * np.array([0.5 * dt * dt, dt, 0.0])
    noise = np.outer(push, push) + np.diag([0.0, 0.0, (dt * imu.accelerometer_bias_noise_mps3) ** 2])
    start = np.array([SIGMA_M, 1e-3, imu.accelerometer_bias_initial_sigma_mps2]) ** 2
    assert found["position_bound_m"] == pytest.approx([dense(6000, start, f, noise, SIGMA_M, 100.0)] * 3, rel=0.01)
    gyro = np.radians([imu.gyro_noise_degps, imu.gyro_drift_noise_degps2])
    start = np.array([SIGMA_RAD, math.radians(imu.gyro_drift_initial_sigma_degps)]) ** 2
    expected = dense(6000, start, np.array([[1.0, -dt], [0.0, 1.0]]), np.diag((dt * gyro) ** 2), SIGMA_RAD, 100.0)
    assert found["attitude_bound_deg"] == pytest.approx([math.degrees(expected)] * 3, rel=0.01)


def test_bound_follows_the_sensors_and_no_filter() -> None:
    shipped = bound(6000)
    filters = (
        "gnc.pkf.accelerometer_noise_mps2=1e-2",
        "gnc.akf.gyro_noise_degps=1e-3",
        "gnc.navigation.gate_sigma=4.0",
    )
    assert bound(6000, *filters) == shipped
    worse = bound(6000, "imu.accelerometer_noise_mps2=1e-2", "imu.gyro_noise_degps=1e-3")
    for name, values in shipped.items():
        assert values is not None
        assert np.all(np.array(worse[name]) > 1.1 * np.array(values))


def test_bound_of_parts_is_that_of_the_run_and_one_without_poses_or_imu_is_none() -> None:
    assert bound(3000, settled_s=20.0, parts=7) == bound(3000, settled_s=20.0)
    nothing = {"position_bound_m": None, "attitude_bound_deg": None}
    assert bound(1) == nothing
    assert bound(1000, 'gnc.navigation.backend="vision_alone"') == nothing


def test_error_budget_adds_what_poses_cannot_show() -> None:
    """Bias (2, 0.5, 0.5) mm, 0.05 deg and 0.1 % of the range, here 2 m."""
    alone, found = bound(6000), bound(6000, scenario="scheme-1")
    turned = math.radians(0.05)
    for name, added in (
        ("position_bound_m", np.hypot([0.002, 0.0005, 0.0005], 2.0 * np.array([0.001, turned, turned]))),
        ("attitude_bound_deg", np.full(3, 0.05)),
    ):
        without, whole = alone[name], found[name]
        assert without is not None
        assert whole == pytest.approx(np.hypot(without, added).tolist())
