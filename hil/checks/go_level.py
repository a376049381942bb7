"""Whether docking can be a go at all: the requirement against level, smallest firings and limit cycle of the vehicle.

A warning before a run, which may be flown to see why. The least level is that of filters that have converged
at the ready point with all thrusters closed, from noise and rate of the poses, the error budget, and the smallest step
of the poses that is missed (docs/explanation/integrity.md). The limit cycle is that of the rule of control.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import BUILT_IN, Scenario
from hil.core.messages import Array
from hil.dynamics.thrusters import STANDARD_GRAVITY_MPS2
from hil.gnc.control import held_error, rule_of
from hil.gnc.estimation.integrity import USUAL_SUM, go_sum
from hil.gnc.estimation.sensor_monitor import largest_missed
from hil.maths import linear
from hil.maths.elementary import square
from hil.params.gnc import allocation, control, integrity
from hil.params.sensors import sensors_of

_UPDATES: Final = 20_000  # updates until a steady state is reached
_SETTLED: Final = 1e-7  # relative change of a variance
_VELOCITY_MPS: Final = 0.01  # 1 sigma at the start
_DEG: Final = math.degrees(1.0)


class AxisHold(NamedTuple):
    """How an axis is held at the ready point, in m and m/s, of an attitude in deg and deg/s.

    change: of the rate by a smallest firing; a go allows change_max, a part of rate_max. held: largest error over the
    time of a go. amplitude, period_s, propellant_kgph: of the limit cycle that smallest firings make without noise.
    level: least one of a go, 0 if it is not known. rate_key, key: of the requirement, in the order of rate_max and
    tolerance.
    """

    name: str
    unit: str
    change: float
    change_max: float
    rate_key: str
    rate_max: float
    held: float
    level: float
    key: str
    tolerance: float
    amplitude: float
    period_s: float
    propellant_kgph: float

    @property
    def why_not(self) -> str:
        """Why there is no go, "" if there can be one."""
        allowed = f"requirements.{self.key} = {self.tolerance:g}"
        if self.level >= self.tolerance:
            return f"{allowed}: the level of a go is {self.level:.2g} {self.unit} at least, so there will be none"
        if self.change > self.change_max:
            return (
                f"requirements.{self.rate_key} = {self.rate_max:g}: the smallest firing changes the rate {self.name} "
                f"by {self.change:.2g} {self.unit}/s, a go allows {self.change_max:.2g}, so there will be none"
            )
        with_level = self.held + self.level
        if with_level > self.tolerance:
            return (
                f"{allowed}: control holds it {self.name} within {with_level:.2g} {self.unit} with the level of a go, "
                "so there is one only while the chaser coasts"
            )
        return ""


def go_warnings(scenario: Scenario, rig: Rig) -> list[str]:
    """Return a line for each requirement with which there will be no go, by level, firings or limit cycle."""
    if scenario.gnc.binary is not None or scenario.gnc.control.backend not in BUILT_IN["control"]:
        return []
    try:
        reasons = [axis.why_not for axis in predicted_hold(scenario, rig)]
    except ValueError:  # a layout that cannot move an axis: refused by the check of the plan
        return []
    return list(dict.fromkeys(filter(None, reasons)))


def predicted_hold(scenario: Scenario, rig: Rig) -> list[AxisHold]:
    """Return how x, y, z and the attitude about them are held, without what the plane of a planar chaser holds.

    Raises ValueError if the layout cannot move an axis.
    """
    needs, thrusters = scenario.requirements, scenario.chaser.thrusters
    sets, strength = allocation(scenario.chaser)
    params = control(scenario, strength)
    levels, sigma_m, sigma_mps = least_levels(scenario, rig)
    axes = []
    for k in np.flatnonzero(params.held == 0).tolist():
        i, is_turn = k % 3, k >= 3
        sigma, sigma_rate = (0.0, 0.0) if is_turn else (float(sigma_m[i]), sigma_mps)
        pulse = float(params.acceleration[k] * params.pulse_s)
        coast = float(rule_of(params, k, sigma, sigma_rate, pulse)[2])
        held = float(held_error(params, k, 0.0, 0.5 * pulse, sigma, sigma_rate, 0.0, pulse))
        opened_s = 2.0 * params.pulse_s * int(sets[k].sum(axis=1).max())  # thruster seconds in a cycle
        period_s = 8.0 * coast / pulse  # to an amplitude and back at half of a firing's change, twice
        kg = opened_s * thrusters.force_n / (thrusters.specific_impulse_s * STANDARD_GRAVITY_MPS2)
        axial = "axial" if i == 0 else "radial"
        rate_key, key = f"{axial}_rate_mps", "axial_tolerance_m" if i == 0 else "radial_distance_m"
        if is_turn:
            rate_key, key = "angular_rate_degps", "angle_deg"
        scale, unit, along = (_DEG, "deg", "about") if is_turn else (1.0, "m", "along")
        axes.append(
            AxisHold(
                f"{along} {'xyz'[i]}",
                unit,
                scale * pulse,
                scenario.gnc.integrity.go_fraction * getattr(needs, rate_key),
                rate_key,
                getattr(needs, rate_key),
                scale * held,
                0.0 if is_turn else float(levels[i]),
                key,
                getattr(needs, key),
                scale * coast,
                period_s,
                3600.0 / period_s * kg,
            )
        )
    return axes


def least_levels(scenario: Scenario, rig: Rig) -> tuple[Array, Array, float]:
    """Return the least levels of a go at the ready point, m, along the docking axis and across it, (3,), and sigmas.

    These are standard deviations of position, m, (3,), and velocity, m/s.

    Levels are 0 for another navigation than the built-in one with poses and IMU alone.
    """
    params, vmu, budget = integrity(scenario), scenario.vmu, scenario.gnc.navigation.budget
    distance = linear.length(scenario.gnc.guidance.ready_point_m)
    noise = vmu.sigma_position_m * max(1.0, distance / vmu.reference_range_m)
    walk_mps = scenario.gnc.navigation.thrust.velocity_noise_mps
    variance, speed_variance, gain, gain_speed = _steady(noise, 1.0 / rig.vmu.rate_hz, walk_mps)
    turned = math.radians(budget.vision_misalignment_sigma_deg)
    spread = distance * np.array([budget.vision_scale_sigma, turned, turned])
    vision = np.sqrt(square(spread) + square(np.array(budget.vision_bias_sigma_m)))
    limit = min(USUAL_SUM, go_sum(params, 1.0 / rig.vmu.rate_hz))
    missed, _ = largest_missed(params, gain, gain_speed, limit / params.mean_shift, limit, 0, np.inf)
    sigma = np.sqrt(variance + square(vision))
    levels: Array = params.sigmas_go * sigma + missed * math.sqrt(square(noise) + variance)
    fused = any(sensor.config.use == "fusion" for sensor in sensors_of(scenario).values())
    return (np.zeros(3) if fused or not scenario.gnc.fuses_imu else levels), sigma, math.sqrt(speed_variance)


def _steady(noise_m: float, interval_s: float, velocity_noise_mps: float) -> tuple[float, float, float, float]:
    """Return variances of position, m^2, and velocity, and gains of both, of a filter of one axis, converged."""
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
    return rr, vv, gain, speed * interval_s
