"""Parameters of guidance, navigation and control, from user units to SI."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from hil.config import scenario as config
from hil.config.scenario import REACTION_NAMES, Chaser, GncConfig, Scenario, Thrusters
from hil.core.messages import MAX_THRUSTERS, POSE, Array, new
from hil.dynamics.hill import input_response, transition
from hil.gnc.allocation import (
    AXES_OF_A_BODY,
    ROWS,
    axes_in_plane,
    opposing_thrusters,
    sets_without,
    thruster_sets,
    unit_wrenches,
)
from hil.gnc.approach_monitor import APPROACH_MONITOR_PARAMS
from hil.gnc.control import COAST_OF_TOLERANCE, CONTROL_PARAMS
from hil.gnc.estimation.integrity import INTEGRITY_PARAMS
from hil.gnc.estimation.navigation import NAVIGATION_PARAMS, VISION_ALONE, VISION_AND_IMU
from hil.gnc.estimation.target_orbit import TARGET_ORBIT
from hil.gnc.estimation.thrust_model import JUMP_NIS, JUMP_WINDOWS, THRUST_PARAMS
from hil.gnc.estimation.torque_witness import STAGES, TORQUE_PARAMS
from hil.gnc.guidance import APPROACH, ARC, FINAL, GUIDANCE_PARAMS, HOLD, LINE, RETREAT, SLEW, TRANSFER, WAIT
from hil.gnc.reactions import REACTION_PARAMS
from hil.gnc.step import GNC_PARAMS
from hil.gnc.thruster_monitor import THRUSTER_MONITOR_PARAMS
from hil.maths import chi_square, elementary, euler, linear, quat
from hil.maths.elementary import square
from hil.maths.kepler import mean_anomaly
from hil.params.bench import bodies as bodies_on
from hil.params.control_rule import control_rule
from hil.params.dynamics import AT_REST_RADPS, expected_rate, initial_truth, known_orbit, sun_direction
from hil.params.ephemeris import known_ephemeris
from hil.params.error_state import error_state
from hil.params.modes import correction_rates, moves, swing_allowance
from hil.params.sensors import NIS_TAIL, sensor_fusion
from hil.params.target import known_tumble, principal_axes
from hil.sensors.vision_unit.pose import write_pose

_CORRELATION_S = 10.0  # correlation time of the filters' errors
_TORQUE_MIN = 1e-9  # rad/s^2: thrusters without an arm have no torque
_DEAD_CYCLES = 6  # with a command, of which each counts in two
_IMU_S = 1.0  # for which an IMU must repeat its readings, or read what no thruster explains
_SOUND_S = 1.0  # for which readings must agree with the commands, or contradict them, to revoke an accusation
_SETTLED_S = 0.2  # a firing has been felt, also that of a valve that is late
_CONVERGED_FRACTION = 0.1  # fraction of the closing rate at the ready point
_GRADIENT = 1.5  # of the squared mean motion: largest angular acceleration by the gravity gradient
_TORQUE_MEAN_S = 3.0  # time constant of each low-pass of the gyros' angular acceleration
_LEAK_MIN = 0.0017  # fraction of a thrust: bending after a slew looks like less
_BENDING = 0.04  # of the mean torque of the firings over half a minute, that it leaves of the mean
_UNKNOWN_INERTIA = 0.5  # differences of moments of inertia over one of them
_MEASURED_FRACTION = 0.01  # fraction of a measured thrust: scale, misalignment, lever arm of accelerometers
_QUIET_WINDOW_S = 0.32  # over which quiet readings are averaged
_QUIET_SIGMAS = 5.0  # sigmas of a quiet reading
_WITNESS_AGE_MAX_S = 2.0  # age of a witness's measurement
_TARGET_RATE_FRACTION = 0.25  # fraction of the required rate for an error of the target's rate
_AHEAD_S = 0.02  # by which a pose may be stamped ahead of the loop, at least one step


def gnc(scenario: Scenario) -> np.record:
    """Return GNC_PARAMS of ``scenario``. Raises ValueError if the thruster layout cannot move an axis."""
    params = new(GNC_PARAMS)
    sets, strength = allocation(scenario.chaser)
    largest = math.radians(scenario.requirements.angular_rate_degps) / scenario.gnc.corridor.confidence
    params.approach.target_rate_sigma = _TARGET_RATE_FRACTION * largest
    params.approach.guidance = guidance(scenario)
    params.approach.monitor = approach_monitor(scenario)
    params.approach.reactions = _reactions(scenario)
    params.navigation = navigation(scenario)
    params.control = control(scenario, strength)
    params.n_thrusters = len(scenario.chaser.thrusters.position_m)
    params.sets = sets
    params.dead_sets, params.open_sets, params.against = _fault_allocation(scenario.chaser.thrusters)
    thrusters = scenario.chaser.thrusters
    if thrusters.isolation != "none":
        params.isolation = 1
        params.closing_cycles = math.ceil(thrusters.isolation_closing_s / scenario.step_s)
        params.isolates, params.isolated_sets = _isolation(thrusters)
    params.thruster_monitor = thruster_monitor(scenario)
    for row, settings in enumerate((scenario.gnc.navigation.settings, scenario.gnc.control.settings)):
        params.settings[row, : len(settings)] = list(settings.values())
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
    params.sensors = VISION_ALONE if gnc.navigation.backend == config.VISION_ALONE else VISION_AND_IMU
    fusion = params.fusion
    fusion.memory = scenario.memory_steps
    fusion.ring = 2 ** (scenario.memory_steps - 1).bit_length() - 1
    fusion.noise_scale = scenario.gnc.navigation.noise_scale
    fusion.ahead = max(1, round(_AHEAD_S / scenario.sample_s))
    fusion.held = scenario.chaser.held
    fusion.orbit = target_orbit(scenario)
    fusion.close_after, fusion.reopen_after = gnc.integrity.close_after, gnc.integrity.reopen_after
    akf = fusion.akf
    akf.dt_s = scenario.sample_s
    akf.sigma_gyro = _with_quantum(math.radians(gnc.akf.gyro_noise_degps), math.radians(gnc.akf.gyro_quantum_degps))
    # an error of the rate of H changes smoothly over the orbit, in the run by (n T)^2 of its variance; in a run of many
    # orbits it is a first-order Gauss-Markov process
    n = fusion.orbit.mean_motion
    growth = n * min(2.0, n * scenario.duration_s)  # 1/s
    akf.rate_sigma = np.radians(gnc.ephemeris.rate_sigma_degps)
    akf.rate_noise = akf.rate_sigma * math.sqrt(growth / scenario.sample_s)
    akf.sigma_drift = math.radians(gnc.akf.gyro_drift_noise_degps2)
    akf.initial_drift = np.radians(gnc.akf.gyro_drift_degps)
    akf.gate = _gate(scenario)
    akf.initial_drift_sigma = math.radians(gnc.akf.initial_drift_sigma_degps)
    pkf = fusion.pkf
    pkf.dt_s = scenario.sample_s
    rate = AT_REST_RADPS if fusion.orbit.tumble.rotates else fusion.orbit.mean_motion
    pkf.hill_transition = transition(rate, scenario.sample_s)
    pkf.hill_response = input_response(rate, scenario.sample_s)
    pkf.sigma_accelerometer = _with_quantum(gnc.pkf.accelerometer_noise_mps2, gnc.pkf.accelerometer_quantum_mps2)
    pkf.sigma_bias = gnc.pkf.accelerometer_bias_noise_mps3
    pkf.gate = akf.gate
    pkf.initial_velocity_sigma = gnc.pkf.initial_velocity_sigma_mps
    pkf.initial_bias = gnc.pkf.accelerometer_bias_mps2
    pkf.initial_bias_sigma = gnc.pkf.initial_bias_sigma_mps2
    fusion.errors = error_state(scenario)
    fusion.thrust = _thrust_model(scenario)
    fusion.sensors = sensor_fusion(scenario, int(fusion.errors.sensor_errors), _gate_tail(scenario))
    fusion.sensors.orbit = fusion.orbit
    if fusion.sensors.n:
        fusion.sensors.q_HI, fusion.sensors.sun_I = initial_truth(scenario).q_HI, sun_direction(scenario)
    witness = fusion.sensors.witness
    witness.acceleration, witness.angular_acceleration = largest_accelerations(scenario.chaser)
    witness.age_max_s, witness.step_s = _WITNESS_AGE_MAX_S, scenario.step_s
    witness.bound_sigmas = protection_sigmas(scenario)
    if params.sensors == VISION_ALONE:  # the drift is the error of a rate that starts from zero
        akf.initial_drift, akf.initial_drift_sigma = np.zeros(3), math.radians(gnc.navigation.thrust.rate_sigma_degps)
    params.dt_s = scenario.step_s
    params.integrity = integrity(scenario)
    if gnc.navigation.handover is not None:
        params.has_start, params.start = 1, handover_pose(scenario)
    return params


def handover_pose(scenario: Scenario) -> np.record:
    """Return the POSE from which the navigation starts: the planned start, with the standard deviations handed over."""
    pose, given = new(POSE), scenario.gnc.navigation.handover
    assert given is not None
    r_CT_H, q_CH = np.array(scenario.initial.position_m), quat.from_rotation_vector(initial_rotation_vector(scenario))
    write_pose(r_CT_H, q_CH, given.sigma_m, math.radians(given.sigma_deg), pose)
    return pose


def _thrust_model(scenario: Scenario) -> np.record:
    """Return THRUST_PARAMS."""
    params, given, thrusters = new(THRUST_PARAMS), scenario.gnc.navigation.thrust, scenario.chaser.thrusters
    dt_s = scenario.sample_s
    accelerations = _accelerations(scenario.chaser)
    params.enabled = given.enabled and not moves(scenario)
    params.n, params.dt_s, params.minimum_on_s = len(accelerations), dt_s, thrusters.minimum_on_s
    params.force[: params.n], params.torque[: params.n] = accelerations[:, :3], accelerations[:, 3:]
    params.settle = math.ceil(given.settle_s / dt_s - 1e-9)
    params.variance = square(given.velocity_noise_mps) / dt_s
    params.fraction, params.measured_fraction = given.scale_sigma, _MEASURED_FRACTION
    params.walk = given.disturbance_walk_mps2 * math.sqrt(dt_s / 60.0)
    params.rate_variance = square(math.radians(given.rate_noise_degps)) * dt_s
    params.window = min(max(1, round(_QUIET_WINDOW_S / dt_s)), scenario.memory_steps)
    params.gate = _QUIET_SIGMAS
    params.witness = _torque_witness(accelerations, params, scenario.gnc)
    return params


def _with_quantum(noise: float, quantum: float) -> float:
    """Return the standard deviation of a reading with a quantum whose remainder is read later, of its noise's unit."""
    return math.sqrt(square(noise) + square(quantum) / 6.0) if quantum > 0.0 else noise


def _torque_witness(accelerations: Array, thrust: np.record, gnc: GncConfig) -> np.record:
    """Return TORQUE_PARAMS. accelerations: of the thrusters, (n, 6). thrust: THRUST_PARAMS."""
    params = new(TORQUE_PARAMS)
    sizes = [(linear.length(row[:3]), linear.length(row[3:])) for row in accelerations]
    dt_s = float(thrust.dt_s)
    params.weight, params.delay = dt_s / _TORQUE_MEAN_S, round(STAGES * _TORQUE_MEAN_S / dt_s)
    params.limit, params.bending, params.turning = math.inf, _BENDING, _UNKNOWN_INERTIA
    turning = [(force, torque) for force, torque in sizes if torque > _TORQUE_MIN]
    if turning:
        seen = 2.0 * math.radians(gnc.akf.gyro_quantum_degps) / _TORQUE_MEAN_S
        params.limit = max(seen, _LEAK_MIN * max(torque for _, torque in turning))
        params.force = max(force / torque for force, torque in turning)
        noise = _with_quantum(gnc.pkf.accelerometer_noise_mps2, gnc.pkf.accelerometer_quantum_mps2)
        params.most = noise * math.sqrt(JUMP_NIS / (JUMP_WINDOWS * thrust.window)) / params.force
    return params


def integrity(scenario: Scenario) -> np.record:
    """Return INTEGRITY_PARAMS."""
    params, settings = new(INTEGRITY_PARAMS), scenario.gnc.integrity
    params.range_max = settings.pose_range_max_m
    params.sigma_max, params.sigma_angle_max = settings.pose_sigma_max_m, math.radians(settings.pose_sigma_max_deg)
    params.lost_after_s, params.suspect_after = settings.lost_after_s, settings.suspect_after
    params.mean_shift, params.cusum_limit = settings.mean_shift_sigmas, settings.cusum_limit_sigmas
    params.nis_weight = 1.0 / settings.nis_window
    params.nis_limit = chi_square.limit_of_recent_mean(settings.nis_window, 3, NIS_TAIL)
    params.gate = math.sqrt(_gate(scenario))
    params.vision_range = vision_range_m(scenario)
    params.sigmas = protection_sigmas(scenario)
    params.sigmas_go = math.sqrt(chi_square.upper_quantile(settings.go_risk_probability, 1))
    params.go_interval_s = settings.go_alarm_interval_s
    return params


def vision_range_m(scenario: Scenario) -> float:
    """Return the distance, m, up to which poses are expected."""
    range_m = scenario.gnc.integrity.vision_range_m
    return math.inf if range_m is None else range_m


def protection_sigmas(scenario: Scenario) -> float:
    """Return K of the protection levels: half the integrity risk, shared by four errors and independent samples."""
    return math.sqrt(chi_square.upper_quantile(_level_tail(scenario), 1))


def _level_tail(scenario: Scenario) -> float:
    """Return the probability of an error beyond its protection level, of each of four errors and each sample."""
    samples = max(1.0, scenario.duration_s / _CORRELATION_S)
    return 0.5 * scenario.gnc.integrity.risk_probability / (4.0 * samples)


def thruster_monitor(scenario: Scenario) -> np.record:
    """Return THRUSTER_MONITOR_PARAMS."""
    params, thrusters = new(THRUSTER_MONITOR_PARAMS), scenario.chaser.thrusters
    params.n, params.dt_s, params.minimum_on_s = len(thrusters.position_m), scenario.step_s, thrusters.minimum_on_s
    accelerations = _accelerations(scenario.chaser)
    params.force_unit = float(linear.lengths(accelerations[:, :3]).max())
    params.torque_unit = max(float(linear.lengths(accelerations[:, 3:]).max()), _TORQUE_MIN)
    units = np.repeat([params.force_unit, params.torque_unit], 3).astype(float)
    params.signature[: params.n] = accelerations / units
    signature = params.signature
    most = np.maximum(np.maximum(signature, 0.0).sum(axis=0), np.maximum(-signature, 0.0).sum(axis=0))
    params.most = np.maximum(most, 1.0)  # no thruster acts along the axis: that of one
    params.open_cycles = max(1, round(scenario.gnc.integrity.thruster_open_s / scenario.step_s))
    params.dead_cycles = _DEAD_CYCLES
    params.imu_cycles = max(1, round(_IMU_S / scenario.step_s))
    params.sound_cycles = max(1, round(_SOUND_S / scenario.step_s))
    params.settle_cycles = max(1, round(_SETTLED_S / scenario.step_s))
    # the mean of two cycles is off by half a quantum, the change of the rate between them by two
    force, rate = scenario.gnc.pkf.accelerometer_quantum_mps2, math.radians(scenario.gnc.akf.gyro_quantum_degps)
    params.resolution = 0.5 * force / params.force_unit, 2.0 * rate / (params.torque_unit * scenario.step_s)
    return params


def _accelerations(chaser: Chaser) -> Array:
    """Return the acceleration, m/s^2, and the angular acceleration, rad/s^2, of each thruster, shape (n, 6), in c."""
    thrusters = chaser.thrusters
    wrenches = unit_wrenches(
        np.array(thrusters.position_m),
        np.array(thrusters.direction),
        np.full(len(thrusters.position_m), thrusters.force_n),
    )
    return np.hstack([wrenches[:, :3] / chaser.mass_kg, linear.solve(chaser.inertia_kg_m2, wrenches[:, 3:].T).T])


def largest_accelerations(chaser: Chaser) -> tuple[float, float]:
    """Return the largest acceleration along an axis, m/s^2, and about one, rad/s^2, with all thrusters that give it."""
    most = np.abs(np.maximum(_accelerations(chaser), 0.0).sum(axis=0))
    return float(most[:3].max()), float(most[3:].max())


def converged_mps(scenario: Scenario) -> float:
    """Return the allowance of the closing rate, m/s, from which on the filters have converged."""
    return _CONVERGED_FRACTION * scenario.gnc.corridor.closing_rate_mps


def _reactions(scenario: Scenario) -> np.record:
    """Return REACTION_PARAMS."""
    params = new(REACTION_PARAMS)
    for row, condition in enumerate(scenario.gnc.reactions.conditions()):
        for kind, number in PHASE_KINDS.items():
            params.table[row, number] = REACTION_NAMES.index(getattr(condition, kind))
    params.time_to_alert_s = scenario.integrity.time_to_alert_s
    params.acquisition_s = scenario.gnc.integrity.acquisition_s
    params.converged_mps = converged_mps(scenario)
    params.hold_max_s = scenario.gnc.reactions.hold_max_s
    params.coast_share = scenario.gnc.reactions.coast_fraction
    return params


def target_orbit(scenario: Scenario) -> np.record:
    """Return TARGET_ORBIT: the target's orbit with the errors of the GNC's ephemeris."""
    orbit, params = known_orbit(scenario), new(TARGET_ORBIT)
    params.mean_motion = expected_rate(scenario)
    params.eccentricity = orbit.eccentricity
    params.mean_anomaly = mean_anomaly(orbit.eccentricity, math.radians(orbit.true_anomaly_deg))
    params.ephemeris = known_ephemeris(scenario)
    params.tumble = known_tumble(scenario, params.mean_motion)
    params.estimated = scenario.target.motion != "aligned" and scenario.gnc.target.rate_sigma_degps > 0.0
    params.moments, params.q_PB = scenario.target.moments_kg_m2, principal_axes(scenario.target)
    return params


def _gate_tail(scenario: Scenario) -> float:
    """Return the probability with which the gate rejects a sound innovation."""
    return chi_square.two_sided_tail(scenario.gnc.navigation.gate_sigma)


def _gate(scenario: Scenario) -> float:
    """Return the largest NIS of three components that the gate passes."""
    return chi_square.upper_quantile(_gate_tail(scenario), 3)


PHASE_KINDS = {"approach": APPROACH, "hold": HOLD, "wait": WAIT, "final": FINAL, "retreat": RETREAT}
PATHS = {"fly_around": ARC, "slew": SLEW, "transfer": TRANSFER}
"""Kinds of phases that move on another path than a line, otherwise as an approach."""
MOVING = ("approach", "final", "retreat", "transfer", "fly_around")
"""Kinds of phases that move the chaser."""
_SLEW_UP_S = 2.0
_BRAKE_FRACTION = 0.9  # fraction of the available thrust: the rest is for control


def braking_acceleration(scenario: Scenario) -> float:
    """Return the acceleration of the full-thrust sets along the docking axis with c parallel to H, m/s^2."""
    _, strength = allocation(scenario.chaser)
    axis = np.abs(np.array(scenario.gnc.corridor.axis))
    return float((strength[AXES_OF_A_BODY:] / np.maximum(axis, 1e-12)).min() / scenario.chaser.mass_kg)


def _demand_max(scenario: Scenario) -> float:
    """Return the acceleration that a demand gives along each axis, m/s^2; inf for a layout that is refused."""
    try:
        _, strength = allocation(scenario.chaser)
    except ValueError:
        return math.inf
    return float(strength[:3].min() / scenario.chaser.mass_kg)


def abort_brake(scenario: Scenario) -> float:
    """Return the deceleration of an abort, m/s^2: as set, at most what the thrusters give with a part for control."""
    try:
        return min(scenario.gnc.abort.brake_mps2, _BRAKE_FRACTION * braking_acceleration(scenario))
    except ValueError:  # a layout that cannot move an axis: refused by the check of the plan
        return scenario.gnc.abort.brake_mps2


def guidance(scenario: Scenario) -> np.record:
    """Return GUIDANCE_PARAMS: the phases in the order of the sequence, from the planned start on."""
    params = new(GUIDANCE_PARAMS)
    settings, abort = scenario.gnc.guidance, scenario.gnc.abort
    params.start = scenario.initial.position_m
    params.n_phases = len(settings.sequence)
    for k, name in enumerate(settings.sequence):
        phase = settings.phases[name]
        params.kind[k] = PHASE_KINDS.get(phase.kind, APPROACH)
        params.path[k] = PATHS.get(phase.kind, LINE)
        params.point[k] = phase.point_m or settings.ready_point_m
        params.speed[k] = phase.speed_mps or settings.approach_speed_mps
        params.acceleration[k] = phase.acceleration_mps2 or settings.acceleration_mps2
        params.deceleration[k] = phase.deceleration_mps2 or settings.deceleration_mps2
        if phase.attitude_deg is not None:
            params.attitude[k] = euler.to_quaternion(np.radians(phase.attitude_deg), euler.YAW_PITCH_ROLL)
            params.speed[k] = math.radians(phase.rate_degps or scenario.gnc.control.slew_rate_degps)
            acceleration = math.radians(phase.acceleration_degps2 or 0.0) or params.speed[k] / _SLEW_UP_S
            params.acceleration[k] = params.deceleration[k] = acceleration
        elif phase.kind in MOVING:
            most = max(params.acceleration[k], params.deceleration[k])
            params.full_thrust[k] = _demand_max(scenario) < most
        params.duration_s[k] = phase.duration_s or 0.0
        params.until_s[k] = math.inf if phase.end_time_s is None else phase.end_time_s
        params.optimal[k], params.passive_s[k] = phase.impulses == "optimal", phase.passively_safe_s or 0.0
    chaser, target = (bodies_on(scenario.keep_out.bodies, on) for on in ("chaser", "target"))
    apart = float(chaser.farthest + target.farthest) + scenario.keep_out.distance_m
    params.clear_range = max(scenario.keep_out.radius_m, apart)
    params.orbit = target_orbit(scenario)
    params.axis = scenario.gnc.corridor.axis
    axial_start = float(linear.product(scenario.initial.position_m, params.axis))
    # no farther out than the start, which the bench is known to reach
    params.abort_distance = min(abort.hold_distance_m, max(0.0, axial_start))
    params.abort_speed = abort.speed_mps
    params.abort_acceleration = abort.acceleration_mps2
    params.brake = abort_brake(scenario)
    return params


def approach_monitor(scenario: Scenario) -> np.record:
    """Return APPROACH_MONITOR_PARAMS."""
    params = new(APPROACH_MONITOR_PARAMS)
    corridor, needs = scenario.gnc.corridor, scenario.requirements
    params.cone = elementary.tan(math.radians(corridor.half_angle_deg))
    params.minimum_radius = corridor.minimum_radius_m
    params.closing_floor = corridor.closing_rate_mps
    params.closing_slope = corridor.closing_rate_slope_per_s
    params.closing_greatest = corridor.closing_rate_max_mps
    params.floor_range = linear.length(scenario.gnc.guidance.ready_point_m)
    params.confidence = corridor.confidence
    params.persistence = max(1, round(corridor.persistence_s / scenario.step_s))
    alert = scenario.integrity
    params.axis = corridor.axis
    params.alert_distance, params.alert_slope = alert.alert_axial_m, alert.alert_axial_per_range_scale
    params.keep_out, params.brake = scenario.keep_out.radius_m, abort_brake(scenario)
    bodies = scenario.keep_out.bodies
    params.chaser, params.target = bodies_on(bodies, "chaser"), bodies_on(bodies, "target")
    params.distance = scenario.keep_out.distance_m
    params.alert_turn = math.radians(alert.alert_attitude_deg) * float(params.chaser.arm.max())
    params.alert_corridor, params.alert_angle = alert.alert_corridor_fraction, math.radians(alert.alert_attitude_deg)
    at_s = scenario.gnc.abort.at_s
    params.abort_at_s = math.inf if at_s is None else at_s
    params.ready_point = (needs.axial_distance_m, 0.0, 0.0)
    params.ready_distance = (needs.axial_tolerance_m, needs.radial_distance_m, needs.radial_distance_m)
    params.ready_rate = (needs.axial_rate_mps, needs.radial_rate_mps, needs.radial_rate_mps)
    params.ready_angle = math.radians(needs.angle_deg)
    params.ready_angular_rate = math.radians(needs.angular_rate_degps)
    params.level_sigmas = protection_sigmas(scenario)
    # the built-in navigation watches innovations every 45 deg between the axes
    watches = scenario.gnc.navigation.backend in config.BUILT_IN["navigation"]
    params.across_share = 1.0 / elementary.cos(math.pi / 8.0) if watches else math.sqrt(2.0)
    params.across_sigmas = math.sqrt(-2.0 * elementary.log(_level_tail(scenario)))
    params.go_sigmas = math.sqrt(chi_square.upper_quantile(scenario.gnc.integrity.go_risk_probability, 1))
    params.go_fraction = scenario.gnc.integrity.go_fraction
    params.dwell_s = needs.dwell_s
    return params


def allocation(chaser: Chaser) -> tuple[np.ndarray, Array]:
    """Return the thruster sets, int64 (ROWS, 2, MAX_THRUSTERS), and the strength (ROWS,), N and N m, of each row.

    Axes in which a planar chaser is held have no set, and the least strength of the others. Raises ValueError if the
    layout cannot move an axis.
    """
    sets, strength = _allocation(chaser.thrusters, chaser.held)
    return sets.copy(), strength.copy()


@lru_cache(maxsize=8)
def _allocation(thrusters: Thrusters, held: int) -> tuple[np.ndarray, Array]:
    """Return ``allocation``, cached by layout: it searches thousands of sets."""
    n, wrenches = len(thrusters.position_m), wrenches_of(thrusters)
    axes = axes_in_plane(held)
    sets = np.zeros((ROWS, 2, MAX_THRUSTERS), dtype=np.int64)
    chosen, strength = thruster_sets(wrenches, axes=axes)
    sets[:AXES_OF_A_BODY, :, :n] = chosen
    full, high_thrust = thruster_sets(wrenches, full_thrust=True, axes=axes)
    sets[AXES_OF_A_BODY:, :, :n] = full[:3]
    rows = np.concatenate([strength, high_thrust[:3]]).reshape(3, 3)
    return sets, np.where(np.isfinite(rows), rows, rows.min(axis=1, keepdims=True)).ravel()


@lru_cache(maxsize=8)
def _fault_allocation(thrusters: Thrusters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``dead_sets``, ``open_sets`` and ``against`` of GNC_PARAMS."""
    n = len(thrusters.position_m)
    against = opposing_thrusters(wrenches_of(thrusters))
    dead, stuck = np.eye(n, dtype=bool), np.eye(n, dtype=bool) | against.astype(bool)
    return _sets_without(thrusters, dead), _sets_without(thrusters, stuck), _square(against)


@lru_cache(maxsize=8)
def _isolation(thrusters: Thrusters) -> tuple[np.ndarray, np.ndarray]:
    """Return ``isolates`` and ``isolated_sets`` of GNC_PARAMS."""
    n = len(thrusters.position_m)
    closed = np.eye(n, dtype=bool)
    if thrusters.isolation == "bank":
        closed = np.equal.outer(thrusters.bank, thrusters.bank)
    return _square(closed), _sets_without(thrusters, closed)


def wrenches_of(thrusters: Thrusters) -> Array:
    """Return force, N, and torque, N m, of each thruster, (n, 6), in c."""
    n = len(thrusters.position_m)
    return unit_wrenches(np.array(thrusters.position_m), np.array(thrusters.direction), np.full(n, thrusters.force_n))


def _sets_without(thrusters: Thrusters, excluded: np.ndarray) -> np.ndarray:
    """Return the sets without the thrusters of each row of ``excluded`` (n, n), in the shape of GNC_PARAMS."""
    n, wrenches = len(thrusters.position_m), wrenches_of(thrusters)
    table = np.zeros((MAX_THRUSTERS, ROWS, 2, MAX_THRUSTERS), np.int8)
    table[:n, :AXES_OF_A_BODY, :, :n] = sets_without(wrenches, excluded)
    table[:n, AXES_OF_A_BODY:, :, :n] = sets_without(wrenches, excluded, full_thrust=True)[:, :3]
    return table


def _square(table: np.ndarray) -> np.ndarray:
    """Return ``table`` (n, n) in the shape of GNC_PARAMS."""
    n, padded = len(table), np.zeros((MAX_THRUSTERS, MAX_THRUSTERS), np.int8)
    padded[:n, :n] = table
    return padded


def control(scenario: Scenario, strength: Array) -> np.record:
    """Return CONTROL_PARAMS; ``strength`` (ROWS,), N and N m, as ``allocation`` gives it."""
    params = new(CONTROL_PARAMS)
    settings, rule = scenario.gnc.control, control_rule(scenario, strength)
    step_s = scenario.step_s

    def six(force: float, torque: float) -> list[float]:
        return [force] * 3 + [torque] * 3

    params.dt_s, params.pulse_s = step_s, rule.pulse_s
    coast = np.array(six(settings.deadband_m, math.radians(settings.deadband_deg)))
    pulse = rule.pulse_s * rule.acceleration
    swing = swing_allowance(scenario, pulse, rule.lead_bounds_s[:, 0])
    by_rule = np.minimum(rule.coast_max, rule.coast_scale * square(pulse))
    params.deadband = np.where(swing > 0.0, np.maximum(coast, by_rule) + swing, coast)
    params.deadband_sigmas = six(settings.deadband_sigmas, settings.attitude_deadband_sigmas)
    params.lead = six(settings.lead_s, settings.attitude_lead_s)
    params.rate_max, params.go_fraction = rule.rate_max, scenario.gnc.integrity.go_fraction
    params.go_s = scenario.requirements.go_valid_s
    gradient = _GRADIENT * square(expected_rate(scenario))
    params.drift = six(scenario.gnc.navigation.thrust.disturbance_mps2, gradient)
    params.lead_bounds = rule.lead_bounds_s
    params.coast_scale, params.coast_max = rule.coast_scale, rule.coast_max
    rates = np.array(six(settings.correction_rate_mps, math.radians(settings.slew_rate_degps)))
    params.correction_rate = correction_rates(scenario, rates, rule.coast_max / COAST_OF_TOLERANCE, rule.rate_max)
    periods_s = six(settings.period_s or rule.period_s, settings.attitude_period_s or rule.period_s)
    params.period = [max(1, round(s / step_s)) for s in periods_s]
    params.acceleration = rule.acceleration
    params.high_thrust_acceleration = strength[6:] / scenario.chaser.mass_kg
    params.inertia = np.array(scenario.chaser.inertia_kg_m2)
    params.predicts = settings.backend == config.PREDICTIVE
    params.held = [axis not in axes_in_plane(scenario.chaser.held) for axis in range(AXES_OF_A_BODY)]
    return params
