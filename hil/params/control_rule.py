"""Rule of the built-in control: periods, leads and dead bands from valve, propellant, and requirement.

docs/explanation/control.md derives it. Lead and dead band also follow from the noise of navigation, in the cycle
(``hil.gnc.control``); what does not change in a run is computed here.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.gnc.control import COAST_OF_TOLERANCE
from hil.gnc.thruster_monitor import DELAYS

_LONGEST_DELAY: Final = DELAYS - 2
"""Cycles: the longest delay of a valve that is found, and taken into account, in flight."""
_LEAST_LEAD: Final = 6.0
"""Periods in the shortest lead."""
_LEAD_MAX_S: Final = 20.0


class ControlRule(NamedTuple):
    """Numbers of the rule; arrays are of six axes: force along x, y, z, torque about x, y, z."""

    pulse_s: float
    """Least time for which a valve opens."""
    acceleration: Array
    """m/s^2, rad/s^2, of a demand."""
    period_s: float
    """Between two decisions: the smallest burn has been felt, also of a valve that is late."""
    lead_bounds_s: Array
    """(6, 2)"""
    coast_scale: Array
    """s^2/m, s^2/rad: 1 / (4 u), u the mean acceleration that a limit cycle may use."""
    coast_max: Array
    """m, rad"""
    rate_max: Array
    """m/s, rad/s, of the requirement."""


def nominal_leads(params: np.record) -> Array:
    """Return the lead of each axis, (6,), s, for CONTROL_PARAMS: as set, else for noise that is unknown, or none."""
    bounds = params.lead_bounds
    by_rule = np.where(params.deadband_sigmas > 0.0, np.sqrt(bounds[:, 0] * bounds[:, 1]), bounds[:, 0])
    leads: Array = np.where(params.lead > 0.0, params.lead, by_rule)
    return leads


def control_rule(scenario: Scenario, strength: Array) -> ControlRule:
    """Return the rule for ``scenario``; strength: (9,), N and N m, of the demands and of full thrust."""
    step_s, chaser, required = scenario.step_s, scenario.chaser, scenario.requirements
    mass_kg, inertia = chaser.mass_kg, np.diag(np.array(chaser.inertia_kg_m2))
    acceleration = np.concatenate([strength[:3] / mass_kg, strength[3:6] / inertia])
    pulse_s = max(chaser.thrusters.minimum_on_s, step_s)
    period_s = step_s * (math.ceil(pulse_s / step_s - 1e-9) + _LONGEST_DELAY)
    # what is allowed beyond the least propellant is shared by the limit cycles of six axes
    share = max(0.0, required.propellant_factor - 1.0) / 6.0
    mean = share * 2.0 * scenario.gnc.guidance.approach_speed_mps / scenario.duration_s  # m/s^2
    of_axis = np.concatenate([np.full(3, mean), mean * acceleration[3:] / acceleration[:3].min()])
    tolerance = np.array(
        [required.axial_tolerance_m, *[required.radial_distance_m] * 2, *[math.radians(required.angle_deg)] * 3]
    )
    return ControlRule(
        pulse_s,
        acceleration,
        period_s,
        np.array([[_LEAST_LEAD * period_s, _LEAD_MAX_S]] * 6),
        1.0 / np.maximum(4.0 * of_axis, 1e-300),
        COAST_OF_TOLERANCE * tolerance,
        np.array(
            [required.axial_rate_mps, *[required.radial_rate_mps] * 2, *[math.radians(required.angular_rate_degps)] * 3]
        ),
    )
