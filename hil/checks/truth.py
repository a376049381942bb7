"""Checks of a scenario's truth across its tables and files."""

from __future__ import annotations

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.config.tables.body import CentralBody
from hil.core.messages import Array
from hil.dynamics.gravity_file import GravityFileError
from hil.dynamics.thrusters import STANDARD_GRAVITY_MPS2
from hil.errors import BadInput, Problem
from hil.maths import linear
from hil.maths.elementary import square
from hil.params import dynamics as dynamics_params

_LOWEST_FRACTION = 0.005  # altitude over the body's radius: lower orbits meet mountains or an atmosphere


def check_truth(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return the problems of orbit, central body, gravity field and solar array."""
    try:
        body = dynamics_params.central_body(scenario.value.orbit)
    except BadInput as error:
        return list(error.problems)
    return [
        *_check_orbit(scenario, body),
        *_check_gravity(scenario, body),
        *_check_perturbations(scenario, body),
        *_check_solar_array(scenario),
        *_check_propellant(scenario),
        *_check_plane(scenario),
    ]


def _check_plane(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for each place and rotation of a planar chaser's plan that is out of its plane of H."""
    value, guidance = scenario.value, scenario.value.gnc.guidance
    if not value.chaser.planar:
        return []
    points = {"initial.position_m": value.initial.position_m, "initial.velocity_mps": value.initial.velocity_mps}
    points |= {"gnc.guidance.ready_point_m": guidance.ready_point_m, "gnc.corridor.axis": value.gnc.corridor.axis}
    turns = {"initial.attitude_deg": value.initial.attitude_deg, "initial.rate_degps": value.initial.rate_degps}
    for name in guidance.sequence:
        phase, key = guidance.phases[name], f"gnc.guidance.phases.{name}"
        points |= {} if phase.point_m is None else {f"{key}.point_m": phase.point_m}
        turns |= {} if phase.attitude_deg is None else {f"{key}.attitude_deg": phase.attitude_deg}
    for name in ("rate_degps", "attitude_deg", "principal_axes_deg"):  # of a tumble, flat if it is about y alone
        turns[f"target.{name}"] = getattr(value.target, name)
    k = value.chaser.held - 1
    i, j = (axis for axis in range(3) if axis != k)
    wrong = {key: f"along {'xyz'[k]}" for key, place in points.items() if place[k] != 0.0}
    wrong |= {
        key: f"about {'xyz'[i]} and {'xyz'[j]}" for key, turn in turns.items() if turn[i] != 0.0 or turn[j] != 0.0
    }
    text = f"leaves the {'xyz'[i]}-{'xyz'[j]} plane of H, in which chaser.planar holds the chaser, allowed 0"
    return [scenario.problem(key, f"{text} {which}; or another chaser.plane") for key, which in wrong.items()]


def _check_orbit(scenario: Loaded[Scenario], body: CentralBody) -> list[Problem]:
    orbit = scenario.value.orbit
    problems = []
    axis_m = dynamics_params.semi_major_axis_m(orbit)
    lowest_m = axis_m * (1.0 - orbit.eccentricity) - body.radius_m
    if lowest_m <= 0.0:
        allowed = 1.0 - body.radius_m / axis_m
        text = (
            f"{orbit.eccentricity:g}: the periapsis lies {-lowest_m / 1e3:.1f} km inside {body.name}, "
            f"at altitude_m {orbit.altitude_m:g} allowed below {allowed:.4f}"
        )
        problems.append(scenario.problem("orbit.eccentricity", text))
    elif lowest_m < (least_m := _LOWEST_FRACTION * body.radius_m):
        text = f"{orbit.altitude_m:g}: periapsis {lowest_m:.0f} m above {body.name}, allowed from {least_m:.0f} on"
        problems.append(scenario.problem("orbit.altitude_m", text))
    if scenario.value.truth.relative_motion == "hill" and orbit.eccentricity != 0.0:
        text = f'"hill": requires a circular orbit, orbit.eccentricity is {orbit.eccentricity:g}; allowed "nonlinear"'
        problems.append(scenario.problem("truth.relative_motion", text))
    return [*problems, *_check_ephemeris(scenario, body)]


def _check_ephemeris(scenario: Loaded[Scenario], body: CentralBody) -> list[Problem]:
    orbit, errors = scenario.value.gnc_orbit, scenario.value.gnc.ephemeris
    problems = []
    if not 0.0 <= orbit.eccentricity <= 0.7:
        text = f"{errors.eccentricity_error:g}: the GNC would have {orbit.eccentricity:g}, allowed 0 to 0.7"
        problems.append(scenario.problem("gnc.ephemeris.eccentricity_error", text))
    if errors.gravity_degree and not scenario.value.truth_orbits:
        text = (
            f"{errors.gravity_degree}: harmonics move a target with "
            'truth.relative_motion = "nonlinear" and target.motion = "aligned", otherwise allowed 0'
        )
        problems.append(scenario.problem("gnc.ephemeris.gravity_degree", text))
    if orbit.altitude_m <= 0.0:
        text = f"{errors.semi_major_axis_error_m:g}: the GNC would have an orbit inside {body.name}"
        problems.append(scenario.problem("gnc.ephemeris.semi_major_axis_error_m", text))
    return problems


def _check_gravity(scenario: Loaded[Scenario], body: CentralBody) -> list[Problem]:
    truth = scenario.value.truth
    try:
        field = dynamics_params.whole_field(scenario.value)
    except GravityFileError as error:
        if truth.gravity_file is None:
            where = dynamics_params.body_file(scenario.value.orbit)
            return [Problem(where, "gravity_file", f"{body.gravity_file}: {error}")]
        return [scenario.problem("truth.gravity_file", f"{truth.gravity_file}: {error}")]
    degrees = {
        "truth.gravity_degree": truth.gravity_degree,
        "gnc.ephemeris.gravity_degree": scenario.value.gnc.ephemeris.gravity_degree,
    }
    text = f"too high for {truth.gravity_file or f'the field of {body.name}'}, allowed 0 to {field.degree}"
    return [scenario.problem(key, f"{degree}: {text}") for key, degree in degrees.items() if degree > field.degree]


def _check_perturbations(scenario: Loaded[Scenario], body: CentralBody) -> list[Problem]:
    truth = scenario.value.truth
    is_free = truth.relative_motion == "free"
    has: dict[str, tuple[str, object]] = {"gravity_gradient": ("", True)} if is_free else {}
    has |= {"drag": ("atmosphere", body.atmosphere), "third_bodies": ("third_bodies", body.third_bodies)}
    problems = []
    for name, (table, given) in has.items():
        if not getattr(truth, name):
            continue
        key = f"truth.{name}"
        if not given:
            problems.append(scenario.problem(key, f"true: the file of {body.name} has no {table}"))
        elif truth.relative_motion != "nonlinear":
            text = f'true: does not act on truth.relative_motion = "{truth.relative_motion}", allowed "nonlinear"'
            problems.append(scenario.problem(key, text))
    return problems


def _check_solar_array(scenario: Loaded[Scenario]) -> list[Problem]:
    chaser, truth = scenario.value.chaser, scenario.value.truth
    if chaser.solar_array is None:
        return [
            scenario.problem(f"truth.{name}", "true: needs the table chaser.solar_array")
            for name in ("solar_pressure", "flexible_array")
            if getattr(truth, name)
        ]
    modes = dynamics_params.bending_modes(chaser.solar_array)
    turning, moving = (
        np.array([getattr(mode, name) for mode in modes]) for name in ("coupling", "translation_coupling")
    )
    smallest = linear.eigenvalues(chaser.inertia_kg_m2 - linear.product(turning.T, turning))[0]
    if smallest <= 0.0:
        text = (
            f"{_shown(turning)}: the array would have more inertia than the vehicle: inertia_kg_m2 minus the square "
            f"of the coupling must be positive definite, its smallest moment is {smallest:.4g} kg m^2"
        )
        return [scenario.problem("chaser.solar_array.mode_coupling", text)]
    if not moving.any():
        return []
    both = np.hstack([moving, turning])
    hub = np.diag([chaser.mass_kg] * 3 + [0.0] * 3)
    hub[3:, 3:] = chaser.inertia_kg_m2
    smallest = linear.eigenvalues(hub - linear.product(both.T, both))[0]
    if smallest > 0.0:
        return []
    text = (
        f"{_shown(moving)}: the array would be heavier than the vehicle: mass and inertia minus the squares of the "
        f"couplings must be positive definite, smallest eigenvalue {smallest:.4g}"
    )
    return [scenario.problem("chaser.solar_array.mode_translation_coupling", text)]


def _shown(couplings: Array) -> list[float] | list[list[float]]:
    """Return the couplings of all modes (n, 3); a single mode's as the file has it."""
    table: list[list[float]] = couplings.tolist()
    return table if len(table) > 1 else table[0]


def _check_propellant(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem if the inertia is impossible for a body after all thrusters have fired for the whole run."""
    chaser = scenario.value.chaser
    gyration = np.array(chaser.propellant_gyration_m)
    flow = len(chaser.thrusters.position_m) * chaser.thrusters.force_n / chaser.thrusters.specific_impulse_s
    most_kg = min(chaser.mass_kg, scenario.value.duration_s * flow / STANDARD_GRAVITY_MPS2)
    smallest = linear.eigenvalues(chaser.inertia_kg_m2 - most_kg * np.diag(square(gyration)))[0]
    if smallest > 0.0:
        return []
    text = (
        f"{gyration.tolist()}: without the {most_kg:.4g} kg that all thrusters use in {scenario.value.duration_s:g} s "
        f"inertia_kg_m2 would have a moment of {smallest:.4g} kg m^2, every principal moment must be above 0"
    )
    return [scenario.problem("chaser.propellant_gyration_m", text)]
