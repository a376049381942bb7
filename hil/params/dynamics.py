"""Parameters of the truth and of the virtual IMU, and the truth at the start, from user units to SI."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hil.config.scenario import Scenario
from hil.config.truth import Orbit, SolarArray
from hil.core.messages import TRUTH, Array, new
from hil.dynamics import gravity_file, orbit
from hil.dynamics.gravity_file import MOON_GM_M3PS2, MOON_RADIUS_M, GravityField
from hil.dynamics.imu import IMU_PARAMS
from hil.dynamics.moon_gravity import acceleration, field_table
from hil.dynamics.thrusters import DRAWS_PER_THRUSTER, STANDARD_GRAVITY_MPS2, as_built
from hil.dynamics.truth import DSS_PARAMS, HILL, NONLINEAR
from hil.maths import euler, quat
from hil.params.errors import imu_errors, thruster_errors
from hil.params.faults import fault_rows

MOON_SIDEREAL_RATE_RADPS = 2.0 * math.pi / (27.321661 * 86400.0)  # Seidelmann, Explanatory Supplement (1992)


def semi_major_axis_m(scenario: Scenario) -> float:
    """Return the semi-major axis of the target's orbit, m."""
    return MOON_RADIUS_M + scenario.orbit.altitude_m


def orbit_rate(scenario: Scenario) -> float:
    """Return the mean orbital rate about a point-mass Moon, rad/s."""
    return mean_motion(scenario.orbit)


def mean_motion(target: Orbit) -> float:
    """Return the mean orbital rate of ``target`` about a point-mass Moon, rad/s."""
    return math.sqrt(MOON_GM_M3PS2 / (MOON_RADIUS_M + target.altitude_m) ** 3)


def gravity(scenario: Scenario) -> GravityField:
    """Return the gravity field of the scenario. Raises GravityFileError."""
    return gravity_file.read(gravity_path(scenario)).up_to(scenario.truth.gravity_degree)


def gravity_path(scenario: Scenario) -> Path:
    """Return the file of the field: the user's, relative to the working directory, or the shipped one."""
    given = scenario.truth.gravity_file
    return gravity_file.SHIPPED if given is None else Path(given)


def field(scenario: Scenario) -> Array:
    """Return the harmonics in the layout of the truth's kernels, (N + 1, N + 1, 6)."""
    found = gravity(scenario)
    table: Array = field_table(found.c, found.s)
    return table


def dss(scenario: Scenario, thruster_draws: Array | None = None, seed: int = 0) -> np.record:
    """Return DSS_PARAMS.

    thruster_draws: standard normals, (n, 3), for the errors of the thrusters; None for nominal thrusters. seed: of the
    run, for the scatter of their firings.
    """
    params = new(DSS_PARAMS)
    params.dt_s = scenario.sample_s
    params.relative_motion = HILL if scenario.truth.relative_motion == "hill" else NONLINEAR
    params.orbit_rate = orbit_rate(scenario)
    params.inertia = np.array(scenario.chaser.inertia_kg_m2)
    params.inertia_inverse = np.linalg.inv(params.inertia)
    params.mass_centre = scenario.truth.centre_of_mass_offset_m
    params.mass_loss = scenario.truth.mass_loss
    params.gravity_gradient = scenario.truth.gravity_gradient
    params.solar_pressure = scenario.truth.solar_pressure
    params.flexible_array = scenario.truth.flexible_array
    params.thruster_errors = thruster_errors(scenario, seed)
    params.thruster_faults, params.target_faults = fault_rows(scenario, "thruster"), fault_rows(scenario, "target")
    _set_thrusters(params, scenario, thruster_draws)
    _set_gravity(params, scenario)
    if scenario.chaser.solar_array is not None:
        _set_array(params, scenario, scenario.chaser.solar_array)
    return params


def imu(scenario: Scenario, seed: int = 0) -> np.record:
    """Return IMU_PARAMS. seed: of the run, for errors and the noise of faults."""
    params = new(IMU_PARAMS)
    params.dt_s = scenario.sample_s
    params.sigma_gyro = math.radians(scenario.imu.gyro_noise_degps)
    params.sigma_drift = math.radians(scenario.imu.gyro_drift_noise_degps2)
    params.sigma_accelerometer = scenario.imu.accelerometer_noise_mps2
    params.sigma_bias = scenario.imu.accelerometer_bias_noise_mps3
    params.errors, params.faults = imu_errors(scenario, seed), fault_rows(scenario, "imu", seed)
    return params


def thruster_draws_shape(scenario: Scenario) -> tuple[int, int]:
    """Return the shape of ``thruster_draws`` of ``dss``."""
    return len(scenario.chaser.thrusters.position_m), DRAWS_PER_THRUSTER


def _set_thrusters(params: np.record, scenario: Scenario, draws: Array | None) -> None:
    thrusters = scenario.chaser.thrusters
    n = len(thrusters.position_m)
    direction, force = np.array(thrusters.direction), np.full(n, thrusters.force_n)
    if draws is not None:
        tilt = math.radians(scenario.truth.misalignment_sigma_deg)
        direction, force = as_built(direction, force, tilt, scenario.truth.force_scatter_sigma, draws)
    params.n_thrusters = n
    params.thruster_position[:n] = np.array(thrusters.position_m) - params.mass_centre
    params.thruster_direction[:n] = direction
    params.thruster_force[:n] = force
    params.minimum_on_s, params.isolation_closing_s = thrusters.minimum_on_s, thrusters.isolation_closing_s
    params.exhaust_speed = thrusters.specific_impulse_s * STANDARD_GRAVITY_MPS2


def _set_gravity(params: np.record, scenario: Scenario) -> None:
    found = gravity(scenario)
    params.gravity.gm = found.gm
    params.gravity.radius = found.radius
    params.gravity.degree = scenario.truth.gravity_degree
    params.gravity.rotation = math.radians(scenario.orbit.moon_rotation_deg)
    params.gravity.rate = MOON_SIDEREAL_RATE_RADPS


def _set_array(params: np.record, scenario: Scenario, array: SolarArray) -> None:
    sun = np.array(scenario.truth.sun_direction)
    params.sun_I = sun / np.linalg.norm(sun)
    params.plate.area = array.area_m2
    params.plate.normal = np.array(array.normal) / np.linalg.norm(array.normal)
    params.plate.arm = np.array(array.centre_m) - params.mass_centre
    params.plate.specular = array.specular
    params.plate.diffuse = array.diffuse
    coupling = np.array(array.mode_coupling)
    params.mode.frequency = 2.0 * math.pi * array.mode_frequency_hz
    params.mode.damping = array.mode_damping
    params.mode.coupling = coupling
    params.mode.inertia_inverse = np.linalg.inv(params.inertia - np.outer(coupling, coupling))


def initial_truth(scenario: Scenario) -> np.record:
    """Return TRUTH at the start: the relative state as given against H, the array unbent."""
    truth = new(TRUTH)
    initial = scenario.initial
    truth.r_CT_H = initial.position_m
    truth.v_CT_H = initial.velocity_mps
    truth.q_CH = euler.to_quaternion(np.radians(initial.attitude_deg), euler.YAW_PITCH_ROLL)
    _set_target(truth, scenario)
    # w_CI = w_CH + A(q_CH) w_HI
    truth.w_CI_C = np.radians(initial.rate_degps) + quat.transform(truth.q_CH, truth.w_HI_H)
    truth.mean_rate_C = truth.w_CI_C
    truth.mass_kg = scenario.chaser.mass_kg
    return truth


def _set_target(truth: np.record, scenario: Scenario) -> None:
    """Write the target's state and its Hill frame."""
    params = new(DSS_PARAMS)
    _set_gravity(params, scenario)
    elements = scenario.orbit
    r, v = orbit.state_of_elements(
        params.gravity.gm,
        semi_major_axis_m(scenario),
        elements.eccentricity,
        math.radians(elements.inclination_deg),
        math.radians(elements.raan_deg),
        math.radians(elements.argument_of_periapsis_deg),
        math.radians(elements.true_anomaly_deg),
    )
    a, rate = np.empty((3, 3)), np.empty(3)
    orbit.hill_frame(r, v, a)
    if scenario.truth.relative_motion == "hill":
        rate[:] = 0.0, -orbit_rate(scenario), 0.0
    else:
        pull = np.empty(3)
        acceleration(params.gravity, field(scenario), 0.0, r, pull)
        orbit.hill_rate(r, v, pull, a, rate)
    truth.r_T_I, truth.v_T_I, truth.q_HI, truth.w_HI_H = r, v, quat.from_matrix(a), rate
