"""The decision "docking: go", judged on the truth, and what the navigation states about itself.

A *decision error* is a cycle in which docking is a go, or may still rely on one, while the truth is outside the
requirement that a go certifies. An estimate whose error exceeds its protection level is wrong about itself; it counts
unless an alarm follows within ``QUIET_S``. A mean NEES beyond what a consistent filter has in a run is the same.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.gnc_records import GncHealth
from hil.core.jit import kernel
from hil.gnc import ready_phase
from hil.gnc.approach_monitor import NOT_ABORTED, ORDERED
from hil.gnc.ready_phase import READY_PARAMS
from hil.maths import stack
from hil.maths.limits import has_held

QUIET_S = 2.0
"""Time in which an alarm must follow an error beyond the protection level."""
ACCUSED: Final = ("vision", "imu", "thruster", "sensor")
_BITS = (
    GncHealth.VISION_LOST.value | GncHealth.VISION_SUSPECT.value, GncHealth.IMU_SUSPECT.value,
    GncHealth.THRUSTER_FAULT.value, GncHealth.SENSOR_SUSPECT.value,
)  # fmt: skip

DECISION_PARAMS = np.dtype(
    [
        ("ready", READY_PARAMS),
        ("required_s", "f8"),  # for which a go certifies the requirement
        ("first_fault_s", "f8"),  # onset of the first injected fault, inf for none
        ("settled_s", "f8"),  # from which on the NEES counts
    ],
    align=True,
)

DECISION_STATE = np.dtype(
    [
        ("go_s", "f8"),  # first time at which docking was a go, nan for never
        ("error", "i8"),  # 1: a decision error
        ("error_s", "f8"),  # its time, with the number and the value of a deviation that was outside
        ("error_by", "i8"),
        ("error_value", "f8"),
        ("beyond_s", "f8"),  # when an error was first beyond the level without an alarm
        ("beyond", "i8"),  # cycles with an error beyond the level without an alarm
        ("over_level", "f8"),  # largest error over its level without an alarm
        ("pending", "i8"),  # cycles beyond it that an alarm may still follow
        ("pending_s", "f8"),  # time of the first of them, nan for none
        ("health", "i8"),  # of the cycle before
        ("false", "i8", len(ACCUSED)),  # accusations before the first fault
        ("fused", "i8", 2),  # updates with a NEES, of position and attitude filter
        ("nees", "f8", 2),  # their sums
    ],
    align=True,
)


@kernel
def start_decision(state):
    """Initialise the zeroed ``state`` for a run."""
    state.go_s = state.pending_s = np.nan


@kernel
def _is_outside(params, truth, state):
    """Return whether ``truth`` (TRUTH) is outside the requirement; ``state`` then has a deviation that is."""
    deviation = stack.vector(12)
    ready_phase.deviations_of(params, truth.r_CT_H, truth.v_CT_H, truth.q_CH, truth.w_CI_C, truth.w_HI_H, deviation)
    if ready_phase.is_within(params, deviation):
        return False
    for i in range(ready_phase.DEVIATIONS):
        if not abs(deviation[i]) <= params.tolerance[i]:
            state.error_by, state.error_value = i, abs(deviation[i])
    return True


@kernel
def _share(error, level):
    """Return ``error`` over ``level``: 0 for one that is infinite or not reported."""
    if level > 0.0:
        return error / level
    return np.inf if level == 0.0 and error > 0.0 else 0.0


@kernel
def _over_level(truth, estimate, turned):
    """Return the largest position error, of an axis, or the attitude's, over the level that ``estimate`` reports."""
    largest = 0.0
    for i in range(3):
        error = abs(truth.r_CT_H[i] - estimate.r_CT_H[i])
        largest = max(largest, _share(error, estimate.protection_level_m[i]))
    return max(largest, _share(math.sqrt(turned / 3.0), estimate.protection_level_rad))


@kernel
def _count_accusations(params, state, t_s, health):
    """Count the bits of ``health`` that appear before the first fault."""
    new = health & ~state.health
    state.health = health
    if new != 0 and t_s < params.first_fault_s:
        for i in range(len(_BITS)):
            state.false[i] += 1 if new & _BITS[i] != 0 else 0


@kernel
def _count_nees(state, k, nees):
    """Add the NEES of an update; nan for none."""
    if not math.isnan(nees):
        state.fused[k] += 1
        state.nees[k] += nees


@kernel
def update_decision(params, state, now, turned):
    """Judge the cycle ``now`` (CYCLE). turned: square of the attitude's error, rad^2, if there is an estimate."""
    estimate, supervision, t_s = now.navigation, now.supervision, now.t_s
    _count_accusations(params, state, t_s, estimate.health)
    if estimate.valid == 0:
        return
    if t_s >= params.settled_s:
        _count_nees(state, 0, now.nees_position)
        _count_nees(state, 1, now.nees_attitude)
    aborted = supervision.aborted != NOT_ABORTED and supervision.aborted != ORDERED
    alarm = estimate.health != 0 or supervision.reaction != 0 or aborted
    is_go = supervision.aborted == NOT_ABORTED and has_held(supervision.ready_since_s, t_s, params.ready.dwell_s)
    if is_go and math.isnan(state.go_s):
        state.go_s = t_s
    relied_on = is_go or (t_s - state.go_s <= params.required_s and not alarm and supervision.aborted == NOT_ABORTED)
    if relied_on and state.error == 0 and _is_outside(params.ready, now.truth, state):
        state.error, state.error_s = 1, t_s
    if alarm:
        state.pending, state.pending_s = 0, np.nan
        return
    over = _over_level(now.truth, estimate, turned)
    state.over_level = max(state.over_level, over)
    if over > 1.0:
        state.pending += 1
        if math.isnan(state.pending_s):
            state.pending_s = t_s
    if t_s - state.pending_s > QUIET_S:
        if state.beyond == 0:
            state.beyond_s = state.pending_s
        state.beyond += state.pending
        state.pending, state.pending_s = 0, np.nan
