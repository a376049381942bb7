"""Parameters of guidance, navigation and control, from user units to SI."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from hil.config.scenario import Chaser, Scenario, Thrusters
from hil.core.messages import MAX_THRUSTERS, Array, new
from hil.dynamics.hill import input_response, transition
from hil.gnc.allocation import AXES_OF_A_BODY, ROWS, thruster_sets, unit_wrenches
from hil.gnc.approach_monitor import APPROACH_MONITOR_PARAMS
from hil.gnc.control import CONTROL_PARAMS
from hil.gnc.fusion import AS_PRINTED, MULTIPLICATIVE
from hil.gnc.guidance import APPROACH, FINAL, GUIDANCE_PARAMS, HOLD, RETREAT, WAIT
from hil.gnc.navigation import NAVIGATION_PARAMS, VISION_ALONE, VISION_AND_IMU
from hil.gnc.step import GNC_PARAMS
from hil.gnc.target_orbit import TARGET_ORBIT
from hil.maths import chi_square, euler, quat
from hil.maths.kepler import mean_anomaly
from hil.params.dynamics import mean_motion

_AHEAD_S = 0.02  # by which a pose may be stamped ahead of the loop, at least one step


def gnc(scenario: Scenario) -> np.record:
    """Return GNC_PARAMS of ``scenario``. Raises ValueError if the thruster layout cannot move an axis."""
    params = new(GNC_PARAMS)
    sets, strength = allocation(scenario.chaser)
    params.approach.dwell_s = scenario.requirements.dwell_s
    params.approach.guidance = guidance(scenario)
    params.approach.monitor = approach_monitor(scenario)
    params.navigation = navigation(scenario)
    params.control = control(scenario, strength)
    params.n_thrusters = len(scenario.chaser.thrusters.position_m)
    params.sets = sets
    return params


def initial_rotation_vector(scenario: Scenario) -> Array:
    """Return the chaser's initial attitude against H as a rotation vector (3,), rad."""
    q = euler.to_quaternion(np.radians(scenario.initial.attitude_deg), euler.YAW_PITCH_ROLL)
    phi: Array = quat.to_rotation_vector(q)
    return phi


def navigation(scenario: Scenario) -> np.record:
    """Return NAVIGATION_PARAMS."""
    params = new(NAVIGATION_PARAMS)
    gnc = scenario.gnc
    params.sensors = VISION_AND_IMU if gnc.navigation.sensors == "vision_imu" else VISION_ALONE
    fusion = params.fusion
    fusion.attitude_form = AS_PRINTED if gnc.akf.form == "as_printed" else MULTIPLICATIVE
    fusion.memory = scenario.memory_steps
    fusion.ahead = max(1, round(_AHEAD_S / scenario.sample_s))
    fusion.orbit = target_orbit(scenario)
    akf = fusion.akf
    akf.dt_s = scenario.sample_s
    akf.sigma_gyro = math.radians(gnc.akf.gyro_noise_degps)
    akf.sigma_drift = math.radians(gnc.akf.gyro_drift_noise_degps2)
    akf.initial_drift = np.radians(gnc.akf.gyro_drift_degps)
    akf.gate = _gate(gnc.navigation.gate_sigma)
    akf.initial_drift_sigma = math.radians(gnc.akf.initial_drift_sigma_degps)
    pkf = fusion.pkf
    pkf.dt_s = scenario.sample_s
    pkf.hill_transition = transition(fusion.orbit.mean_motion, scenario.sample_s)
    pkf.hill_response = input_response(fusion.orbit.mean_motion, scenario.sample_s)
    pkf.sigma_accelerometer = gnc.pkf.accelerometer_noise_mps2
    pkf.sigma_bias = gnc.pkf.accelerometer_bias_noise_mps3
    pkf.gate = akf.gate
    pkf.initial_velocity_sigma = gnc.pkf.initial_velocity_sigma_mps
    pkf.initial_bias = gnc.pkf.accelerometer_bias_mps2
    pkf.initial_bias_sigma = gnc.pkf.initial_bias_sigma_mps2
    vision = params.vision_only
    vision.dt_s = scenario.step_s
    vision.position_lag_s = gnc.vision_only.position_lag_s
    vision.velocity_lag_s = gnc.vision_only.velocity_lag_s
    vision.attitude_lag_s = gnc.vision_only.attitude_lag_s
    vision.rate_lag_s = gnc.vision_only.rate_lag_s
    return params


def target_orbit(scenario: Scenario) -> np.record:
    """Return TARGET_ORBIT: the target's orbit with the errors of the GNC's ephemeris."""
    known, params = scenario.gnc_orbit, new(TARGET_ORBIT)
    params.mean_motion = mean_motion(known)
    params.eccentricity = known.eccentricity
    params.mean_anomaly = mean_anomaly(known.eccentricity, math.radians(known.true_anomaly_deg))
    return params


def _gate(sigma: float) -> float:
    """Return the NIS of three components with the tail probability of ``sigma`` standard deviations of one."""
    return chi_square.upper_quantile(chi_square.two_sided_tail(sigma), 3)


PHASE_KINDS = {"approach": APPROACH, "hold": HOLD, "wait": WAIT, "final": FINAL, "retreat": RETREAT}
_BRAKE_FRACTION = 0.9  # of the available thrust: the rest is for control


def braking_acceleration(scenario: Scenario) -> float:
    """Return the acceleration of the full-thrust sets along the docking axis with c parallel to H, m/s^2."""
    _, strength = allocation(scenario.chaser)
    axis = np.abs(np.array(scenario.gnc.corridor.axis))
    return float((strength[AXES_OF_A_BODY:] / np.maximum(axis, 1e-12)).min() / scenario.chaser.mass_kg)


def guidance(scenario: Scenario) -> np.record:
    """Return GUIDANCE_PARAMS: the phases in the order of the sequence, from the planned start on."""
    params = new(GUIDANCE_PARAMS)
    settings, abort = scenario.gnc.guidance, scenario.gnc.abort
    params.start = scenario.initial.position_m
    params.n_phases = len(settings.sequence)
    for k, name in enumerate(settings.sequence):
        phase = settings.phases[name]
        params.kind[k] = PHASE_KINDS[phase.kind]
        params.point[k] = phase.point_m or settings.ready_point_m
        params.speed[k] = phase.speed_mps or settings.approach_speed_mps
        params.acceleration[k] = phase.acceleration_mps2 or settings.acceleration_mps2
        params.deceleration[k] = phase.deceleration_mps2 or settings.deceleration_mps2
        params.duration_s[k] = phase.duration_s or 0.0
        params.until_s[k] = math.inf if phase.end_time_s is None else phase.end_time_s
    params.axis = scenario.gnc.corridor.axis
    axial_start = float(np.dot(scenario.initial.position_m, params.axis))
    # no farther out than the start, which the bench is known to reach
    params.abort_distance = min(abort.hold_distance_m, max(0.0, axial_start))
    params.abort_speed = abort.speed_mps
    params.abort_acceleration = abort.acceleration_mps2
    params.brake = min(abort.brake_mps2, _BRAKE_FRACTION * braking_acceleration(scenario))
    return params


def approach_monitor(scenario: Scenario) -> np.record:
    """Return APPROACH_MONITOR_PARAMS."""
    params = new(APPROACH_MONITOR_PARAMS)
    corridor, wanted = scenario.gnc.corridor, scenario.requirements
    params.cone = math.tan(math.radians(corridor.half_angle_deg))
    params.minimum_radius = corridor.minimum_radius_m
    params.closing_floor = corridor.closing_rate_mps
    params.closing_slope = corridor.closing_rate_slope_per_s
    params.closing_greatest = corridor.closing_rate_max_mps
    params.floor_range = math.hypot(*scenario.gnc.guidance.ready_point_m)
    params.confidence = corridor.confidence
    params.persistence = max(1, round(corridor.persistence_s / scenario.step_s))
    at_s = scenario.gnc.abort.at_s
    params.abort_at_s = math.inf if at_s is None else at_s
    params.ready_point = (wanted.axial_distance_m, 0.0, 0.0)
    params.ready_distance = (wanted.axial_tolerance_m, wanted.radial_distance_m, wanted.radial_distance_m)
    params.ready_rate = (wanted.axial_rate_mps, wanted.radial_rate_mps, wanted.radial_rate_mps)
    params.ready_angle = math.radians(wanted.angle_deg)
    params.ready_angular_rate = math.radians(wanted.angular_rate_degps)
    return params


def allocation(chaser: Chaser) -> tuple[np.ndarray, Array]:
    """Return the thruster sets, int64 (ROWS, 2, MAX_THRUSTERS), and the strength (ROWS,), N and N m, of each row.

    Raises ValueError if the layout cannot move an axis.
    """
    sets, strength = _allocation(chaser.thrusters)
    return sets.copy(), strength.copy()


@lru_cache(maxsize=8)
def _allocation(thrusters: Thrusters) -> tuple[np.ndarray, Array]:
    """Return ``allocation``, cached by layout: it searches thousands of sets."""
    n = len(thrusters.position_m)
    wrenches = unit_wrenches(
        np.array(thrusters.position_m), np.array(thrusters.direction), np.full(n, thrusters.force_n)
    )
    sets = np.zeros((ROWS, 2, MAX_THRUSTERS), dtype=np.int64)
    chosen, strength = thruster_sets(wrenches)
    sets[:AXES_OF_A_BODY, :, :n] = chosen
    full, high_thrust = thruster_sets(wrenches, full_thrust=True)
    sets[AXES_OF_A_BODY:, :, :n] = full[:3]
    return sets, np.concatenate([strength, high_thrust[:3]])


def control(scenario: Scenario, strength: Array) -> np.record:
    """Return CONTROL_PARAMS; ``strength`` (ROWS,), N and N m, as ``allocation`` gives it."""
    params = new(CONTROL_PARAMS)
    settings = scenario.gnc.control
    step_s = scenario.step_s

    def six(force: float, torque: float) -> list[float]:
        return [force] * 3 + [torque] * 3

    params.dt_s = step_s
    params.deadband = six(settings.deadband_m, math.radians(settings.deadband_deg))
    params.deadband_sigmas = six(settings.deadband_sigmas, settings.attitude_deadband_sigmas)
    params.lead = six(settings.lead_s, settings.attitude_lead_s)
    params.correction_rate = six(settings.correction_rate_mps, math.radians(settings.slew_rate_degps))
    params.period = [max(1, round(s / step_s)) for s in six(settings.period_s, settings.attitude_period_s)]
    inertia = np.diag(np.array(scenario.chaser.inertia_kg_m2))
    params.acceleration = np.concatenate([strength[:3] / scenario.chaser.mass_kg, strength[3:6] / inertia])
    params.high_thrust_acceleration = strength[6:] / scenario.chaser.mass_kg
    return params
