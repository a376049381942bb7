"""Checks of planned paths before a run: an abort with any one thruster failed stays clear, transfers can be flown."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.core.messages import REFERENCE, new
from hil.errors import Problem
from hil.gnc import guidance
from hil.gnc.allocation import AXES_OF_A_BODY
from hil.gnc.approach_monitor import closing_limit, closing_margin
from hil.gnc.guidance import GUIDANCE_STATE
from hil.gnc.guidance_transfer import least_drift_range, plan_transfer
from hil.maths import linear
from hil.maths.elementary import square
from hil.params import gnc as gnc_params

KEY = "gnc.abort.one_thruster_failed"
STUCK_OPEN = "stuck open"
_UNWANTED_MAX = 0.8  # fraction of the demanded force or torque of a set
_RANGES = 50  # between ready point and start
_DETECTION_CYCLES = 3  # beyond ``thruster_open_s``


@dataclass(frozen=True)
class FailedThruster:
    """A thruster, from 1, and how it failed. braking_mps2: what is left, outwards; push_mps2: its own, inwards."""

    number: int
    kind: str
    braking_mps2: float
    push_mps2: float = 0.0

    def stopping_m(self, closing_mps: float, found_s: float) -> float:
        """Return the distance in which the chaser stops from ``closing_mps``, if the fault is found after a time."""
        faster = closing_mps + self.push_mps2 * found_s
        travelled = closing_mps * found_s + 0.5 * self.push_mps2 * square(found_s)
        return travelled + square(faster) / (2.0 * self.braking_mps2)


def failed_thrusters(scenario: Scenario) -> list[FailedThruster]:
    """Return what is left of the thrust along the docking axis, with c parallel to H, for each failure of one."""
    params, thrusters = gnc_params.gnc(scenario), scenario.chaser.thrusters
    n, axis = len(thrusters.position_m), np.array(scenario.gnc.corridor.axis)
    along = thrusters.force_n * linear.product(thrusters.direction, axis) / scenario.chaser.mass_kg
    component = int(np.argmax(np.abs(axis)))
    row, sign = AXES_OF_A_BODY + component, int(axis[component] > 0.0)
    failures = []
    for j in range(n):
        dead, stuck = params.dead_sets[j, row, sign, :n], params.open_sets[j, row, sign, :n] | params.against[j, :n]
        failures.append(FailedThruster(j + 1, "stuck closed", float(linear.product(dead, along))))
        opened = float(linear.product(stuck, along) + along[j])
        failures.append(FailedThruster(j + 1, STUCK_OPEN, opened, -float(along[j])))
    return failures


def check_abort(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for the first failure of a thruster with which an abort would not stay clear of the target."""
    value = scenario.value
    if value.gnc.binary is not None or not value.gnc.abort.one_thruster_failed:
        return []
    try:
        failures = failed_thrusters(value)
    except ValueError:  # a layout that cannot move an axis: refused by the check of the plan
        return []
    text = next((reason for failed in failures if (reason := _why_not(value, failed))), "")
    text = text or _why_not_isolated(value)
    return [scenario.problem(KEY, f"true: {text}")] if text else []


def _why_not_isolated(scenario: Scenario) -> str:
    """Return which demand the thrusters left without a bank cannot meet, "" if they meet all of them.

    A bank takes several thrusters away at once; one alone is replaced by the same sets as a dead one.
    """
    thrusters = scenario.chaser.thrusters
    if thrusters.isolation != "bank":
        return ""
    params, n = gnc_params.gnc(scenario), len(thrusters.position_m)
    wrenches = gnc_params.wrenches_of(thrusters)
    arm = linear.lengths(thrusters.position_m).mean()
    scaled = wrenches / np.array([1.0, 1.0, 1.0, arm, arm, arm])
    for j, axis, sign in np.ndindex(n, AXES_OF_A_BODY, 2):
        total = linear.product(params.isolated_sets[j, axis, sign, :n], scaled)
        useful = total[axis] * (2 * sign - 1)
        if not linear.length(np.delete(total, axis)) < _UNWANTED_MAX * useful:
            demand = f"{'-+'[sign]}{'FFFTTT'[axis]}{'xyz'[axis % 3]}"
            return f'isolation = "bank" of thruster.{j + 1} leaves no thrusters for the {demand} demand'
    return ""


def _why_not(scenario: Scenario, failed: FailedThruster) -> str:
    """Return why an abort with ``failed`` would not stay clear, "" if it would."""
    which = f"thruster.{failed.number} {failed.kind}"
    if failed.braking_mps2 <= 0.0:
        return f"with {which} no thrusters are left that brake along the docking axis"
    monitor, keep_out_m = gnc_params.approach_monitor(scenario), scenario.keep_out.radius_m
    found_s = _DETECTION_CYCLES * scenario.step_s
    if failed.kind == STUCK_OPEN:
        found_s += scenario.gnc.integrity.thruster_open_s
    ready_m, start_m = linear.length(scenario.gnc.guidance.ready_point_m), linear.length(scenario.initial.position_m)
    for range_m in np.linspace(ready_m, max(ready_m, start_m), _RANGES):
        closing_mps = float(closing_limit(monitor, float(range_m)))
        stops_m = float(range_m) - failed.stopping_m(closing_mps, found_s)
        if keep_out_m > 0.0 and stops_m < keep_out_m:
            return (
                f"with {which} at {range_m:.2f} m and {closing_mps:g} m/s an abort stops at {stops_m:.3f} m, "
                f"keep_out.radius_m is {keep_out_m:g}"
            )
    return ""


_SAMPLES = 200  # samples of a transfer
_PAST_END_S = 1e-6


def check_transfers(scenario_file: Loaded[Scenario]) -> list[Problem]:
    """Return a problem if a transfer cannot be planned, is not passively safe as asked, or closes too fast."""
    scenario = scenario_file.value
    settings = scenario.gnc.guidance
    transfers = [name for name in settings.sequence if settings.phases[name].kind == "transfer"]
    if not transfers:
        return []
    if scenario.target.motion == "tumble":
        text = '"transfer": the free motion is that of the Hill frame, allowed is another target.motion than "tumble"'
        return [scenario_file.problem(f"gnc.guidance.phases.{transfers[0]}.kind", text)]
    params, state = gnc_params.guidance(scenario), new(GUIDANCE_STATE)
    guidance.start(params, state)
    for phase, name in enumerate(settings.sequence):
        if name in transfers:
            text = _without_plan(params, state) if state.plan.n == 0 else _too_fast(scenario, params, state)
            if text:
                return [
                    scenario_file.problem(
                        f"gnc.guidance.phases.{name}.duration_s", f"{settings.phases[name].duration_s:g}: {text}"
                    )
                ]
        if phase < len(settings.sequence) - 1:
            end, go = float(state.ends_s), 1 if params.kind[phase] == guidance.WAIT else 0
            end = max(end, float(state.since_s)) if math.isfinite(end) else float(state.since_s)
            guidance.advance(params, state, end + _PAST_END_S, go, 0)
    return []


def _without_plan(params: np.record, state: np.record) -> str:
    """Return why the transfer that begins has no plan."""
    phase, plan = int(state.phase), state.plan
    plan_transfer(
        params.orbit, state.since_s, params.duration_s[phase], params.optimal[phase], params.acceleration[phase],
        plan.start.copy(), params.point[phase], state.work, plan,
    )  # fmt: skip
    if plan.n == 0:
        return (
            "no burns with acceleration_mps2 reach point_m in this time, allowed is another one, or impulses = "
            '"optimal": after half an orbit two impulses have no effect across the plane'
        )
    nearest = least_drift_range(params.orbit, plan, params.passive_s[phase], state.work.whole)
    return (
        f"the drift after a missed burn comes as near as {nearest:.2f} m within passively_safe_s, "
        f"allowed {params.clear_range:.2f} m by [keep_out]"
    )


def _too_fast(scenario: Scenario, params: np.record, state: np.record) -> str:
    """Return where the transfer closes faster than allowed, "" nowhere."""
    monitor, reference = gnc_params.approach_monitor(scenario), new(REFERENCE)
    for t_s in np.linspace(float(state.since_s), float(state.ends_s), _SAMPLES):
        guidance.reference(params, state, t_s, reference)
        margin = float(closing_margin(monitor, reference.r_CT_H, reference.v_CT_H))
        if margin <= 0.0:
            range_m = linear.length(reference.r_CT_H)
            return f"closes by {-margin:.3f} m/s faster at {range_m:.2f} m than gnc.corridor allows"
    return ""
