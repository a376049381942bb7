"""Integrity of the navigation, judged on the truth: error against alert limit and protection level in each cycle.

Alert limit: largest error that must not stay unnoticed, along the docking axis, across it, and of the attitude. The
estimate is *misleading* in a cycle if its error is beyond an alert limit, the protection level that it reports is below
that limit, and neither health, reaction nor abort indicate it; cycles in which that has lasted longer than the time
to alert count as hazardously misleading information (RTCA DO-229). Alarms of the bench, which has the truth, do not
count here.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.gnc_records import GncHealth
from hil.core.jit import kernel
from hil.core.messages import MAX_FAULTS
from hil.gnc.approach_monitor import (
    ACROSS,
    ALONG,
    APPROACH_MONITOR_PARAMS,
    ATTITUDE,
    ORDERED,
    alert_limits,
    closing_margin,
    corridor_margin,
    protection_levels,
)
from hil.gnc.decision_verdict import DECISION_PARAMS, DECISION_STATE, start_decision, update_decision
from hil.gnc.limits import (
    ERROR,
    LIMITS_PARAMS,
    LIMITS_STATE,
    NO_TERM,
    end_cycle,
    note_broken,
    start_limits,
    update_estimate,
    update_motion,
)
from hil.gnc.reactions import ABORT, HOLD
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill

FAULTS_MAX = 5 * MAX_FAULTS
MONITOR_DISAGREES = GncHealth.MONITOR_DISAGREES.value

INTEGRITY_PARAMS = np.dtype(
    [
        ("approach", APPROACH_MONITOR_PARAMS),  # with the alert limits
        ("time_to_alert_s", "f8"),
        ("decision", DECISION_PARAMS),
        ("limits", LIMITS_PARAMS),
        ("faults", "i8"),
        ("fault_at_s", "f8", FAULTS_MAX),
    ],
    align=True,
)

INTEGRITY_STATE = np.dtype(
    [
        ("decision", DECISION_STATE),
        ("limits", LIMITS_STATE),
        ("judged", "i8"),  # cycles with an estimate, without fault and abort
        ("available", "i8"),  # cycles with all protection levels below their alert limits
        ("reported", "i8"),  # 1: a protection level was reported
        ("misleading_s", "f8"),  # since when; nan: the last cycle was not
        ("misleading_by_line1_s", "f8"),  # the same, if the second sensor does not count
        ("hmi_cycles", "i8"),
        ("hmi_by_line1_only", "i8"),
        ("unnoticed_s", "f8"),  # since when an error is beyond its alert limit without an alarm
        ("longest_unnoticed_s", "f8"),
        ("worst_share", "f8"),  # largest position error over its alert limit ...
        ("worst_error", "f8"),  # ... m, with its limit and the protection levels of that cycle
        ("worst_limit", "f8"),
        ("worst_level", "f8", 3),
        ("worst_bound", "f8"),  # m, protection level of the same direction as that error
        ("false_alerts", "i8"),
        ("nearest", "f8"),  # m
        ("nearest_s", "f8"),
        ("ended", "i8"),  # 1: the last cycle was one of a hold, retreat or abort
        ("from_H", "f8", 3),  # line of the cycle before
        ("to_H", "f8", 3),
        ("health_before", "i8", FAULTS_MAX),  # health before the onset of each fault
        ("reaction_before", "i8", FAULTS_MAX),
        ("detected_s", "f8", FAULTS_MAX),  # nan: not by the navigation
        ("detected_health", "i8", FAULTS_MAX),  # its new bits
        ("reacted_s", "f8", FAULTS_MAX),
        ("reaction", "i8", FAULTS_MAX),
    ],
    align=True,
)


@kernel
def start_integrity(state):
    """Initialise the zeroed ``state`` for a run."""
    start_decision(state.decision)
    start_limits(state.limits)
    state.misleading_s = state.misleading_by_line1_s = state.unnoticed_s = np.nan
    state.nearest = np.inf
    fill(state.worst_level, np.nan)
    state.worst_bound = np.nan
    fill(state.detected_s, np.nan)
    fill(state.reacted_s, np.nan)


@kernel
def _errors(params, truth, estimate, errors):
    """Write the errors (3,) of ``estimate`` (NAVIGATION) against ``truth`` (TRUTH) in the order of ``alert_limits``.

    Returns the square of the last, rad^2.
    """
    rotation = stack.vector(3)
    along, square, turned = 0.0, 0.0, 0.0
    quat.rotation_between(truth.q_CH, estimate.q_CH, rotation)
    for i in range(3):
        error = truth.r_CT_H[i] - estimate.r_CT_H[i]
        along += error * params.axis[i]
        square += error * error
        turned += rotation[i] * rotation[i]
    errors[ALONG], errors[ACROSS] = abs(along), math.sqrt(max(0.0, square - along * along))
    errors[ATTITUDE] = math.sqrt(turned)
    return turned


@kernel
def _longer(since_s, t_s, applies):
    """Return since when a condition applies, nan if it does not."""
    if not applies:
        return np.nan
    return t_s if math.isnan(since_s) else since_s


@kernel
def _count_alert(params, state, now, beyond, may_be_false):
    """Count a reaction that ends the approach although truth and estimate are within every limit."""
    supervision = now.supervision
    ends = supervision.reaction >= HOLD or (supervision.aborted != 0 and supervision.aborted != ORDERED)
    if ends and state.ended == 0 and may_be_false and not beyond:
        inside = (
            corridor_margin(params.approach, state.from_H, state.to_H, now.truth.r_CT_H) >= 0.0
            and closing_margin(params.approach, now.truth.r_CT_H, now.truth.v_CT_H) >= 0.0
            and supervision.corridor_margin_m >= 0.0
            and supervision.closing_margin_mps >= 0.0
        )
        state.false_alerts += 1 if inside else 0
    state.ended = 1 if ends else 0
    copy_into(state.from_H, now.reference.from_H)
    copy_into(state.to_H, now.reference.to_H)


@kernel
def _detect(params, state, now):
    """Write the first sign of the navigation, and the first reaction, after the onset of each fault."""
    supervision, health = now.supervision, now.navigation.health
    aborted = supervision.aborted != 0 and supervision.aborted != ORDERED
    reaction = ABORT if aborted else supervision.reaction
    for k in range(params.faults):
        if now.t_s < params.fault_at_s[k]:
            state.health_before[k], state.reaction_before[k] = health, reaction
            continue
        reacts = reaction > state.reaction_before[k]
        if math.isnan(state.detected_s[k]) and (reacts or (health & ~state.health_before[k]) != 0):
            state.detected_s[k], state.detected_health[k] = now.t_s, health & ~state.health_before[k]
        if math.isnan(state.reacted_s[k]) and reacts:
            state.reacted_s[k], state.reaction[k] = now.t_s, reaction


@kernel
def update_integrity(params, state, now):
    """Judge the cycle ``now`` (CYCLE)."""
    errors, levels, limits = stack.vector(3), stack.vector(3), stack.vector(3)
    square = 0.0
    for i in range(3):
        square += now.truth.r_CT_H[i] ** 2
    distance = math.sqrt(square)
    if distance < state.nearest:
        state.nearest, state.nearest_s = distance, now.t_s
    _detect(params, state, now)
    turned = 0.0
    if now.navigation.valid != 0:
        turned = _errors(params.approach, now.truth, now.navigation, errors)
    update_decision(params.decision, state.decision, now, turned)
    update_motion(params.limits, params.approach, state.limits, now, state.from_H, state.to_H)
    if now.navigation.valid == 0:
        end_cycle(state.limits, now)
        copy_into(state.from_H, now.reference.from_H)
        copy_into(state.to_H, now.reference.to_H)
        return
    alert_limits(params.approach, now.truth.r_CT_H, now.truth.v_CT_H, now.truth.q_CH, limits)
    protection_levels(params.approach, now.navigation, levels)
    update_estimate(params.limits, params.approach, state.limits, now, errors, limits)
    end_cycle(state.limits, now)
    beyond, misled, available = False, False, True
    for i in range(3):
        is_beyond, is_below = not errors[i] <= limits[i], levels[i] < limits[i]
        beyond = beyond or is_beyond
        misled = misled or (is_beyond and is_below)
        available = available and is_below
        if not math.isnan(levels[i]):
            state.reported = 1
    health, reaction, aborted = now.navigation.health, now.supervision.reaction, now.supervision.aborted
    noticed = health != 0 or reaction != 0 or aborted != 0
    noticed_by_line1 = noticed and health != MONITOR_DISAGREES
    state.misleading_s = _longer(state.misleading_s, now.t_s, misled and not noticed)
    state.misleading_by_line1_s = _longer(state.misleading_by_line1_s, now.t_s, misled and not noticed_by_line1)
    state.unnoticed_s = _longer(state.unnoticed_s, now.t_s, beyond and not noticed)
    if now.t_s - state.misleading_s > params.time_to_alert_s:
        state.hmi_cycles += 1
        for i in range(3):
            if not errors[i] <= limits[i]:
                note_broken(state.limits, ERROR + i, now.t_s, errors[i], limits[i], NO_TERM)
    if now.t_s - state.misleading_by_line1_s > params.time_to_alert_s:
        state.hmi_by_line1_only += 1
    if now.t_s - state.unnoticed_s > state.longest_unnoticed_s:
        state.longest_unnoticed_s = now.t_s - state.unnoticed_s
    worse = ALONG if errors[ALONG] * limits[ACROSS] >= errors[ACROSS] * limits[ALONG] else ACROSS
    share = errors[worse] / limits[worse] if limits[worse] > 0.0 else np.inf
    if share > state.worst_share:
        state.worst_share, state.worst_error, state.worst_limit = share, errors[worse], limits[worse]
        copy_into(state.worst_level, now.navigation.protection_level_m)
        state.worst_bound = levels[worse]
    faultless = True
    for k in range(params.faults):
        faultless = faultless and now.t_s < params.fault_at_s[k]
    if faultless and aborted == 0:
        state.judged += 1
        state.available += 1 if available else 0
    _count_alert(params, state, now, beyond, faultless)


@kernel
def stanford(params, rows, errors, levels, limits):
    """Write errors, protection levels and alert limits (n, 3) of each of ``rows`` (n,) of CYCLE."""
    for k in range(rows.shape[0]):
        truth = rows[k].truth
        alert_limits(params.approach, truth.r_CT_H, truth.v_CT_H, truth.q_CH, limits[k])
        protection_levels(params.approach, rows[k].navigation, levels[k])
        _errors(params.approach, truth, rows[k].navigation, errors[k])
