"""Planned trajectory: the reference, the reduction of the initial attitude, and the aborts.

Nothing is simulated: the plan is sampled from guidance, and the motion that control may add is bounded by its
settings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from hil.bench.reachability import ControlBounds
from hil.config.scenario import Scenario
from hil.core.messages import REFERENCE, Array, new
from hil.dynamics.mass_properties import MASS_PROPERTIES, set_mass_properties
from hil.gnc import guidance
from hil.gnc.guidance import GUIDANCE_STATE
from hil.maths import linear, quat
from hil.params import dynamics as dynamics_params
from hil.params import gnc as gnc_params
from hil.params.control_rule import nominal_leads

_SAMPLES_OF_A_LINE = 17
_SAMPLES_OF_THE_SLEW = 9
_PAST_END_S = 1e-6  # past the end of a phase
_THRUST_ALLOWANCE = 1.25  # thrusters stronger, chaser lighter than nominal


@dataclass(frozen=True, slots=True)
class PlanSample:
    """One moment of the plan: pose and velocity of the chaser, and the keys of the scenario that determine them.

    abort_s: begin of the abort that it belongs to, None on the approach. r_CT_H: m, v_CT_H: m/s, rotation: vector of
    the attitude against H, rad, each (3,). far_m: largest range, m, at which the chaser may have left its line. q_CH:
    attitude of the reference.
    """

    t_s: float
    abort_s: float | None
    r_CT_H: Array
    v_CT_H: Array
    rotation: Array
    far_m: float
    point_key: str
    speed_key: str
    rotation_key: str = "initial.attitude_deg"
    q_CH: Array = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0]))


def control_bounds(scenario: Scenario) -> ControlBounds:
    """Return the bounds of the motion that control adds to the plan.

    A position error is reduced at ``correction_rate_mps``, which one burn of a period may exceed; an attitude
    error likewise at ``slew_rate_degps``, or at the initial rate. Accelerations: all thrusters that push
    one way. Raises ValueError if the layout cannot move an axis.
    """
    control = gnc_params.gnc(scenario).control
    burn = control.acceleration * control.period * control.dt_s
    slew = np.maximum(control.correction_rate[3:], np.abs(np.radians(scenario.initial.rate_degps)))
    slew = np.maximum(slew, _planned_rate(scenario))
    dss = dynamics_params.dss(scenario)
    n = dss.n_thrusters
    force = dss.thruster_direction[:n] * dss.thruster_force[:n, None]
    wrench = np.hstack([force, np.cross(dss.thruster_position[:n], force)])
    most = _THRUST_ALLOWANCE * np.maximum(np.maximum(wrench, 0.0).sum(axis=0), np.maximum(-wrench, 0.0).sum(axis=0))
    acceleration, slewing = _accelerations(dss, scenario.chaser.mass_kg, most)
    return ControlBounds(
        speed=control.correction_rate[:3] + burn[:3],
        rate=slew + burn[3:],
        acceleration=acceleration,
        slewing=slewing,
    )


def _accelerations(dss: np.record, mass_kg: float, most: Array) -> tuple[Array, Array]:
    """Return bounds of acceleration, m/s^2, and angular acceleration, rad/s^2, under ``most`` (6,), N, N m."""
    if not dss.mass.varies:
        bends = dss.flexible_array and dss.modes.n > 0
        inverse = dss.modes.inertia_inverse if bends else dss.inertia_inverse
        return most[:3] / mass_kg, linear.product(np.abs(inverse), most[3:])
    mass = new(MASS_PROPERTIES)
    set_mass_properties(dss, mass_kg, mass)
    slewing = linear.product(np.abs(mass.inertia_inverse), most[3:] + linear.product(np.abs(mass.lever), most[:3]))
    if not (dss.flexible_array and dss.modes.moves):
        return most[:3] / mass_kg, slewing
    return linear.product(np.abs(mass.mass_inverse), most[:3]) + linear.product(np.abs(mass.lever.T), slewing), slewing


def _planned_rate(scenario: Scenario) -> float:
    """Return the largest rate of rotation of a phase, rad/s: of its slew, or at the shortest radius of its arc."""
    settings, rates = scenario.gnc.guidance, [0.0]
    radii = [linear.length(scenario.initial.position_m), linear.length(settings.ready_point_m)]
    radii += [linear.length(phase.point_m) for phase in settings.phases.values() if phase.point_m is not None]
    for name in settings.sequence:
        phase = settings.phases[name]
        if phase.kind == "slew":
            rates.append(math.radians(phase.rate_degps or scenario.gnc.control.slew_rate_degps))
        elif phase.kind == "fly_around":
            rates.append((phase.speed_mps or settings.approach_speed_mps) / min(radii))
    return max(rates)


def moments(scenario: Scenario) -> list[PlanSample]:
    """Return the plan: every phase of the list, also beyond the end of the run, and an abort at each moment of it.

    Orders to continue are assumed to come at once. Raises ValueError if the layout cannot move an axis.
    """
    params = gnc_params.guidance(scenario)
    slew = _Slew(scenario)
    approach = _approach(params, scenario, slew)
    return [*_drift(scenario), *approach, *(m for start in approach for m in _abort(params, start, slew))]


class _Slew:
    """The initial attitude error, each component reduced at the slew rate."""

    def __init__(self, scenario: Scenario) -> None:
        self._start = gnc_params.initial_rotation_vector(scenario)
        _, strength = gnc_params.allocation(scenario.chaser)
        self._rate = float(gnc_params.control(scenario, strength).correction_rate[3:].min())
        self.ends_s = float(np.abs(self._start).max()) / self._rate

    def at(self, t_s: float) -> Array:
        remaining: Array = np.sign(self._start) * np.maximum(np.abs(self._start) - self._rate * t_s, 0.0)
        return remaining


def _drift(scenario: Scenario) -> list[PlanSample]:
    """Return the motion of a start with velocity until it is stopped: the switching function without an error."""
    initial = scenario.initial
    if not any((*initial.velocity_mps, *initial.rate_degps)):
        return []
    control = gnc_params.gnc(scenario).control
    motion = np.array([*initial.velocity_mps, *np.radians(initial.rate_degps)])
    lead = nominal_leads(control)
    travel = lead * motion + motion * np.abs(motion) / (2.0 * control.acceleration)
    start = np.array(initial.position_m)
    rotation = gnc_params.initial_rotation_vector(scenario)
    t_s = float((lead + np.abs(motion) / control.acceleration)[motion != 0.0].max())
    moved = start + travel[:3], np.zeros(3), rotation + travel[3:]
    key = "initial.velocity_mps"
    rotation_key = "initial.rate_degps" if travel[3:].any() else "initial.attitude_deg"
    return [
        PlanSample(0.0, None, start, np.array(initial.velocity_mps), rotation, 0.0, "initial.position_m", key),
        PlanSample(t_s, None, *moved, 0.0, key if travel[:3].any() else "initial.position_m", key, rotation_key),
    ]


def _approach(params: np.record, scenario: Scenario, slew: _Slew) -> list[PlanSample]:
    settings = scenario.gnc.guidance
    state, reference = new(GUIDANCE_STATE), new(REFERENCE)
    guidance.start(params, state)
    samples = []
    from_key = "initial.position_m"
    while True:
        phase = int(state.phase)
        name = settings.sequence[phase]
        own = settings.phases[name]
        moves = params.kind[phase] not in (guidance.HOLD, guidance.WAIT)
        own_point = f"gnc.guidance.phases.{name}.point_m" if own.point_m else "gnc.guidance.ready_point_m"
        to_key = own_point if moves else from_key
        speed_key = f"gnc.guidance.phases.{name}.speed_mps" if own.speed_mps else "gnc.guidance.approach_speed_mps"
        if own.kind == "transfer":
            speed_key = f"gnc.guidance.phases.{name}.duration_s"
        begin, end = float(state.since_s), _end_of(params, state)
        last = phase == params.n_phases - 1
        for t_s in _times(begin, end, last, moves, slew):
            guidance.reference(params, state, t_s, reference)
            r, v = reference.r_CT_H.copy(), reference.v_CT_H.copy()
            key = from_key if _distance(r, state.from_H) < _distance(r, state.to_H) else to_key
            q = reference.q_CH.copy()
            rotation = turned(slew.at(t_s), q)
            samples.append(PlanSample(t_s, None, r, v, rotation, linear.length(r), key, speed_key, q_CH=q))
        if last:
            return samples
        from_key = to_key
        go = 1 if params.kind[phase] == guidance.WAIT else 0
        guidance.advance(params, state, end + _PAST_END_S, go, 0)


def _end_of(params: np.record, state: np.record) -> float:
    """Return when the phase of the list ends, s; an order to continue comes at once."""
    begin, end = float(state.since_s), float(state.ends_s)
    return max(begin, end) if math.isfinite(end) else begin


def _times(begin: float, end: float, last: bool, moves: bool, slew: _Slew) -> list[float]:
    """Return the sampled moments of a phase: equidistant, and denser while the attitude slews."""
    slewing = np.linspace(0.0, slew.ends_s, _SAMPLES_OF_THE_SLEW)
    chosen = slewing[(slewing >= begin) & ((slewing <= end) | last)]
    even = np.linspace(begin, end, _SAMPLES_OF_A_LINE if moves else 2)
    return sorted({*even.tolist(), *chosen.tolist()})


def _abort(params: np.record, start: PlanSample, slew: _Slew) -> list[PlanSample]:
    """Return the end of the brake, and middle and end of the retreat, of an abort at ``start``."""
    state, reference = new(GUIDANCE_STATE), new(REFERENCE)
    guidance.start(params, state)
    guidance.start_abort(params, state, start.t_s, start.r_CT_H, start.v_CT_H)
    braked_s = float(state.ends_s)
    path = [(braked_s, state.to_H.copy(), np.zeros(3), "gnc.abort.brake_mps2")]
    guidance.advance(params, state, braked_s + _PAST_END_S, 0, 0)
    if guidance.kind_of(params, state.phase) == guidance.RETREAT:
        begin = float(state.since_s)
        for fraction in (0.5, 1.0):  # half-way it is fastest
            t_s = begin + fraction * (float(state.ends_s) - begin)
            guidance.reference(params, state, t_s, reference)
            path.append((t_s, reference.r_CT_H.copy(), reference.v_CT_H.copy(), "gnc.abort.hold_distance_m"))
    return [
        PlanSample(
            t,
            start.t_s,
            r,
            v,
            turned(slew.at(t), start.q_CH),
            max(start.far_m, linear.length(r)),
            key,
            "gnc.abort.speed_mps",
        )
        for t, r, v, key in path
    ]


def turned(rotation: Array, q_CH: Array) -> Array:
    """Return ``rotation`` (3,), rad, after the attitude ``q_CH`` (4,), as a rotation vector against H."""
    if not q_CH[:3].any():
        return rotation
    vector: Array = quat.to_rotation_vector(quat.multiply(quat.from_rotation_vector(rotation), q_CH))
    return vector


def _distance(a: Array, b: Array) -> float:
    return linear.length(a - b)
