"""Margins to the limits that act in a run: the least one of each, and the first time at which it was broken.

Each limit has its least margin, limit minus value, with time, value, limit and the largest term of the value. A limit
counts as broken as the part that enforces it counts: the corridor and the closing rate on the truth at once, a
protection level when it has exceeded its alert limit for the time to alert, the age of the last pose when vision
counts as lost, the checks on the estimate when they abort the approach. Corridor, closing rate and levels count up to
an abort, which is part of the cycle that aborts.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.gnc_records import GncHealth
from hil.core.jit import kernel
from hil.core.messages import MAX_PHASES
from hil.gnc import approach_monitor
from hil.gnc.approach_monitor import ACROSS, NOT_ABORTED
from hil.gnc.estimation.integrity import LEVEL_TERMS
from hil.gnc.reactions import HOLD

CORRIDOR, CLOSING, LEVEL, ERROR, CORRIDOR_SEEN, CLOSING_SEEN, VISION_AGE, TRACKING = 0, 1, 2, 5, 8, 9, 10, 11
"""Limits: LEVEL and ERROR are three, along the docking axis, across it, of the attitude; TRACKING six, by axis."""
LIMITS: Final = 17
NO_TERM: Final = 0
NAVIGATION_ERROR, CONTROL_ERROR, PROTECTION_LEVEL = range(1 + LEVEL_TERMS, 4 + LEVEL_TERMS)
"""Terms of a value; those before them are the terms of a protection level, ``LEVEL_TERMS``."""
HEALTH_BITS: Final = len(GncHealth)
VISION_LOST: Final = GncHealth.VISION_LOST.value

LIMITS_PARAMS = np.dtype(
    [
        ("acquisition_s", "f8"),  # from the first estimate, in which the filters may converge
        ("converged_mps", "f8"),  # allowance of the closing rate from which on they have
        ("time_to_alert_s", "f8"),
        ("lost_after_s", "f8"),  # age of the last pose
        ("vision_range", "f8"),  # m, up to which poses are expected
        ("tracks", "i8"),  # 1: the axes are compared with their setpoints
        ("axis_max", "f8", 6),  # m and rad, at rest
        ("axis_per_speed_s", "f8", 6),
    ],
    align=True,
)

LIMITS_STATE = np.dtype(
    [
        ("margin", "f8", LIMITS),  # least, m, m/s, rad, s
        ("at_s", "f8", LIMITS),  # time of the least margin
        ("value", "f8", LIMITS),
        ("limit", "f8", LIMITS),
        ("term", "i8", LIMITS),
        ("broken_s", "f8", LIMITS),  # first time, nan for never
        ("broken_value", "f8", LIMITS),
        ("broken_limit", "f8", LIMITS),
        ("broken_term", "i8", LIMITS),
        ("aborted", "i8"),  # cause, 0 for none
        ("aborted_at_s", "f8"),
        ("counted", "i8"),  # 1: a cycle has been counted
        ("entered", "i8"),  # 1: the truth has been inside the corridor
        ("start_margin", "f8"),  # m, of the corridor in the first cycle
        ("valid_s", "f8"),  # time of the first estimate, nan before
        ("converged", "i8"),  # 1: the filters have converged, as in the reactions
        ("since_s", "f8", 3),  # since when a level exceeds its limit, nan: it does not
        ("pose_s", "f8"),  # cycle of the last pose
        ("phase", "i8"),
        ("phase_s", "f8", MAX_PHASES + 3),  # begin of each phase, nan for never
        ("health", "i8"),  # bits that have been set
        ("health_s", "f8", HEALTH_BITS),  # when each was set first, nan for never
        ("held_s", "f8"),  # begin of the hold or retreat that has not ended, or has become an abort; nan for none
        ("held_health", "i8"),  # bits at its begin
    ],
    align=True,
)


@kernel
def start_limits(state):
    """Initialise the zeroed ``state`` for a run."""
    for k in range(LIMITS):
        state.margin[k], state.broken_s[k] = np.inf, np.nan
    for k in range(MAX_PHASES + 3):
        state.phase_s[k] = np.nan
    for k in range(HEALTH_BITS):
        state.health_s[k] = np.nan
    for k in range(3):
        state.since_s[k] = np.nan
    state.valid_s = state.held_s = np.nan
    state.phase = -1


@kernel
def _take(state, k, t_s, margin, limit, term):
    """Take ``margin`` as the least one of limit ``k``."""
    state.margin[k], state.at_s[k], state.value[k] = margin, t_s, limit - margin
    state.limit[k], state.term[k] = limit, term


@kernel
def note_broken(state, k, t_s, value, limit, term):
    """Take note that limit ``k`` is broken, unless it was before."""
    if math.isnan(state.broken_s[k]):
        state.broken_s[k], state.broken_value[k], state.broken_limit[k] = t_s, value, limit
        state.broken_term[k] = term


@kernel
def _motion_term(now, speed):
    """Return the larger one of navigation and control error, of the position, with ``speed`` of the velocity."""
    error, control = 0.0, 0.0
    for i in range(3):
        if speed:
            seen, true, planned = now.navigation.v_CT_H[i], now.truth.v_CT_H[i], now.reference.v_CT_H[i]
        else:
            seen, true, planned = now.navigation.r_CT_H[i], now.truth.r_CT_H[i], now.reference.r_CT_H[i]
        error += (seen - true) ** 2
        control += (seen - planned) ** 2
    if now.navigation.valid == 0:
        return NO_TERM
    return NAVIGATION_ERROR if error > control else CONTROL_ERROR


@kernel
def _update_security(approach, state, now, from_H, to_H):
    """Update the margins of the truth to corridor and closing rate. from_H, to_H: line of the phase."""
    truth, t_s = now.truth, now.t_s
    corridor = approach_monitor.corridor_margin(approach, from_H, to_H, truth.r_CT_H)
    closing = approach_monitor.closing_margin(approach, truth.r_CT_H, truth.v_CT_H)
    if state.counted == 0:
        state.start_margin = corridor
    enters = corridor >= 0.0 and state.entered == 0  # the corridor counts from the first cycle inside it
    if enters:
        state.entered = 1
    if enters or corridor < state.margin[CORRIDOR]:
        radius = approach_monitor.corridor_radius(approach, approach_monitor.range_of(truth.r_CT_H))
        _take(state, CORRIDOR, t_s, corridor, radius, _motion_term(now, False))
        if corridor < 0.0 and state.entered != 0:
            note_broken(state, CORRIDOR, t_s, radius - corridor, radius, state.term[CORRIDOR])
    if closing < state.margin[CLOSING]:
        allowed = approach_monitor.closing_limit(approach, approach_monitor.range_of(truth.r_CT_H))
        _take(state, CLOSING, t_s, closing, allowed, _motion_term(now, True))
        if closing < 0.0:
            note_broken(state, CLOSING, t_s, allowed - closing, allowed, state.term[CLOSING])


@kernel
def _update_axes(params, state, now):
    """Update the margins of the axes to their setpoints."""
    setpoint, feedback = now.setpoint, now.feedback
    for i in range(3):
        allowed = params.axis_max[i] + params.axis_per_speed_s[i] * abs(setpoint.rail_mps[i])
        margin = allowed - abs(setpoint.rail_m[i] - feedback.rail_m[i])
        if margin < state.margin[TRACKING + i]:
            _take(state, TRACKING + i, now.t_s, margin, allowed, NO_TERM)
        allowed = params.axis_max[3 + i] + params.axis_per_speed_s[3 + i] * abs(setpoint.gimbal_radps[i])
        margin = allowed - abs(setpoint.gimbal_rad[i] - feedback.gimbal_rad[i])
        if margin < state.margin[TRACKING + 3 + i]:
            _take(state, TRACKING + 3 + i, now.t_s, margin, allowed, NO_TERM)


@kernel
def update_motion(params, approach, state, now, from_H, to_H):
    """Update the margins of vehicle and axes in the cycle ``now`` (CYCLE).

    params, state: LIMITS_PARAMS, LIMITS_STATE. approach: APPROACH_MONITOR_PARAMS. from_H, to_H: line of the phase in
    the cycle before, m, which counts in the cycle that aborts.
    """
    reference, supervision, t_s = now.reference, now.supervision, now.t_s
    if reference.phase != state.phase:
        state.phase = reference.phase
        if 0 <= state.phase < MAX_PHASES + 3 and math.isnan(state.phase_s[state.phase]):
            state.phase_s[state.phase] = t_s
    appeared = now.navigation.health & ~state.health
    if appeared != 0:
        state.health |= appeared
        for bit in range(HEALTH_BITS):
            if (appeared >> bit) & 1 != 0:
                state.health_s[bit] = t_s
    if state.aborted == NOT_ABORTED:
        if supervision.aborted == NOT_ABORTED or state.counted == 0:
            _update_security(approach, state, now, reference.from_H, reference.to_H)
        else:
            _update_security(approach, state, now, from_H, to_H)
    if params.tracks != 0 and state.counted != 0:  # the setpoint of the first row is none yet
        _update_axes(params, state, now)


@kernel
def _update_levels(params, approach, state, now):
    """Update the margins of the protection levels; return whether the filters have converged."""
    supervision, t_s = now.supervision, now.t_s
    if state.converged == 0:
        share = approach_monitor.largest_share(supervision.level, supervision.alert_limit)
        if not approach_monitor.has_converged(approach, now.navigation, share, params.converged_mps):
            if t_s - state.valid_s <= params.acquisition_s:
                return False
        else:
            state.converged = 1
    for i in range(3):
        margin = supervision.alert_limit[i] - supervision.level[i]
        if margin < state.margin[LEVEL + i]:
            _take(state, LEVEL + i, t_s, margin, supervision.alert_limit[i], supervision.level_term)
        if not margin < 0.0:
            state.since_s[i] = np.nan
            continue
        if math.isnan(state.since_s[i]):
            state.since_s[i] = t_s
        if t_s - state.since_s[i] >= params.time_to_alert_s:
            note_broken(state, LEVEL + i, t_s, supervision.level[i], supervision.alert_limit[i], supervision.level_term)
    return True


@kernel
def _update_checks(approach, state, now):
    """Update the margins of the estimate, with what it may be wrong by, to corridor and closing rate."""
    supervision, estimate, t_s = now.supervision, now.navigation, now.t_s
    off = supervision.level[ACROSS] if 0.0 < supervision.level[ACROSS] < np.inf else 0.0
    off_mps = approach.confidence * approach_monitor.largest_sigma(estimate.sigma_v_mps)
    corridor, closing = supervision.corridor_margin_m - off, supervision.closing_margin_mps - off_mps
    if corridor < state.margin[CORRIDOR_SEEN]:
        radius = approach_monitor.corridor_radius(approach, approach_monitor.range_of(estimate.r_CT_H))
        term = PROTECTION_LEVEL if off > radius - supervision.corridor_margin_m else CONTROL_ERROR
        _take(state, CORRIDOR_SEEN, t_s, corridor, radius, term)
    if closing < state.margin[CLOSING_SEEN]:
        allowed = approach_monitor.closing_limit(approach, approach_monitor.range_of(estimate.r_CT_H))
        _take(state, CLOSING_SEEN, t_s, closing, allowed, _motion_term(now, True))
    if supervision.aborted == approach_monitor.CORRIDOR:
        radius = approach_monitor.corridor_radius(approach, approach_monitor.range_of(estimate.r_CT_H))
        term = PROTECTION_LEVEL if off > radius - supervision.corridor_margin_m else CONTROL_ERROR
        note_broken(state, CORRIDOR_SEEN, t_s, radius - corridor, radius, term)
    elif supervision.aborted == approach_monitor.CLOSING_RATE:
        allowed = approach_monitor.closing_limit(approach, approach_monitor.range_of(estimate.r_CT_H))
        note_broken(state, CLOSING_SEEN, t_s, allowed - closing, allowed, _motion_term(now, True))


@kernel
def update_estimate(params, approach, state, now, errors, limits):
    """Update the margins of the estimate. errors, limits: (3,), its errors and their alert limits on the truth.

    Other arguments: see ``update_motion``, which is called before.
    """
    t_s = now.t_s
    if math.isnan(state.valid_s):
        state.valid_s = state.pose_s = t_s
    if now.pose.fresh > 0 or approach_monitor.range_of(now.navigation.r_CT_H) > params.vision_range:
        state.pose_s = t_s
    margin = params.lost_after_s - (t_s - state.pose_s)
    if margin < state.margin[VISION_AGE]:
        _take(state, VISION_AGE, t_s, margin, params.lost_after_s, NO_TERM)
        if margin < 0.0 and (now.navigation.health & VISION_LOST) != 0 and state.aborted == NOT_ABORTED:
            note_broken(state, VISION_AGE, t_s, t_s - state.pose_s, params.lost_after_s, NO_TERM)
    for i in range(3):
        margin = limits[i] - errors[i]
        if margin < state.margin[ERROR + i]:
            _take(state, ERROR + i, t_s, margin, limits[i], NO_TERM)
    if state.aborted == NOT_ABORTED and _update_levels(params, approach, state, now):
        _update_checks(approach, state, now)


@kernel
def end_cycle(state, now):
    """Take note of a hold or an abort, at the end of the cycle that counts it."""
    state.counted = 1
    if now.supervision.aborted == NOT_ABORTED:
        if now.supervision.reaction < HOLD:
            state.held_s = np.nan
        elif math.isnan(state.held_s):
            state.held_s, state.held_health = now.t_s, now.navigation.health
    if state.aborted == NOT_ABORTED and now.supervision.aborted != NOT_ABORTED:
        state.aborted, state.aborted_at_s = now.supervision.aborted, now.supervision.aborted_at_s
