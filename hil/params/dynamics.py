"""Parameters of the truth and of the virtual IMU, and the truth at the start, from user units to SI."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hil.config.load import load_body
from hil.config.scenario import Scenario
from hil.config.tables.body import CentralBody
from hil.config.tables.truth import BendingMode, Orbit, SolarArray
from hil.core.messages import TRUTH, Array, new
from hil.dynamics import gravity_file, orbit
from hil.dynamics.central_gravity import GRAVITY_PARAMS, acceleration, field_table
from hil.dynamics.gravity_file import GravityField
from hil.dynamics.imu import IMU_PARAMS
from hil.dynamics.sunlight import SOLAR_PRESSURE_PA, visible_sun
from hil.dynamics.thrusters import DRAWS_PER_THRUSTER, STANDARD_GRAVITY_MPS2, as_built
from hil.dynamics.truth import DSS_PARAMS, HILL, NONLINEAR, hold_in_plane
from hil.errors import BadInput, Problem
from hil.maths import elementary, euler, linear, quat
from hil.maths.elementary import square
from hil.maths.random_streams import noise_source
from hil.params.faults import fault_rows, imu_errors, plume, thruster_errors
from hil.params.target import start_attitude, target_attitude

ASTRONOMICAL_UNIT_M = 149_597_870_700.0  # IAU 2012, resolution B2
SUN_RADIUS_M = 695_700e3  # IAU 2015, resolution B3


def central_body(target: Orbit) -> CentralBody:
    """Return the central body of an orbit. Raises BadInput if there is none of its name, or its file cannot be used."""
    try:
        return load_body(target.body).value
    except BadInput as error:
        named = [Problem(each.source, each.key or "orbit.body", each.message) for each in error.problems]
        raise BadInput(named) from error


def body_file(target: Orbit) -> str:
    """Return the path of the file of the central body."""
    return load_body(target.body).source


def semi_major_axis_m(target: Orbit) -> float:
    """Return the semi-major axis of ``target``, m."""
    return central_body(target).radius_m + target.altitude_m


AT_REST_RADPS = 1e-6  # of axes that do not rotate, or whose rotation the filters add themselves: no gravity gradient


def orbit_rate(scenario: Scenario) -> float:
    """Return the mean orbital rate about a point mass, rad/s; 0 without a field."""
    return 0.0 if scenario.truth.relative_motion == "free" else mean_motion(scenario.orbit)


def expected_rate(scenario: Scenario) -> float:
    """Return the mean orbital rate, rad/s, as the GNC has it: by its ephemeris, or next to none without a field."""
    return AT_REST_RADPS if scenario.truth.relative_motion == "free" else mean_motion(scenario.gnc_orbit)


def known_orbit(scenario: Scenario) -> Orbit:
    """Return the target's orbit with all errors of the GNC's ephemeris."""
    orbit = scenario.gnc_orbit
    ahead = scenario.gnc.ephemeris.along_track_error_m / semi_major_axis_m(orbit)
    return orbit.model_copy(update={"true_anomaly_deg": orbit.true_anomaly_deg + math.degrees(ahead)})


def mean_motion(target: Orbit) -> float:
    """Return the mean orbital rate of ``target`` about a point mass, rad/s."""
    a_m = semi_major_axis_m(target)
    return math.sqrt(central_body(target).gm_m3ps2 / (a_m * a_m * a_m))


def gravity(scenario: Scenario) -> GravityField:
    """Return the gravity field of the scenario. Raises GravityFileError."""
    return whole_field(scenario).up_to(scenario.truth.gravity_degree)


def whole_field(scenario: Scenario) -> GravityField:
    """Return the field to its highest degree: of the scenario's file, or of the body. Raises GravityFileError."""
    return field_of(scenario.orbit, scenario.truth.gravity_file)


def field_of(target: Orbit, file: str | None) -> GravityField:
    """Return the field of ``file``, or that of the orbit's body, to its highest degree. Raises GravityFileError."""
    body = central_body(target)
    given = file or body.gravity_file
    if given is None:
        return gravity_file.of_zonal(body.gm_m3ps2, body.radius_m, body.zonal)
    return gravity_file.read(Path(given)).of_body(body.gm_m3ps2, body.radius_m, body.name)


def field(scenario: Scenario) -> Array:
    """Return the harmonics in the layout of the truth's kernels, (N + 1, N + 1, 6)."""
    model = gravity(scenario)
    table: Array = field_table(model.c, model.s)
    return table


def dss(scenario: Scenario, thruster_draws: Array | None = None, seed: int = 0) -> np.record:
    """Return DSS_PARAMS.

    thruster_draws: standard normals, (n, 3), for the errors of the thrusters; None for nominal thrusters. seed: of the
    run, for the scatter of their firings.
    """
    params = new(DSS_PARAMS)
    params.dt_s = scenario.sample_s
    params.relative_motion = NONLINEAR if scenario.truth.relative_motion == "nonlinear" else HILL
    params.held = scenario.chaser.held
    params.orbit_rate = orbit_rate(scenario)
    params.inertia = np.array(scenario.chaser.inertia_kg_m2)
    params.inertia_inverse = linear.inverse(params.inertia)
    params.mass_centre = scenario.truth.centre_of_mass_offset_m
    params.mass_loss = scenario.truth.mass_loss
    params.gravity_gradient = scenario.truth.gravity_gradient
    params.solar_pressure, params.eclipse = scenario.truth.solar_pressure, scenario.truth.eclipse
    params.flexible_array = scenario.truth.flexible_array
    params.thruster_errors = thruster_errors(scenario, seed)
    params.thruster_faults, params.target_faults = fault_rows(scenario, "thruster"), fault_rows(scenario, "target")
    params.target_attitude = target_attitude(scenario)
    params.plume = plume(scenario)
    _set_thrusters(params, scenario, thruster_draws)
    set_gravity(params.gravity, scenario.orbit, gravity(scenario))
    _set_sun(params, scenario)
    _set_orbit_forces(params.forces, scenario)
    if scenario.chaser.solar_array is not None:
        _set_array(params, scenario, scenario.chaser.solar_array)
    gyration = np.array(scenario.chaser.propellant_gyration_m)
    params.mass.full_kg, params.mass.gyration_squared = scenario.chaser.mass_kg, square(gyration)
    params.mass.varies = gyration.any() or (params.flexible_array and params.modes.moves)
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


def set_gravity(params: np.record, target: Orbit, model: GravityField) -> None:
    """Write GRAVITY_PARAMS of ``model`` about the body of an orbit."""
    params.gm, params.radius, params.degree = model.gm, model.radius, model.degree
    params.rotation = math.radians(target.body_rotation_deg)
    params.rate = central_body(target).spin_radps


def sun_direction(scenario: Scenario) -> Array:
    """Return the inertial unit vector to the Sun, (3,)."""
    sun: Array = np.array(scenario.truth.sun_direction)
    return sun / linear.length(sun)


def _set_sun(params: np.record, scenario: Scenario) -> None:
    body = central_body(scenario.orbit)
    params.sun_I = sun_direction(scenario)
    params.sun_angle = elementary.asin(SUN_RADIUS_M / (body.sun_distance_au * ASTRONOMICAL_UNIT_M))
    params.shadow_radius = body.radius_m


def _set_orbit_forces(params: np.record, scenario: Scenario) -> None:
    """Write ORBIT_FORCES: drag and third bodies as far as they are switched on."""
    body, truth = central_body(scenario.orbit), scenario.truth
    params.radius, params.spin = body.radius_m, body.spin_radps
    if truth.drag and body.atmosphere is not None:
        air = body.atmosphere
        n = params.layers = len(air.altitude_km)
        params.altitude[:n] = 1e3 * np.array(air.altitude_km)
        params.density[:n] = truth.density_scale * np.array(air.density_kgpm3)
        params.scale_height[:n] = 1e3 * np.array(air.scale_height_km)
        params.target_drag = 1.0 / truth.target_ballistic_kgpm2
        params.chaser_drag = 1.0 / truth.chaser_ballistic_kgpm2
    if truth.third_bodies:
        params.bodies = len(body.third_bodies)
        for k, other in enumerate(body.third_bodies):
            direction = np.array(truth.sun_direction if other.direction is None else other.direction)
            params.body_gm[k] = other.gm_km3ps2 * 1e9
            params.body_position[k] = other.distance_km * 1e3 * direction / linear.length(direction)
            params.body_pole[k] = np.array(other.pole) / linear.length(other.pole)
            params.body_rate[k] = 2.0 * math.pi / (other.period_d * 86400.0)
    params.acts = params.layers > 0 or params.bodies > 0


def _set_array(params: np.record, scenario: Scenario, array: SolarArray) -> None:
    params.plate.area = array.area_m2
    params.plate.pressure = SOLAR_PRESSURE_PA / square(central_body(scenario.orbit).sun_distance_au)
    params.plate.normal = np.array(array.normal) / linear.length(array.normal)
    params.plate.arm = np.array(array.centre_m) - params.mass_centre
    params.plate.specular = array.specular
    params.plate.diffuse = array.diffuse
    _set_modes(params.modes, bending_modes(array))
    rigid = np.array(params.inertia)
    for coupling in params.modes.coupling[: params.modes.n]:
        rigid -= np.outer(coupling, coupling)
    params.modes.inertia_inverse = linear.inverse(rigid)


def bending_modes(array: SolarArray) -> tuple[BendingMode, ...]:
    """Return all modes of ``array``, first the mode of its own keys."""
    first = BendingMode(
        frequency_hz=array.mode_frequency_hz,
        damping=array.mode_damping,
        coupling=array.mode_coupling,
        translation_coupling=array.mode_translation_coupling,
    )
    return first, *array.further_modes.values()


def _set_modes(params: np.record, modes: tuple[BendingMode, ...]) -> None:
    """Write MODES but for the inertia."""
    params.n = len(modes)
    for k, mode in enumerate(modes):
        params.frequency[k], params.damping[k] = 2.0 * math.pi * mode.frequency_hz, mode.damping
        params.coupling[k], params.translation[k] = mode.coupling, mode.translation_coupling
    params.moves = params.translation.any()


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
    if scenario.chaser.planar:
        hold_in_plane(scenario.chaser.held, truth)  # also a dispersed start
    truth.sunlight = _sunlight(scenario, truth.r_T_I)
    truth.mass_kg = scenario.chaser.mass_kg
    return truth


def _sunlight(scenario: Scenario, r_T_I: Array) -> float:
    params = new(DSS_PARAMS)
    _set_sun(params, scenario)
    if not scenario.truth.eclipse:
        return 1.0
    return float(visible_sun(params.shadow_radius, params.sun_angle, r_T_I, params.sun_I))


def state_at_start(gm: float, target: Orbit) -> tuple[Array, Array]:
    """Return position, m, and velocity, m/s, each (3,), inertial, of an orbit at the start of a run; gm: m^3/s^2."""
    return orbit.state_of_elements(
        gm,
        semi_major_axis_m(target),
        target.eccentricity,
        math.radians(target.inclination_deg),
        math.radians(target.raan_deg),
        math.radians(target.argument_of_periapsis_deg),
        math.radians(target.true_anomaly_deg),
    )


def _set_target(truth: np.record, scenario: Scenario) -> None:
    """Write the target's state, and the Hill frame or the axes of a target that rotates against it."""
    params = new(GRAVITY_PARAMS)
    set_gravity(params, scenario.orbit, gravity(scenario))
    r, v = state_at_start(params.gm, scenario.orbit)
    a, rate = np.empty((3, 3)), np.empty(3)
    orbit.hill_frame(r, v, a)
    if scenario.truth.relative_motion != "nonlinear":
        rate[:] = 0.0, -orbit_rate(scenario), 0.0
    else:
        pull = np.empty(3)
        acceleration(params, field(scenario), 0.0, r, pull)
        orbit.hill_rate(r, v, pull, a, rate)
    truth.r_T_I, truth.v_T_I = r, v
    truth.q_HI, truth.w_HI_H = start_attitude(scenario, quat.from_matrix(a), rate)


def dss_as_built(scenario: Scenario, seed: int) -> np.record:
    """Return DSS_PARAMS with the thruster errors drawn from the run's seed."""
    draws = noise_source(seed, "thrusters").standard_normal(thruster_draws_shape(scenario))
    return dss(scenario, draws, seed)
