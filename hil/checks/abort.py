"""Check that an abort stays clear of the target with any one thruster failed, before a run."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.errors import Problem
from hil.gnc.allocation import AXES_OF_A_BODY
from hil.gnc.approach_monitor import closing_limit
from hil.params import gnc as gnc_params

KEY = "gnc.abort.one_thruster_failed"
STUCK_OPEN = "stuck open"
_UNWANTED_MAX = 0.8  # of the wanted force or torque of a set
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
        travelled = closing_mps * found_s + 0.5 * self.push_mps2 * found_s**2
        return travelled + faster**2 / (2.0 * self.braking_mps2)


def failed_thrusters(scenario: Scenario) -> list[FailedThruster]:
    """Return what is left of the thrust along the docking axis, with c parallel to H, for each failure of one."""
    params, thrusters = gnc_params.gnc(scenario), scenario.chaser.thrusters
    n, axis = len(thrusters.position_m), np.array(scenario.gnc.corridor.axis)
    along = thrusters.force_n * (np.array(thrusters.direction) @ axis) / scenario.chaser.mass_kg
    component = int(np.argmax(np.abs(axis)))
    row, sign = AXES_OF_A_BODY + component, int(axis[component] > 0.0)
    found = []
    for j in range(n):
        dead, stuck = params.dead_sets[j, row, sign, :n], params.open_sets[j, row, sign, :n] | params.against[j, :n]
        found.append(FailedThruster(j + 1, "stuck closed", float(dead @ along)))
        opened = float(stuck @ along + along[j])
        found.append(FailedThruster(j + 1, STUCK_OPEN, opened, -float(along[j])))
    return found


def check_abort(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for the first failure of a thruster with which an abort would not stay clear of the target."""
    value = scenario.value
    if value.gnc.binary is not None or not value.gnc.abort.one_thruster_failed:
        return []
    try:
        failures = failed_thrusters(value)
    except ValueError:  # a layout that cannot move an axis: refused by the check of the plan
        return []
    text = next((found for failed in failures if (found := _why_not(value, failed))), "")
    text = text or _why_not_isolated(value)
    return [Problem(scenario.where(KEY), KEY, f"true: {text}")] if text else []


def _why_not_isolated(scenario: Scenario) -> str:
    """Return which demand the thrusters left without a bank cannot meet, "" if they meet all of them.

    A bank takes several thrusters away at once; one alone is replaced by the same sets as a dead one.
    """
    thrusters = scenario.chaser.thrusters
    if thrusters.isolation != "bank":
        return ""
    params, n = gnc_params.gnc(scenario), len(thrusters.position_m)
    wrenches = gnc_params.wrenches_of(thrusters)
    arm = np.linalg.norm(thrusters.position_m, axis=1).mean()
    scaled = wrenches / np.array([1.0, 1.0, 1.0, arm, arm, arm])
    for j, axis, sign in np.ndindex(n, AXES_OF_A_BODY, 2):
        total = params.isolated_sets[j, axis, sign, :n] @ scaled
        wanted = total[axis] * (2 * sign - 1)
        if not np.linalg.norm(np.delete(total, axis)) < _UNWANTED_MAX * wanted:
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
    ready_m, start_m = math.hypot(*scenario.gnc.guidance.ready_point_m), math.hypot(*scenario.initial.position_m)
    for range_m in np.linspace(ready_m, max(ready_m, start_m), _RANGES):
        closing_mps = float(closing_limit(monitor, float(range_m)))
        stops_m = float(range_m) - failed.stopping_m(closing_mps, found_s)
        if keep_out_m > 0.0 and stops_m < keep_out_m:
            return (
                f"with {which} at {range_m:.2f} m and {closing_mps:g} m/s an abort stops at {stops_m:.3f} m, "
                f"keep_out.radius_m is {keep_out_m:g}"
            )
    return ""
