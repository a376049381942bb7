"""From configuration, in the units of people, to the parameter records of the kernels, in SI."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import chi2, norm

from hil.bench.kinematics import BENCH_PARAMS
from hil.config.rig import Rig
from hil.config.scenario import Chaser, Scenario
from hil.dss_parameters import YAW_PITCH_ROLL as YAW_PITCH_ROLL
from hil.dss_parameters import dss as dss
from hil.dss_parameters import field as field
from hil.dss_parameters import initial_truth as initial_truth
from hil.dss_parameters import orbit_rate as orbit_rate
from hil.dss_parameters import thruster_draws_shape as thruster_draws_shape
from hil.dynamics.hill import input_response, transition
from hil.dynamics.imu import IMU_PARAMS
from hil.dynamics.vision import VISION_PARAMS
from hil.gnc.allocation import AXES_OF_A_BODY, thruster_sets, unit_wrenches
from hil.gnc.control import CONTROL_PARAMS
from hil.gnc.fusion import AS_PRINTED, MULTIPLICATIVE
from hil.gnc.guidance import GUIDANCE_PARAMS
from hil.gnc.navigation import NAVIGATION_PARAMS, VISION_ALONE, VISION_AND_IMU
from hil.maths import euler, quat
from hil.maths.stations import STATIONS
from hil.messages import MAX_THRUSTERS, Array, new


def initial_rotation_vector(scenario: Scenario) -> Array:
    """Return the chaser's initial attitude against H as a rotation vector (3,), rad."""
    q = euler.to_quaternion(np.radians(scenario.initial.attitude_deg), YAW_PITCH_ROLL)
    phi: Array = quat.to_rotation_vector(q)
    return phi


def imu(scenario: Scenario) -> np.record:
    """Return IMU_PARAMS."""
    params = new(IMU_PARAMS)
    params.dt_s = scenario.step_s
    params.sigma_gyro = math.radians(scenario.imu.gyro_noise_degps)
    params.sigma_drift = math.radians(scenario.imu.gyro_drift_noise_degps2)
    params.sigma_accelerometer = scenario.imu.accelerometer_noise_mps2
    params.sigma_bias = scenario.imu.accelerometer_bias_noise_mps3
    return params


def vision(scenario: Scenario) -> np.record:
    """Return VISION_PARAMS."""
    params = new(VISION_PARAMS)
    params.sigma_position = scenario.vmu.sigma_position_m
    params.sigma_angle = math.radians(scenario.vmu.sigma_angle_deg)
    params.reference_range = scenario.vmu.reference_range_m
    params.reported_scale = scenario.vmu.reported_sigma_scale
    return params


def stations(rig: Rig) -> np.record:
    """Return STATIONS."""
    params = new(STATIONS)
    params.camera_station = rig.bench.camera_station_m
    params.q_vc = quat.from_matrix(np.array(rig.bench.camera_axes))
    params.ring_station = rig.bench.ring_station_m
    params.q_th = quat.from_matrix(np.array(rig.bench.ring_axes))
    return params


def navigation(scenario: Scenario) -> np.record:
    """Return NAVIGATION_PARAMS."""
    params = new(NAVIGATION_PARAMS)
    gnc = scenario.gnc
    w0 = orbit_rate(scenario)
    params.sensors = VISION_AND_IMU if gnc.navigation.sensors == "vision_imu" else VISION_ALONE
    fusion = params.fusion
    fusion.attitude_form = AS_PRINTED if gnc.akf.form == "as_printed" else MULTIPLICATIVE
    akf = fusion.akf
    akf.dt_s = scenario.step_s
    akf.orbit_rate = w0
    akf.sigma_gyro = math.radians(gnc.akf.gyro_noise_degps)
    akf.sigma_drift = math.radians(gnc.akf.gyro_drift_noise_degps2)
    akf.initial_drift = np.radians(gnc.akf.gyro_drift_degps)
    akf.gate = _gate(gnc.navigation.gate_sigma)
    akf.initial_drift_sigma = math.radians(gnc.akf.initial_drift_sigma_degps)
    pkf = fusion.pkf
    pkf.dt_s = scenario.step_s
    pkf.hill_transition = transition(w0, scenario.step_s)
    pkf.hill_response = input_response(w0, scenario.step_s)
    pkf.sigma_accelerometer = gnc.pkf.accelerometer_noise_mps2
    pkf.sigma_bias = gnc.pkf.accelerometer_bias_noise_mps3
    pkf.gate = akf.gate
    pkf.initial_velocity_sigma = gnc.pkf.initial_velocity_sigma_mps
    pkf.initial_bias = gnc.pkf.accelerometer_bias_mps2
    pkf.initial_bias_sigma = gnc.pkf.initial_bias_sigma_mps2
    look = params.vision_only
    look.dt_s = scenario.step_s
    look.position_lag_s = gnc.vision_only.position_lag_s
    look.velocity_lag_s = gnc.vision_only.velocity_lag_s
    look.attitude_lag_s = gnc.vision_only.attitude_lag_s
    look.rate_lag_s = gnc.vision_only.rate_lag_s
    return params


def _gate(sigma: float) -> float:
    """Return the NIS of three components that is as rare as ``sigma`` standard deviations of one."""
    return float(chi2.isf(2.0 * norm.sf(sigma), 3))


def guidance(scenario: Scenario) -> np.record:
    """Return GUIDANCE_PARAMS: the line from the planned start to the ready point."""
    params = new(GUIDANCE_PARAMS)
    params.start = scenario.initial.position_m
    params.ready = scenario.gnc.guidance.ready_point_m
    params.speed = scenario.gnc.guidance.approach_speed_mps
    params.acceleration = scenario.gnc.guidance.acceleration_mps2
    params.deceleration = scenario.gnc.guidance.deceleration_mps2
    return params


def allocation(chaser: Chaser) -> tuple[np.ndarray, Array]:
    """Return the thruster sets, int64 (6, 2, MAX_THRUSTERS), and the strength (6,), N and N m, of the six axes.

    Raises ValueError where the layout cannot move an axis.
    """
    thrusters = chaser.thrusters
    n = len(thrusters.position_m)
    wrenches = unit_wrenches(
        np.array(thrusters.position_m), np.array(thrusters.direction), np.full(n, thrusters.force_n)
    )
    chosen, strength = thruster_sets(wrenches)
    sets = np.zeros((AXES_OF_A_BODY, 2, MAX_THRUSTERS), dtype=np.int64)
    sets[:, :, :n] = chosen
    return sets, strength


def control(scenario: Scenario, strength: Array) -> np.record:
    """Return CONTROL_PARAMS; ``strength`` (6,), N and N m, as ``allocation`` gives it."""
    params = new(CONTROL_PARAMS)
    settings = scenario.gnc.control
    params.position_deadband = settings.deadband_m
    params.position_lead = settings.lead_s
    params.attitude_deadband = math.radians(settings.deadband_deg)
    params.attitude_lead = settings.attitude_lead_s
    params.dt_s = scenario.step_s
    params.position_period = max(1, round(settings.period_s / scenario.step_s))
    params.attitude_period = max(1, round(settings.attitude_period_s / scenario.step_s))
    params.acceleration = strength[:3] / scenario.chaser.mass_kg
    params.angular_acceleration = strength[3:] / np.diag(np.array(scenario.chaser.inertia_kg_m2))
    return params


def bench(rig: Rig, step_s: float) -> np.record:
    """Return BENCH_PARAMS: geometry and limits of the six axes."""
    params = new(BENCH_PARAMS)
    params.dt_s = step_s
    params.lever_arm = rig.bench.lever_arm_m
    params.order = ["xyz".index(letter) for letter in rig.bench.gimbal_order]
    rails = (rig.rails.x, rig.rails.y, rig.rails.z)
    gimbals = (rig.turntable.roll, rig.turntable.pitch, rig.turntable.yaw)
    params.low = [*(a.travel_m[0] for a in rails), *(math.radians(a.travel_deg[0]) for a in gimbals)]
    params.high = [*(a.travel_m[1] for a in rails), *(math.radians(a.travel_deg[1]) for a in gimbals)]
    params.rate_max = [*(a.rate_max_mps for a in rails), *(math.radians(a.rate_max_degps) for a in gimbals)]
    params.acceleration_max = [
        *(a.acceleration_max_mps2 for a in rails),
        *(math.radians(a.acceleration_max_degps2) for a in gimbals),
    ]
    return params
