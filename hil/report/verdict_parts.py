"""Parts of the verdict besides control precision: security, energy and field of view.

Security: corridor and closing rate on the truth, the abort, and the drift without any further thrust. Field of view:
every LED of the ring in both images throughout, at the pose that the bench really had.

Energy: the propellant spent against the least that the reference as run and the slews cost. The least is impulsive:
the reference's changes of velocity at once, summed over its path (a line from rest to rest at speed v costs 2 v,
whatever its ramps), what rotating axes of H ask beyond them, and for each axis the slew of the initial attitude error
at a steady rate over ``slew_s``, ``J theta / slew_s`` of torque impulse to start and the same to stop. Forces and
torques are counted with the cleanest thruster set of their axis. The orbital motion that a straight line requires is
not in the least.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil.bench.field_of_view import view_margins
from hil.config.bench_scale import FULL_SCALE, BenchScale
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.truth import Orbit
from hil.core.messages import Array
from hil.dynamics import elliptic_motion, hill
from hil.dynamics.thrusters import STANDARD_GRAVITY_MPS2
from hil.gnc.allocation import AXES_OF_A_BODY
from hil.gnc.approach_monitor import margins
from hil.gnc_backends.approach_events import ABORT_CAUSES
from hil.maths.kepler import mean_anomaly, true_anomaly
from hil.models.rotating_frame import frame_acceleration, tumble_rate
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params
from hil.params import vision as vision_params
from hil.params.dynamics import mean_motion
from hil.params.target import known_tumble

_DRIFT_SAMPLES = 720  # over one orbit


def drift(r_CT_H: Array, v_CT_H: Array, orbit: Orbit, nu: float, t_s: Array) -> Array:
    """Return the uncontrolled positions in H, (n, 3), m, ``t_s`` (n,) after the given state.

    nu: true anomaly of the target in that state, rad. Hill's equations on a circle, else Yamanaka and Ankersen's.
    """
    state, rate, e = np.concatenate([r_CT_H, v_CT_H]), mean_motion(orbit), orbit.eccentricity
    moved = (
        hill.transition(rate, float(t)) if e == 0.0 else elliptic_motion.transition(rate, e, nu, float(t)) for t in t_s
    )
    return np.array([whole[:3] @ state for whole in moved]).reshape(-1, 3)


def drift_over_an_orbit(row: np.void, orbit: Orbit) -> dict[str, Any]:
    """Return the drift of the chaser of ``row`` (CYCLE) over one orbit without thrust."""
    rate, e = mean_motion(orbit), orbit.eccentricity
    period_s = 2.0 * math.pi / rate
    t_s = np.linspace(0.0, period_s, _DRIFT_SAMPLES + 1)
    nu = true_anomaly(e, mean_anomaly(e, math.radians(orbit.true_anomaly_deg)) + rate * float(row["t_s"]))
    path = drift(row["truth"]["r_CT_H"], row["truth"]["v_CT_H"], orbit, nu, t_s)
    distance = np.linalg.norm(path, axis=1)
    nearest = int(np.argmin(distance))
    return {
        "from_s": float(row["t_s"]),
        "orbit_s": period_s,
        "nearest_m": float(distance[nearest]),
        "nearest_after_s": float(t_s[nearest]),
        "farthest_m": float(distance.max()),
        "after_one_orbit_m": [float(value) for value in path[-1]],
    }


def is_secure(corridor_margin_m: float, closing_margin_mps: float) -> bool:
    """Return whether neither margin of the security part is negative."""
    return bool(corridor_margin_m >= 0.0 and closing_margin_mps >= 0.0)


def judge_security(history: np.ndarray, scenario: Scenario, entered: bool = False) -> dict[str, Any]:
    """Return ``passed``, the least margins on the truth up to an abort, and the course of the abort.

    The corridor counts from the first cycle inside it; entered: whether that was before ``history``.
    """
    aborted = np.flatnonzero(history["supervision"]["aborted"])
    approach = history[: aborted[0] + 1] if len(aborted) else history
    if not len(approach):
        return {"passed": False, "abort": None}
    corridor, closing = np.empty(len(approach)), np.empty(len(approach))
    truth, reference = approach["truth"], approach["reference"].copy()
    if len(approach) > 1:
        reference[-1] = reference[-2] if len(aborted) else reference[-1]  # the line before the abort
    margins(
        gnc_params.approach_monitor(scenario),
        np.ascontiguousarray(reference["from_H"]),
        np.ascontiguousarray(reference["to_H"]),
        np.ascontiguousarray(truth["r_CT_H"]),
        np.ascontiguousarray(truth["v_CT_H"]),
        corridor,
        closing,
    )
    first = 0 if entered else int(np.argmax(corridor >= 0.0))
    tightest, fastest = first + int(np.argmin(corridor[first:])), int(np.argmin(closing))
    return {
        "passed": is_secure(corridor[tightest], closing[fastest]),
        "corridor_margin_m": float(corridor[tightest]),
        "corridor_margin_at_s": float(approach["t_s"][tightest]),
        "closing_margin_mps": float(closing[fastest]),
        "closing_margin_at_s": float(approach["t_s"][fastest]),
        "nearest_m": float(np.linalg.norm(history["truth"]["r_CT_H"], axis=1).min()),
        "abort": _abort(history[aborted[0] :], scenario) if len(aborted) else None,
    }


def _abort(after: np.ndarray, scenario: Scenario) -> dict[str, Any]:
    """Return the course of the abort; ``after``: the cycles from its trigger on."""
    distance = np.linalg.norm(after["truth"]["r_CT_H"], axis=1)
    hold = len(scenario.gnc.guidance.sequence) + 2
    held = np.flatnonzero(after["reference"]["phase"] == hold)
    return {
        "cause": ABORT_CAUSES[int(after["supervision"]["aborted"][0])],
        "at_s": float(after["t_s"][0]),
        "range_m": float(distance[0]),
        "nearest_m": float(distance.min()),
        "hold_since_s": float(after["t_s"][held[0]]) if len(held) else None,
        "range_at_end_m": float(distance[-1]),
        "drift_from_trigger": drift_over_an_orbit(after[0], scenario.orbit),
        "drift_from_end": drift_over_an_orbit(after[-1], scenario.orbit),
    }


def later_abort(known: dict[str, Any], after: np.ndarray, scenario: Scenario) -> dict[str, Any]:
    """Return the course of the abort ``known`` with the rows ``after``, which follow those that it was made of."""
    found = _abort(after, scenario)
    return known | {
        "nearest_m": min(known["nearest_m"], found["nearest_m"]),
        "hold_since_s": found["hold_since_s"] if known["hold_since_s"] is None else known["hold_since_s"],
        "range_at_end_m": found["range_at_end_m"],
        "drift_from_end": found["drift_from_end"],
    }


def impulsive_delta_v(v_CT_H: Array) -> float:
    """Return the sum of the reference's changes of velocity, m/s, for its velocities ``v_CT_H`` (n, 3), from rest."""
    changes = np.diff(np.vstack([np.zeros((1, 3)), v_CT_H]), axis=0)
    return float(np.linalg.norm(changes, axis=1).sum())


def frame_delta_v(history: np.ndarray, scenario: Scenario) -> float:
    """Return what the reference needs, m/s, because the axes of a target that tumbles rotate; ``history``: of CYCLE."""
    tumble = known_tumble(scenario, mean_motion(scenario.gnc_orbit))
    if not tumble.rotates:
        return 0.0
    total, w, dw, a = 0.0, np.empty(3), np.empty(3), np.empty(3)
    for t_s, reference in zip(history["t_s"], history["reference"], strict=True):
        tumble_rate(tumble, t_s, w, dw)
        frame_acceleration(w, dw, reference["r_CT_H"], reference["v_CT_H"], a)
        total += scenario.step_s * float(np.linalg.norm(a))
    return total


def slew_impulse(scenario: Scenario) -> float:
    """Return the least thrust impulse of the slews, N s: thrust of the set over its torque, times torque impulse."""
    sets, strength = gnc_params.allocation(scenario.chaser)
    inertia = np.diag(np.array(scenario.chaser.inertia_kg_m2))
    angles = np.abs(np.radians(scenario.initial.attitude_deg))
    torque_impulse = 2.0 * inertia * angles / scenario.gnc.guidance.slew_s
    thrust = scenario.chaser.thrusters.force_n * sets[3:AXES_OF_A_BODY].sum(axis=2).min(axis=1)
    return float((torque_impulse * thrust / strength[3:AXES_OF_A_BODY]).sum())


def judge_energy(
    v_CT_H: Array, scenario: Scenario, propellant_kg: float, firings: int, frame_mps: float = 0.0
) -> dict[str, Any]:
    """Return ``passed`` and the numbers; ``v_CT_H`` (n, 3): velocities of the reference, m/s.

    frame_mps: what the reference needs beyond its changes of velocity, as of ``frame_delta_v``.
    """
    found = energy_part(impulsive_delta_v(v_CT_H) + frame_mps, scenario, propellant_kg, firings)
    return found | {"passed": len(v_CT_H) > 0 and found["passed"]}


def energy_part(line: float, scenario: Scenario, propellant_kg: float, firings: int) -> dict[str, Any]:
    """Return ``passed`` and the numbers; line: the reference's changes of velocity summed, m/s.

    delta_v_mps is the rocket equation's value for the propellant, as if all thrust had acted in one direction.
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


def judge_field_of_view(history: np.ndarray, rig: Rig, step_s: float, shown: BenchScale = FULL_SCALE) -> dict[str, Any]:
    """Return ``passed``, the least margin to an image's edge, px, its time and range, and the time outside."""
    if not len(history):
        return {"passed": False, "margin_px": None, "at_s": None, "range_m": None, "lost_s": None}
    camera, leds = vision_params.camera(rig)
    margins = np.empty(len(history))
    feedback = history["feedback"]
    view_margins(
        bench_params.bench(rig, step_s, shown),
        vision_params.mounting(rig),
        camera,
        leds,
        np.ascontiguousarray(feedback["rail_m"]),
        np.ascontiguousarray(feedback["gimbal_rad"]),
        margins,
    )
    worst = int(np.argmin(margins))
    least = float(margins[worst])
    return {
        "passed": bool(least >= 0.0),
        "margin_px": least if np.isfinite(least) else None,
        "at_s": float(history["t_s"][worst]),
        "range_m": float(np.linalg.norm(history["truth"]["r_CT_H"][worst])),
        "lost_s": float(step_s * np.count_nonzero(margins < 0.0)),
    }
