"""Ephemeris of the target's Hill frame H by time: as the GNC propagates it before a run, and as the truth has it."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from hil.config.scenario import Scenario
from hil.config.tables.truth import Orbit
from hil.core.messages import Array, new
from hil.dynamics.central_gravity import field_table
from hil.dynamics.ephemeris import tabulate_frames
from hil.dynamics.truth import DSS_PARAMS
from hil.models.ephemeris import EPHEMERIS, FRAME_COLUMNS, ROWS_MAX
from hil.params import dynamics

_ROW_RAD: Final = 0.08  # rotation of H between two rows, at periapsis
_STEP_RAD: Final = 0.01  # in a step of the integration


def row_interval_s(known: Orbit) -> float:
    """Return the time between two rows of an ephemeris of ``known``, s."""
    e = known.eccentricity
    return _ROW_RAD * math.sqrt(1.0 - e * e) * (1.0 - e) / ((1.0 + e) * dynamics.mean_motion(known))


def longest_run_s(known: Orbit) -> float:
    """Return the longest run that an ephemeris of the GNC covers, s."""
    return (ROWS_MAX - 1) * row_interval_s(known)


def known_ephemeris(scenario: Scenario) -> np.record:
    """Return EPHEMERIS of the GNC; about a point mass it has no rows. Raises GravityFileError."""
    params, degree = new(EPHEMERIS), scenario.gnc.ephemeris.gravity_degree
    if degree >= 2 and scenario.truth_orbits:
        known = dynamics.known_orbit(scenario)
        params.n, params.interval_s = ROWS_MAX, row_interval_s(known)
        params.row = _known_rows(scenario.orbit, known, degree, scenario.truth.gravity_file)
    return params


@lru_cache(maxsize=4)
def _known_rows(orbit: Orbit, known: Orbit, degree: int, gravity_file: str | None) -> Array:
    """Return the rows of the GNC's ephemeris. known: ``orbit`` with the GNC's errors."""
    params, field = new(DSS_PARAMS), dynamics.field_of(orbit, gravity_file).up_to(degree)
    dynamics.set_gravity(params.gravity, orbit, field)
    return _rows(params, field_table(field.c, field.s), known, row_interval_s(known), ROWS_MAX)


def true_frames(scenario: Scenario, interval_s: float, n: int) -> Array:
    """Return ``n`` rows of the truth, with drag and third bodies, every ``interval_s``, (n, FRAME_COLUMNS)."""
    return _rows(dynamics.dss(scenario), dynamics.field(scenario), scenario.orbit, interval_s, n)


def _rows(params: np.record, field: Array, orbit: Orbit, interval_s: float, n: int) -> Array:
    rows = np.empty((n, FRAME_COLUMNS))
    state = np.concatenate(dynamics.state_at_start(float(params.gravity.gm), orbit))
    tabulate_frames(params.gravity, params.forces, field, state, interval_s, round(_ROW_RAD / _STEP_RAD), rows)
    return rows
