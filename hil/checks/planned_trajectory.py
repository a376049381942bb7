"""The run as it is planned: where the reference goes, how the start's attitude is taken out, where aborts lead.

Nothing here is simulated: the plan is sampled from the guidance that flies it, and what the controller may
add to it is bounded from its own settings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.config.scenario import Scenario
from hil.core.messages import REFERENCE, Array, new
from hil.gnc import guidance
from hil.gnc.guidance import GUIDANCE_STATE
from hil.models.profile import duration
from hil.params import gnc as gnc_params

_SAMPLES_OF_A_LINE = 17
_SAMPLES_OF_THE_SLEW = 9
_A_MOMENT_S = 1e-6  # past the end of a phase
_THRUST_ALLOWANCE = 1.25  # thrusters stronger than named, a chaser lighter than named


@dataclass(frozen=True, slots=True)
class PlanSample:
    """One moment of the plan: where the chaser is and how it stands, and which keys of the scenario say so.

    abort_s: begin of the abort that it belongs to, None on the approach. r_CT_H: m, v_CT_H: m/s, turn: rotation
    vector of the attitude against H, rad, each (3,). far_m: range, m, at which the chaser may have got off its line.
    """

    t_s: float
    abort_s: float | None
    r_CT_H: Array
    v_CT_H: Array
    turn: Array
    far_m: float
    point_key: str
    speed_key: str
    turn_key: str = "initial.attitude_deg"


@dataclass(frozen=True, slots=True)
class ControlBounds:
    """What the controller may add to the plan, each (3,), in c: m/s, rad/s, m/s^2, rad/s^2."""

    speed: Array
    rate: Array
    acceleration: Array
    turning: Array


def control_bounds(scenario: Scenario) -> ControlBounds:
    """Return the bounds of what control does about the plan.

    A position error is worked off at ``correction_rate_mps``, which one burn of a period may pass; an attitude
    error the same at ``slew_rate_degps``, or at the start's own rate. Accelerations: all thrusters that push
    one way. Raises ValueError where the layout cannot move an axis.
    """
    control = gnc_params.control(scenario, gnc_params.allocation(scenario.chaser)[1])
    burn = control.acceleration * control.period * control.dt_s
    slew = np.maximum(control.correction_rate[3:], np.abs(np.radians(scenario.initial.rate_degps)))
    dss = gnc_params.dss(scenario)
    n = dss.n_thrusters
    force = dss.thruster_direction[:n] * dss.thruster_force[:n, None]
    wrench = np.hstack([force, np.cross(dss.thruster_position[:n], force)])
    most = _THRUST_ALLOWANCE * np.maximum(np.maximum(wrench, 0.0).sum(axis=0), np.maximum(-wrench, 0.0).sum(axis=0))
    inverse = dss.mode.inertia_inverse if dss.flexible_array and scenario.chaser.solar_array else dss.inertia_inverse
    return ControlBounds(
        speed=control.correction_rate[:3] + burn[:3],
        rate=slew + burn[3:],
        acceleration=most[:3] / scenario.chaser.mass_kg,
        turning=np.abs(inverse) @ most[3:],
    )


def moments(scenario: Scenario) -> list[PlanSample]:
    """Return the plan: every phase of the list, whatever the duration of the run, and an abort at each moment of it.

    Orders to go on are taken to come at once. Raises ValueError where the layout cannot move an axis.
    """
    params = gnc_params.guidance(scenario)
    slew = _Slew(scenario)
    approach = _approach(params, scenario, slew)
    return [*_drift(scenario), *approach, *(m for start in approach for m in _abort(params, start, slew))]


class _Slew:
    """The start's attitude error, each component worked off at the slew rate."""

    def __init__(self, scenario: Scenario) -> None:
        self._start = gnc_params.initial_rotation_vector(scenario)
        self._rate = math.radians(scenario.gnc.control.slew_rate_degps)
        self.ends_s = float(np.abs(self._start).max()) / self._rate

    def at(self, t_s: float) -> Array:
        left: Array = np.sign(self._start) * np.maximum(np.abs(self._start) - self._rate * t_s, 0.0)
        return left


def _drift(scenario: Scenario) -> list[PlanSample]:
    """Return how far a start in motion carries the chaser before it is stopped: the switching function at no error."""
    initial = scenario.initial
    if not any((*initial.velocity_mps, *initial.rate_degps)):
        return []
    control = gnc_params.control(scenario, gnc_params.allocation(scenario.chaser)[1])
    motion = np.array([*initial.velocity_mps, *np.radians(initial.rate_degps)])
    way = control.lead * motion + motion * np.abs(motion) / (2.0 * control.acceleration)
    start = np.array(initial.position_m)
    turn = gnc_params.initial_rotation_vector(scenario)
    t_s = float((control.lead + np.abs(motion) / control.acceleration)[motion != 0.0].max())
    moved = start + way[:3], np.zeros(3), turn + way[3:]
    key = "initial.velocity_mps"
    turn_key = "initial.rate_degps" if way[3:].any() else "initial.attitude_deg"
    return [
        PlanSample(0.0, None, start, np.array(initial.velocity_mps), turn, 0.0, "initial.position_m", key),
        PlanSample(t_s, None, *moved, 0.0, key if way[:3].any() else "initial.position_m", key, turn_key),
    ]


def _approach(params: np.record, scenario: Scenario, slew: _Slew) -> list[PlanSample]:
    settings = scenario.gnc.guidance
    state, reference = new(GUIDANCE_STATE), new(REFERENCE)
    guidance.start(params, state)
    found = []
    from_key = "initial.position_m"
    while True:
        phase = int(state.phase)
        name = settings.sequence[phase]
        own = settings.phases[name]
        moves = params.kind[phase] not in (guidance.HOLD, guidance.WAIT)
        own_point = f"gnc.guidance.phases.{name}.point_m" if own.point_m else "gnc.guidance.ready_point_m"
        to_key = own_point if moves else from_key
        speed_key = f"gnc.guidance.phases.{name}.speed_mps" if own.speed_mps else "gnc.guidance.approach_speed_mps"
        begin, end = float(state.since_s), _end_of(params, state)
        last = phase == params.n_phases - 1
        for t_s in _times(begin, end, last, moves, slew):
            guidance.reference(params, state, t_s, reference)
            r, v = reference.r_CT_H.copy(), reference.v_CT_H.copy()
            key = from_key if _distance(r, state.from_H) < _distance(r, state.to_H) else to_key
            found.append(PlanSample(t_s, None, r, v, slew.at(t_s), float(np.linalg.norm(r)), key, speed_key))
        if last:
            return found
        from_key = to_key
        go = 1 if params.kind[phase] == guidance.WAIT else 0
        guidance.advance(params, state, end + _A_MOMENT_S, go, 0)


def _end_of(params: np.record, state: np.record) -> float:
    """Return when the phase of the list is over, s; an order to go on comes at once."""
    phase, begin = state.phase, float(state.since_s)
    if params.kind[phase] == guidance.WAIT:
        until = float(params.until_s[phase])
        return max(begin, until) if math.isfinite(until) else begin
    if params.kind[phase] == guidance.HOLD:
        return begin + float(params.duration_s[phase])
    limits = params.speed[phase], params.acceleration[phase], params.deceleration[phase]
    return begin + float(duration(_distance(state.from_H, state.to_H), *limits))


def _times(begin: float, end: float, last: bool, moves: bool, slew: _Slew) -> list[float]:
    """Return the moments of a phase that are looked at: evenly spread, and closer while the attitude slews."""
    turning = np.linspace(0.0, slew.ends_s, _SAMPLES_OF_THE_SLEW)
    chosen = turning[(turning >= begin) & ((turning <= end) | last)]
    even = np.linspace(begin, end, _SAMPLES_OF_A_LINE if moves else 2)
    return [float(t) for t in np.unique(np.concatenate([even, chosen]))]


def _abort(params: np.record, start: PlanSample, slew: _Slew) -> list[PlanSample]:
    """Return the end of the brake, and middle and end of the retreat, of an abort at ``start``."""
    state, reference = new(GUIDANCE_STATE), new(REFERENCE)
    guidance.start_abort(params, state, start.t_s, start.r_CT_H, start.v_CT_H)
    braked_s = start.t_s + float(np.linalg.norm(start.v_CT_H)) / float(params.brake)
    found = [(braked_s, state.to_H.copy(), np.zeros(3), "gnc.abort.brake_mps2")]
    guidance.advance(params, state, braked_s + _A_MOMENT_S, 0, 0)
    if guidance.kind_of(params, state.phase) == guidance.RETREAT:
        limits = params.abort_speed, params.abort_acceleration, params.abort_acceleration
        takes = float(duration(_distance(state.from_H, state.to_H), *limits))
        for share in (0.5, 1.0):  # half-way it is fastest
            t_s = float(state.since_s) + share * takes
            guidance.reference(params, state, t_s, reference)
            found.append((t_s, reference.r_CT_H.copy(), reference.v_CT_H.copy(), "gnc.abort.hold_distance_m"))
    return [
        PlanSample(
            t, start.t_s, r, v, slew.at(t), max(start.far_m, float(np.linalg.norm(r))), key, "gnc.abort.speed_mps"
        )
        for t, r, v, key in found
    ]


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b))
