"""Vehicle against plan: what the thrusters give along and about each axis, and what the phases take of it.

A phase that takes more than a demand gives is followed late. Whether the chaser can fly it all the same is decided by a
textbook control: proportional-derivative with feed-forward, continuous, and cut at what the demands give. Where that
breaks the corridor or the closing rate, or ends outside Table III, no control of this vehicle flies the plan.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import BUILT_IN, Scenario
from hil.core.messages import REFERENCE, Array, new
from hil.dynamics.hill import hill_acceleration
from hil.errors import Problem
from hil.gnc import guidance
from hil.gnc.allocation import axes_in_plane
from hil.gnc.approach_monitor import closing_limit, closing_margin, corridor_margin
from hil.gnc.guidance import GUIDANCE_STATE
from hil.maths import linear, quat
from hil.params import gnc as gnc_params
from hil.params.ready import tolerances

_SIGMAS: Final = 3.0  # of the declared scatter of a thrust
_SAMPLES: Final = 41  # of a phase, in the search for what it takes
_INTERVAL_S: Final = 0.1
_FREQUENCY_RADPS: Final = 0.3  # of the textbook control, critically damped
_SETTLED_S: Final = 30.0  # at the end of a phase that waits
_EDGE_S: Final = 1e-6
_CLOSING: Final = 0.92  # of the largest closing rate: the rest is for the uncertainty of estimate and thrust


class Authority(NamedTuple):
    """Acceleration along x, y, z, m/s^2, and about them, rad/s^2, each (6,), that thrusters give in c.

    demand: of a demand, less the scatter that is declared. dead: with the worst thruster dead, 0 for none. full: along
    x, y, z with all thrusters that push that way.
    """

    demand: Array
    dead: Array
    full: Array


class PhaseDemand(NamedTuple):
    """Largest acceleration that a phase takes along an axis of c, what thrusters give it, and the key that sets it.

    Accelerations in m/s^2.
    """

    phase: str
    axis: int
    needed_mps2: float
    given_mps2: float
    key: str


class _Sample(NamedTuple):
    t_s: float
    name: str
    r: Array
    v: Array
    needed_C: Array
    rotation: Array  # matrix from H to c
    from_H: Array
    to_H: Array


def authority(scenario: Scenario) -> Authority:
    """Return the authority of the chaser's thrusters. Raises ValueError if the layout cannot move an axis."""
    params, chaser = gnc_params.gnc(scenario), scenario.chaser
    n, wrenches = len(chaser.thrusters.position_m), gnc_params.wrenches_of(chaser.thrusters)
    sets, strength = gnc_params.allocation(chaser)
    of_row = np.concatenate([np.full(3, chaser.mass_kg), np.diag(np.array(chaser.inertia_kg_m2))])
    dead = np.full(6, np.inf)
    for j, axis, sign in np.ndindex(n, 6, 2):
        if sets[axis, sign, j]:
            given = (2 * sign - 1) * linear.product(params.dead_sets[j, axis, sign, :n], wrenches)[axis]
            dead[axis] = min(dead[axis], max(0.0, float(given)))
    nominal = 1.0 - min(1.0, _SIGMAS * scenario.truth.force_scatter_sigma / math.sqrt(2.0))
    moves = np.asarray(params.control.held) == 0
    demand, dead = (np.where(moves, nominal * each / of_row, 0.0) for each in (strength[:6], dead))
    return Authority(demand, dead, np.where(moves[:3], nominal * strength[6:] / chaser.mass_kg, 0.0))


def limits_of_phases(scenario: Scenario) -> dict[str, Array]:
    """Return the acceleration along each axis of c that each phase has of the thrusters, m/s^2, (3,) each.

    A GNC of the user's own may open all thrusters.
    """
    given, settings = authority(scenario), scenario.gnc.guidance
    has_own = scenario.gnc.binary is not None or scenario.gnc.control.backend not in BUILT_IN["control"]
    full = gnc_params.guidance(scenario).full_thrust
    return {name: given.full if has_own or full[k] else given.demand[:3] for k, name in enumerate(settings.sequence)}


def _samples(scenario: Scenario, interval_s: float | None) -> Iterator[_Sample]:
    """Yield samples of the plan in order: every ``interval_s``, or a few of each phase, its begin and its end."""
    params, settings = gnc_params.guidance(scenario), scenario.gnc.guidance
    state, reference, free, w0 = new(GUIDANCE_STATE), new(REFERENCE), np.empty(3), float(params.orbit.mean_motion)
    moves = np.isin(range(3), axes_in_plane(scenario.chaser.held))
    guidance.start(params, state)
    while True:
        begin, end = float(state.since_s), float(state.ends_s)
        end = max(begin, end) if math.isfinite(end) else begin
        if interval_s is None:
            times = np.linspace(begin, end, _SAMPLES if end > begin else 1)
            times[0], times[-1] = begin + min(_EDGE_S, end - begin), max(begin, end - _EDGE_S)
        else:
            times = np.arange(begin, end + (_SETTLED_S if end == begin else 0.0), interval_s)
        for t_s in times.tolist():
            guidance.reference(params, state, t_s, reference)
            hill_acceleration(reference.r_CT_H, reference.v_CT_H, w0, free)
            rotation = quat.to_matrix(reference.q_CH)
            yield _Sample(
                t_s, settings.sequence[int(state.phase)], reference.r_CT_H.copy(), reference.v_CT_H.copy(),
                moves * linear.product(rotation, reference.a_CT_H - free), rotation, reference.from_H.copy(),
                reference.to_H.copy(),
            )  # fmt: skip
        go = 1 if guidance.kind_of(params, state.phase) == guidance.WAIT else 0
        if guidance.advance(params, state, end + _EDGE_S, go, 0) != guidance.MOVED:
            return


def phase_demands(scenario: Scenario) -> list[PhaseDemand]:
    """Return what each phase takes along each axis of c at most, in the order of the phases."""
    most: dict[tuple[str, int], PhaseDemand] = {}
    given = limits_of_phases(scenario)
    for sample in _samples(scenario, None):
        brakes = float(linear.product(linear.product(sample.rotation, sample.v), sample.needed_C)) < 0.0
        for axis in range(3):
            needed, known = abs(float(sample.needed_C[axis])), most.get((sample.name, axis))
            if known is None or needed > known.needed_mps2:
                key = _key(scenario, sample.name, brakes)
                most[sample.name, axis] = PhaseDemand(sample.name, axis, needed, float(given[sample.name][axis]), key)
    return list(most.values())


def _key(scenario: Scenario, name: str, brakes: bool) -> str:
    """Return the key that sets the acceleration of a phase, or its deceleration."""
    phase = scenario.gnc.guidance.phases[name]
    if phase.kind == "transfer":
        return f"gnc.guidance.phases.{name}.duration_s"
    setting = "deceleration_mps2" if brakes else "acceleration_mps2"
    return f"gnc.guidance.{f'phases.{name}.' if getattr(phase, setting) is not None else ''}{setting}"


def check_vehicle(scenario_file: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for the first phase that the chaser cannot fly, with what it takes and what thrusters give."""
    scenario = scenario_file.value
    if scenario.target.motion == "tumble":  # ``check_target_motion`` compares thrust and plan
        return []
    beyond = [each for each in phase_demands(scenario) if each.needed_mps2 > each.given_mps2]
    reason = _why_not(scenario) if beyond else ""
    if not reason:
        return []
    worst = max(beyond, key=lambda each: each.needed_mps2 / max(each.given_mps2, 1e-300))
    text = (
        f"phase {worst.phase} takes {worst.needed_mps2:.3g} m/s2 along {'xyz'[worst.axis]}, chaser.thrusters give "
        f"{worst.given_mps2:.3g}: {reason}"
    )
    return [scenario_file.problem(worst.key, text)]


def _why_not(scenario: Scenario) -> str:
    """Return what the textbook control breaks with what the thrusters give, "" for nothing."""
    params, limits = gnc_params.approach_monitor(scenario), limits_of_phases(scenario)
    off, speed, previous_s = np.zeros(3), np.zeros(3), None
    reach_m = 2.0 * scenario.gnc.control.correction_rate_mps / _FREQUENCY_RADPS  # errors are worked off at that rate
    for sample in _samples(scenario, _INTERVAL_S):
        dt_s = 0.0 if previous_s is None else min(_INTERVAL_S, max(0.0, sample.t_s - previous_s))
        previous_s = sample.t_s
        cut = np.clip(off, -reach_m, reach_m)
        correction = -_FREQUENCY_RADPS * _FREQUENCY_RADPS * cut - 2.0 * _FREQUENCY_RADPS * speed
        asked = sample.needed_C + linear.product(sample.rotation, correction)
        most = limits[sample.name]
        lacks = np.clip(asked, -most, most) - sample.needed_C
        speed = speed + dt_s * linear.product(sample.rotation.T, lacks)
        off = off + dt_s * speed
        r, v = sample.r + off, sample.v + speed
        range_m = linear.length(r)
        limit_mps = float(closing_limit(params, range_m))
        allowed_mps = _CLOSING * limit_mps
        if (speed_mps := limit_mps - float(closing_margin(params, r, v))) > allowed_mps:
            return (
                f"the chaser would close with {speed_mps:.3g} m/s at {range_m:.2f} m, allowed {allowed_mps:.3g}, "
                f"{_CLOSING:.0%} of the closing rate there"
            )
        if (margin := float(corridor_margin(params, sample.from_H, sample.to_H, r))) < 0.0:
            return f"the chaser would leave the corridor by {-margin:.3g} m at {range_m:.2f} m"
    allowed = tolerances(scenario.requirements)["position_m"]
    worst = int(np.argmax(np.abs(off) / allowed))
    if abs(off[worst]) <= allowed[worst]:
        return ""
    return f"the chaser would be {abs(off[worst]):.3g} m off along {'xyz'[worst]} at the end of the plan"
