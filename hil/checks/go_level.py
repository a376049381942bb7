"""Whether docking can ever be a go: the requirement against the least level that the built-in navigation can reach.

A warning before a run, which may be flown to see why. The least level is that of filters that have converged
at the ready point with all thrusters closed, from noise and rate of the poses, the error budget, and the smallest step
of the poses that is missed (docs/explanation/integrity.md).
"""

from __future__ import annotations

import math

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.gnc.estimation.missed_fault import largest_missed
from hil.maths import linear
from hil.maths.elementary import square
from hil.params.gnc import integrity
from hil.params.sensors import sensors_of

_UPDATES = 20_000  # updates until a steady state is reached
_SETTLED = 1e-7  # relative change of a variance
_VELOCITY_MPS = 0.01  # 1 sigma at the start
_KEYS = ("axial_tolerance_m", "radial_distance_m", "radial_distance_m")


def go_warnings(scenario: Scenario, rig: Rig) -> list[str]:
    """Return a line for each requirement of the position that is tighter than the level of a go can be."""
    if not scenario.gnc.fuses_imu or any(sensor.config.use == "fusion" for sensor in sensors_of(scenario).values()):
        return []
    levels, lines = least_levels(scenario, rig), []
    for key, level in zip(_KEYS, levels, strict=True):
        allowed = getattr(scenario.requirements, key)
        line = f"requirements.{key} = {allowed:g}: the level of a go is {level:.2g} m at least, so there will be none"
        if level >= allowed and line not in lines:
            lines.append(line)
    return lines


def least_levels(scenario: Scenario, rig: Rig) -> Array:
    """Return the least levels of a go at the ready point, m, along the docking axis and across it, (3,)."""
    params, vmu, budget = integrity(scenario), scenario.vmu, scenario.gnc.navigation.budget
    distance = linear.length(scenario.gnc.guidance.ready_point_m)
    noise = vmu.sigma_position_m * max(1.0, distance / vmu.reference_range_m)
    walk_mps = scenario.gnc.navigation.thrust.velocity_noise_mps
    variance, gain, gain_speed = _steady(noise, 1.0 / rig.vmu.rate_hz, walk_mps)
    turned = math.radians(budget.vision_misalignment_sigma_deg)
    spread = distance * np.array([budget.vision_scale_sigma, turned, turned])
    vision = np.sqrt(square(spread) + square(np.array(budget.vision_bias_sigma_m)))
    poses = params.cusum_go / params.mean_shift
    missed, _ = largest_missed(params, gain, gain_speed, poses, params.cusum_go, 0, np.inf)
    levels: Array = params.sigmas_go * np.sqrt(variance + square(vision)) + missed * math.sqrt(square(noise) + variance)
    return levels


def _steady(noise_m: float, interval_s: float, velocity_noise_mps: float) -> tuple[float, float, float]:
    """Return variance of the position, m^2, and gains of position and velocity of a filter of one axis, converged."""
    rr, rv, vv = square(noise_m), 0.0, square(_VELOCITY_MPS)
    gain = speed = 0.0
    for _ in range(_UPDATES):
        previous = vv
        rr += interval_s * (2.0 * rv + interval_s * vv)
        rv += interval_s * vv
        vv += square(velocity_noise_mps) * interval_s
        innovation = rr + square(noise_m)
        gain, speed = rr / innovation, rv / innovation
        rr, rv, vv = (1.0 - gain) * rr, (1.0 - gain) * rv, vv - speed * rv
        if abs(vv - previous) < _SETTLED * previous:
            break
    return rr, gain, speed * interval_s
