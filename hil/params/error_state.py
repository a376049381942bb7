"""Error state of the navigation as the kernels' record, from user units to SI."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.config.scenario import VISION_ALONE, Scenario
from hil.core.messages import Array, new
from hil.errors import BadInput
from hil.gnc.estimation.error_state import ERROR_STATE, ERRORS_MAX, FILTER_ERRORS, LANES, PARAMETER_BLOCKS, BlockMotion
from hil.maths import elementary
from hil.maths.elementary import square
from hil.params.sensors import SensorErrorState, error_states


def _initial_sigmas(scenario: Scenario, sensor_errors: Sequence[SensorErrorState]) -> dict[str, Array]:
    """Return the standard deviations at the start of the states of each block that a scenario may add."""
    given, thrust = scenario.gnc.navigation.budget, scenario.gnc.navigation.thrust
    is_alone = scenario.gnc.navigation.backend == VISION_ALONE  # no accelerometer measures the thrust
    rotates, target = scenario.target.motion != "aligned", scenario.gnc.target
    tumbles = scenario.target.motion == "tumble"
    rad, one, three = math.radians, np.ones(1), np.ones(3)
    is_correlated = max(given.vision_correlated_fraction, given.bench_sigma_m, given.bench_sigma_deg) > 0.0
    return {
        "misalignment": rad(given.vision_misalignment_sigma_deg) * three,
        "bias": np.array(given.vision_bias_sigma_m),
        "scale": given.vision_scale_sigma * one,
        "correlated": float(is_correlated) * np.ones(6),
        "sensor_errors": np.array([error.sigma for error in sensor_errors]),
        "target_rate": rad(float(rotates) * target.rate_sigma_degps) * three,
        "target_moments": float(tumbles and target.rate_sigma_degps > 0.0) * target.moments_sigma * three,
        "disturbance": float(thrust.enabled) * thrust.disturbance_mps2 * three,
        "thrust_scale": float(is_alone) * thrust.scale_sigma * one,
        "gyro_scale": given.gyro_scale_sigma * three,
        "gyro_misalignment": rad(given.gyro_misalignment_sigma_deg) * three,
        "gyro_instability": rad(given.gyro_instability_degps) * three,
        "accelerometer_scale": given.accelerometer_scale_sigma * three,
        "accelerometer_misalignment": rad(given.accelerometer_misalignment_sigma_deg) * three,
        "accelerometer_instability": given.accelerometer_instability_mps2 * three,
    }


def error_state(scenario: Scenario) -> np.record:
    """Return ERROR_STATE: blocks whose states have no spread are left out."""
    given, params, of_sensors = scenario.gnc.navigation.budget, new(ERROR_STATE), error_states(scenario)
    sigmas = _initial_sigmas(scenario, of_sensors)
    times_s = {
        "correlated": given.vision_correlation_time_s,
        "gyro_instability": given.gyro_instability_time_s,
        "accelerometer_instability": given.accelerometer_instability_time_s,
    }
    n, params.imu = FILTER_ERRORS, 0
    params.kept = np.ones(LANES)
    for block in PARAMETER_BLOCKS:
        if not np.any(sigmas[block.name]):
            continue
        size = len(sigmas[block.name])
        if n + size > ERRORS_MAX:
            text = f"{block.name} would be errors {n} to {n + size - 1} of the navigation, allowed {ERRORS_MAX} in all"
            raise BadInput.single(scenario.name, "gnc.navigation.budget", text)
        here = slice(n, n + size)
        params[block.name] = n
        params.variance[here] = square(sigmas[block.name])
        params.estimated[here] = block.estimated
        if block.name == "sensor_errors":
            params.kept[here] = [elementary.exp(-scenario.sample_s / error.time_s) for error in of_sensors]
            params.moves = params.moves or any(math.isfinite(error.time_s) for error in of_sensors)
        elif block.motion is BlockMotion.MARKOV:
            params.kept[here], params.moves = elementary.exp(-scenario.sample_s / times_s[block.name]), 1
        if block.name.startswith(("disturbance", "thrust", "gyro", "accelerometer")) and params.imu == 0:
            params.imu = n
        n += size
    params.n, params.lanes = n, next(lanes for lanes in (16, 24, 32, 40, LANES) if lanes >= n)
    params.imu = params.imu or n
    params.target_walk = square(math.radians(scenario.gnc.target.rate_walk_degps)) * scenario.sample_s / 60.0
    params.fraction = given.vision_correlated_fraction
    params.bench_variance = square(given.bench_sigma_m), square(math.radians(given.bench_sigma_deg))
    # of the logarithm of the variance
    params.noise_variance, params.noise_window = square(2.0 * given.vision_noise_scale_sigma), given.vision_noise_window
    params.camera_position, params.ring_position = given.camera_position_m, given.led_ring_position_m
    return params
