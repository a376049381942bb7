"""Energy: the propellant that was spent against the least that the flown reference and the slews cost.

The least is impulsive: the reference's changes of velocity at once, summed over its line as flown
(a line from rest to rest at speed v costs 2 v, whatever its ramps), and for each axis the slew of the
start's attitude error at a steady rate over ``slew_s``, ``J theta / slew_s`` of torque impulse to
start and the same to stop. Forces and torques are counted with the cleanest thruster set of their
axis. Orbital motion, which a straight line has to be held against, is not in the least.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.dynamics.thrusters import STANDARD_GRAVITY_MPS2
from hil.gnc.allocation import AXES_OF_A_BODY
from hil.params import gnc as gnc_params


def impulsive_delta_v(v_CT_H: Array) -> float:
    """Return the sum of the reference's changes of velocity, m/s, for its velocities ``v_CT_H`` (n, 3), from rest."""
    changes = np.diff(np.vstack([np.zeros((1, 3)), v_CT_H]), axis=0)
    return float(np.linalg.norm(changes, axis=1).sum())


def slew_impulse(scenario: Scenario) -> float:
    """Return the least thrust impulse of the slews, N s: thrust of the set over its torque, times torque impulse."""
    sets, strength = gnc_params.allocation(scenario.chaser)
    inertia = np.diag(np.array(scenario.chaser.inertia_kg_m2))
    angles = np.abs(np.radians(scenario.initial.attitude_deg))
    torque_impulse = 2.0 * inertia * angles / scenario.gnc.guidance.slew_s
    thrust = scenario.chaser.thrusters.force_n * sets[3:AXES_OF_A_BODY].sum(axis=2).min(axis=1)
    return float((torque_impulse * thrust / strength[3:AXES_OF_A_BODY]).sum())


def judge_energy(v_CT_H: Array, scenario: Scenario, propellant_kg: float, firings: int) -> dict[str, Any]:
    """Return ``passed`` and the numbers; ``v_CT_H`` (n, 3): velocities of the reference, m/s."""
    found = energy_part(impulsive_delta_v(v_CT_H), scenario, propellant_kg, firings)
    return found | {"passed": len(v_CT_H) > 0 and found["passed"]}


def energy_part(line: float, scenario: Scenario, propellant_kg: float, firings: int) -> dict[str, Any]:
    """Return ``passed`` and the numbers; line: the reference's changes of velocity summed, m/s.

    delta_v_mps is what the rocket equation makes of the propellant, as if all thrust had pushed one way.
    """
    exhaust_speed = scenario.chaser.thrusters.specific_impulse_s * STANDARD_GRAVITY_MPS2
    mass_kg, factor = scenario.chaser.mass_kg, scenario.requirements.propellant_factor
    slews = slew_impulse(scenario) / mass_kg
    least_kg = mass_kg * -math.expm1(-(line + slews) / exhaust_speed)
    return {
        "passed": propellant_kg <= factor * least_kg,
        "propellant_kg": propellant_kg,
        "delta_v_mps": -exhaust_speed * math.log1p(-propellant_kg / mass_kg),
        "least_propellant_kg": least_kg,
        "least_line_mps": line,
        "least_slews_mps": slews,
        "factor": factor,
        "firings": firings,
    }
