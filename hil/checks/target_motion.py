"""Check of a plan in the axes of a target that rotates: thrust that it takes, and motion that the rig can show."""

from __future__ import annotations

import math

import numpy as np

from hil.checks.vehicle import phase_demands
from hil.config.load import Loaded
from hil.config.rig import BENCH_AXES, GIMBAL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.core.messages import REFERENCE, Array, new
from hil.errors import Problem
from hil.gnc import guidance
from hil.gnc.guidance import GUIDANCE_STATE
from hil.maths import linear
from hil.models.rotating_frame import tumble_rate
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params
from hil.params.target import tumble

THRUST_FRACTION = 0.6  # fraction of an axis's acceleration for the plan: the rest is for control
_KEY = "target.rate_degps"
_INTERVAL_S = 0.5  # between two samples of a phase
_RATES = 400  # samples of the tumble over the run
_ABORTS = 8  # along the approach

Plan = list[tuple[Array, Array, Array]]
"""Position, m, velocity, m/s, and acceleration, m/s^2, (3,) each, of the reference at samples of a plan."""


def check_target_motion(scenario_file: Loaded[Scenario], rig_file: Loaded[Rig]) -> list[Problem]:
    """Return a problem if a target tumbles faster than the chaser can follow or the rig can show.

    The plan may need at most ``THRUST_FRACTION`` of the acceleration of each axis. A chaser that coasts leaves the
    rotating axes at their rate times its range, which rails and turntable must be able to show until it is stopped.
    """
    scenario = scenario_file.value
    if scenario.target.motion != "tumble":
        return []
    rates, changes = tumble_over(scenario)
    plan = planned(scenario)
    text = _beyond_rig(scenario, rig_file.value, plan, rates) or _beyond_thrusters(scenario, plan, rates, changes)
    shown = list(scenario.target.rate_degps)
    return [scenario_file.problem(_KEY, f"{shown}: {text}")] if text else []


def tumble_over(scenario: Scenario) -> tuple[Array, Array]:
    """Return rate, rad/s, and its rate of change, (n, 3) each, of the target over the run."""
    params = tumble(scenario.target, np.radians(scenario.target.rate_degps))
    rates, changes = np.empty((_RATES, 3)), np.empty((_RATES, 3))
    for k, t_s in enumerate(np.linspace(0.0, scenario.duration_s, _RATES)):
        tumble_rate(params, t_s, rates[k], changes[k])
    return rates, changes


def plan_accelerations(plan: Plan, rates: Array, changes: Array) -> tuple[Array, Array]:
    """Return the largest acceleration, m/s^2, that ``plan`` needs of the thrusters along each axis, and its range, m.

    At any time of the tumble: the operator may hold the approach. c is parallel to the target's axes.
    """
    needed, ranges = np.zeros(3), np.zeros(3)
    for r, v, a in plan:
        wr = np.cross(rates, r)
        total = np.abs(a + 2.0 * np.cross(rates, v) + np.cross(rates, wr) + np.cross(changes, r)).max(axis=0)
        ranges = np.where(total > needed, linear.length(r), ranges)
        needed = np.maximum(needed, total)
    return needed, ranges


def _beyond_rig(scenario: Scenario, rig: Rig, plan: Plan, rates: Array) -> str:
    """Return what the rig cannot show of a chaser that coasts, "" if it can show all."""
    bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
    far_m = max(linear.length(r) for r, _, _ in plan)
    fastest = rate = float(linear.lengths(rates).max())
    beside = ""
    if rig.rotated_target is not None:
        limits = bench_params.manipulator_limits(rig, scenario.step_s).rate_max[3:]
        slowest = int(np.argmin(limits))  # the tumble may be about any axis
        rate = max(0.0, fastest - float(limits[slowest]))
        key = f"rig.rotary_manipulator.{GIMBAL_NAMES[slowest]}.rate_max_degps"
        shown = f"{math.degrees(fastest):.3g} deg/s less {math.degrees(limits[slowest]):g} deg/s by {key}"
        beside = f" ({shown}, which shows the rest)"
    for axis in (1, 2, 0, 3, 4, 5):
        asked, unit, scale = (rate * far_m, "m", 1.0) if axis < 3 else (rate, "deg", math.degrees(1.0))
        if asked > bench.rate_max[axis]:
            axes = "the lab" if beside else "the target's axes"
            return (
                f"a chaser that coasts at {far_m:.2f} m would move at {asked * scale:.3g} {unit}/s in {axes}{beside}, "
                f"allowed {bench.rate_max[axis] * scale:g} {unit}/s by rig.{BENCH_AXES[axis]}.rate_max_{unit}ps"
            )
    return ""


def _beyond_thrusters(scenario: Scenario, plan: Plan, rates: Array, changes: Array) -> str:
    """Return on which axis the plan needs too much of the thrusters, "" on none."""
    _, strength = gnc_params.allocation(scenario.chaser)
    inertia = np.array(scenario.chaser.inertia_kg_m2)
    needed, ranges = plan_accelerations(plan, rates, changes)
    torque = linear.product(changes, inertia) + np.cross(rates, linear.product(rates, inertia))
    asked = np.concatenate([scenario.chaser.mass_kg * needed, np.abs(torque).max(axis=0)]) / strength[:6]
    worst = int(np.argmax(asked))
    if asked[worst] <= THRUST_FRACTION:
        return ""
    name, alone = "xyz"[worst % 3], ""
    if worst < 3:
        without = scenario.chaser.mass_kg * plan_accelerations(plan, 0.0 * rates, 0.0 * changes)[0] / strength[:3]
        if without[worst] > 0.9 * THRUST_FRACTION:
            setters = [(each.needed_mps2, each.key) for each in phase_demands(scenario) if each.axis == worst]
            key = max(*setters, (scenario.gnc.abort.acceleration_mps2, "gnc.abort.acceleration_mps2"))[1]
            alone = f"; for a target at rest {100.0 * without[worst]:.0f} %, by {key}"
        what = f"{needed[worst]:.3g} m/s2 along {name} at {ranges[worst]:.2f} m"
    else:
        what = f"{np.abs(torque).max(axis=0)[worst - 3]:.3g} N m about {name}"
    return (
        f"the plan takes {what}, {100.0 * asked[worst]:.0f} % of what chaser.thrusters give, "
        f"allowed {100.0 * THRUST_FRACTION:g} %{alone}"
    )


def planned(scenario: Scenario) -> Plan:
    """Return the samples of approach and retreats."""
    params = gnc_params.guidance(scenario)
    state, reference = new(GUIDANCE_STATE), new(REFERENCE)
    guidance.start(params, state)
    plan = _phases(params, state, reference)
    for r, v, _ in plan[:: max(1, len(plan) // _ABORTS)]:
        guidance.start(params, state)
        guidance.start_abort(params, state, 0.0, r, v)
        guidance.advance(params, state, float(state.ends_s) + 1e-6, 0, 0)
        plan += _phases(params, state, reference)
    return plan


def _phases(params: np.record, state: np.record, reference: np.record) -> Plan:
    """Return the samples of the phases from the present one on; orders to continue come at once."""
    plan: Plan = []
    while True:
        begin, end = float(state.since_s), float(state.ends_s)
        end = max(begin, end) if math.isfinite(end) else begin
        for t_s in np.arange(begin, end + _INTERVAL_S, _INTERVAL_S):
            guidance.reference(params, state, min(t_s, end), reference)
            plan.append((reference.r_CT_H.copy(), reference.v_CT_H.copy(), reference.a_CT_H.copy()))
        phase = int(state.phase)
        go = 1 if guidance.kind_of(params, phase) == guidance.WAIT else 0
        if guidance.advance(params, state, end + 1e-6, go, 0) != guidance.MOVED:
            return plan
