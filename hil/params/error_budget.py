"""Error budget of the navigation as the kernels' record, from user units to SI."""

from __future__ import annotations

import math

import numpy as np

from hil.config.scenario import Scenario
from hil.core.messages import new
from hil.gnc.error_budget import ERROR_BUDGET, FILTER_ERRORS, JOINT_MAX


def error_budget(scenario: Scenario) -> np.record:
    """Return ERROR_BUDGET: parameters without a spread are left out."""
    given, params = scenario.gnc.navigation.budget, new(ERROR_BUDGET)
    if given.is_empty:
        return params
    rad, one, three = math.radians, np.ones(1), np.ones(3)
    is_correlated = max(given.vision_correlated_fraction, given.bench_sigma_m, given.bench_sigma_deg) > 0.0
    # sigmas, and correlation time of those that are estimated, infinite for a constant, None for a considered one
    groups = {
        "misalignment": (rad(given.vision_misalignment_sigma_deg) * three, math.inf),
        "bias": (np.array(given.vision_bias_sigma_m), None),
        "scale": (given.vision_scale_sigma * one, None),
        "correlated": (float(is_correlated) * np.ones(6), given.vision_correlation_time_s),
        "gyro_scale": (given.gyro_scale_sigma * three, None),
        "gyro_misalignment": (rad(given.gyro_misalignment_sigma_deg) * three, None),
        "gyro_instability": (rad(given.gyro_instability_degps) * three, given.gyro_instability_time_s),
        "accelerometer_scale": (given.accelerometer_scale_sigma * three, None),
        "accelerometer_misalignment": (rad(given.accelerometer_misalignment_sigma_deg) * three, None),
        "accelerometer_instability": (
            given.accelerometer_instability_mps2 * three,
            given.accelerometer_instability_time_s,
        ),
    }
    n = FILTER_ERRORS
    params.kept = np.ones(JOINT_MAX)
    for name, (sigmas, time_s) in groups.items():
        if not np.any(sigmas):
            continue
        here = slice(n, n + len(sigmas))
        params[name] = n
        params.variance[here] = sigmas**2
        if time_s is not None:
            params.kept[here], params.estimated[here] = math.exp(-scenario.sample_s / time_s), 1
        n += len(sigmas)
    params.n = n
    params.fraction = given.vision_correlated_fraction
    params.bench_variance = given.bench_sigma_m**2, rad(given.bench_sigma_deg) ** 2
    # of the logarithm of the variance
    params.noise_variance, params.noise_window = (2.0 * given.vision_noise_scale_sigma) ** 2, given.vision_noise_window
    params.camera_position, params.ring_position = given.camera_position_m, given.led_ring_position_m
    return params
