"""Reactions of the approach to the health of the navigation: continue, coast, hold, retreat, abort, by kind of phase.

A hold brakes and stays, a retreat brakes and goes back along the docking axis; both end when their cause does, and the
approach is resumed with its last moving phase. One that lasts too long becomes an abort, which is final.
"""

from __future__ import annotations

import numpy as np

from hil.core.gnc_records import GncHealth
from hil.core.jit import kernel
from hil.gnc import approach_monitor, guidance
from hil.gnc.approach_monitor import (
    ALONG,
    ATTITUDE,
    BENCH_DISAGREES,
    BREAK,
    CORRIDOR,
    FIRST_BITS,
    FIRST_HEALTH_CAUSE,
    HELD_TOO_LONG,
    NOT_ABORTED,
    UNPROTECTED,
)
from hil.gnc.estimation.integrity import LEVEL_TERMS

CONTINUE, COAST, HOLD, RETREAT, ABORT = range(5)
HEALTH_BITS = len(GncHealth)
CONDITIONS = HEALTH_BITS + 1  # the last one: the protection level exceeds the alert limit
KINDS = 6  # kinds of phases
_TWO_HOLDS_S = 60.0  # in which no more than two begin

REACTION_PARAMS = np.dtype(
    [
        ("table", "i8", (CONDITIONS, KINDS)),
        ("time_to_alert_s", "f8"),  # for which the protection level may exceed its limit
        ("acquisition_s", "f8"),  # from the first pose, in which the navigation may converge
        ("converged_mps", "f8"),  # allowance of the closing rate from which on it has
        ("hold_max_s", "f8"),  # longest hold or retreat
        ("coast_share", "f8"),  # fraction of an alert limit up to which the approach continues without vision
    ],
    align=True,
)

REACTION_STATE = np.dtype(
    [
        ("converged", "i8"),  # 1: limits are tested with the protection level added
        ("valid_since_s", "f8"),  # first time of a valid estimate, 0 before
        ("unprotected_since_s", "f8"),  # 0: the protection level is within its limit
        ("held", "i8"),  # HOLD or RETREAT while one lasts
        ("held_since_s", "f8"),
        ("held_phase", "i8"),  # in which it began
        ("before_s", "f8"),  # when the one before began
        ("entered", "i8"),  # 1: the approach has begun: the filters have converged
        ("outside", "i8"),  # 1: the approach begins outside or far from its plan, and has not stopped yet
        ("share", "f8"),  # largest protection level over its alert limit
        ("beyond", "i8"),  # 1: it exceeds the limit
        ("level", "f8", 3),  # protection levels along the docking axis, across it, m, of the attitude, rad ...
        ("limit", "f8", 3),  # ... with their alert limits
        ("terms", "f8", (LEVEL_TERMS, 3)),  # m, of the levels of x, y, z, 0 if the navigation does not give them
        ("from_future", "i8"),  # poses so far that were stamped ahead of the loop
        ("hypothesis", "i8"),  # of innovations whose cause is not known, see ``estimation.hypotheses``
        ("half_swing_s", "f8"),  # of a chaser that swings
        ("broken", BREAK),  # of corridor or closing rate, m, m/s
    ],
    align=True,
)


@kernel
def acquire(params, monitor, state, t_s, estimate):
    """Take note whether the navigation has converged, and since when it is not protected."""
    share = approach_monitor.level_share(monitor, estimate, state.level, state.limit)
    is_within = share <= 1.0
    # one without a level does not continue without vision
    state.share = share if estimate.protection_level_m[0] >= 0.0 else np.inf
    if state.valid_since_s == 0.0:
        state.valid_since_s = t_s + 1e-9
    state.beyond = 0 if is_within else 1
    if state.converged == 0 and approach_monitor.has_converged(monitor, estimate, share, params.converged_mps):
        state.converged = 1
    waits = state.converged == 0 and t_s - state.valid_since_s <= params.acquisition_s
    if is_within or waits:
        state.unprotected_since_s = 0.0
    elif state.unprotected_since_s == 0.0:
        state.unprotected_since_s = t_s + 1e-9


@kernel
def write_level(monitor, state, estimate, supervision):
    """Write levels, alert limits and the largest term of the level that is nearest its limit into ``supervision``.

    supervision: SUPERVISION. The term is the component with the largest part in the level.
    """
    worst, largest = 0, 0.0
    for i in range(3):
        supervision.level[i], supervision.alert_limit[i] = state.level[i], state.limit[i]
        if state.level[i] > largest * state.limit[i]:
            worst, largest = i, state.level[i] / state.limit[i] if state.limit[i] > 0.0 else np.inf
    supervision.level_term, supervision.level_term_m = 0, np.nan
    if not largest > 0.0:
        return
    axis, part = 0, 0.0
    for i in range(3):
        share = abs(monitor.axis[i]) if worst == ALONG else 1.0 - monitor.axis[i] ** 2
        size = estimate.sigma_attitude_rad[i] if worst == ATTITUDE else share * estimate.protection_level_m[i]
        if size > part:
            axis, part = i, size
    if worst == ATTITUDE:
        noise = monitor.level_sigmas * part
        noisy = noise >= 0.5 * state.level[ATTITUDE]
        supervision.level_term, supervision.level_term_m = (1, noise) if noisy else (2, state.level[ATTITUDE] - noise)
        return
    term = 0.0
    for k in range(LEVEL_TERMS):
        if state.terms[k, axis] > term:
            term = state.terms[k, axis]
            supervision.level_term, supervision.level_term_m = k + 1, term


@kernel
def cause_of(condition):
    """Return the cause of an abort for a condition: a bit of health, or after these the protection level."""
    if condition == HEALTH_BITS:
        return UNPROTECTED
    if condition >= FIRST_BITS:
        return BENCH_DISAGREES + condition - FIRST_BITS
    return FIRST_HEALTH_CAUSE + condition


@kernel
def _wanted(params, state, kind, t_s, health, cause):
    """Return the strongest reaction in a phase of ``kind``; write its cause to ``cause`` (1,)."""
    strongest = CONTINUE
    if state.outside != 0:
        cause[0] = CORRIDOR
        strongest = HOLD
    elif health == 0 and state.unprotected_since_s == 0.0:
        return strongest
    for condition in range(CONDITIONS):
        if condition < HEALTH_BITS:
            applies = (health >> condition) & 1 != 0
            if condition == 0:  # vision is lost
                applies = applies and state.share > params.coast_share
        else:
            since_s = state.unprotected_since_s
            applies = since_s != 0.0 and t_s - since_s >= params.time_to_alert_s
        if applies and params.table[condition, kind] > strongest:
            strongest = params.table[condition, kind]
            cause[0] = cause_of(condition)
    return strongest


@kernel
def _leave(params, state, t_s, estimate, distance):
    """Brake from the estimate; retreat to ``distance``, m, if that is farther out."""
    guidance.start_abort(params, state, t_s, estimate.r_CT_H, estimate.v_CT_H)
    state.abort_range = distance


@kernel
def _abort(params, state, t_s, estimate, cause, supervision):
    guidance.start_abort(params, state, t_s, estimate.r_CT_H, estimate.v_CT_H)
    supervision.aborted = cause
    supervision.aborted_at_s = t_s
    supervision.reaction = ABORT


@kernel
def _may_resume(guidance_params, state, guidance_state, t_s):
    """Return whether a hold whose cause has ended may end: at rest, and with no more than two holds in a minute."""
    return guidance.is_at_rest(guidance_params, guidance_state) and t_s - state.before_s >= _TWO_HOLDS_S


@kernel
def react(params, guidance_params, state, guidance_state, t_s, estimate, reference, supervision, cause):
    """React to the health of ``estimate`` (NAVIGATION): write ``reaction`` and abort of ``supervision`` (SUPERVISION).

    params, state: REACTION_PARAMS, REACTION_STATE. guidance_params, guidance_state: GUIDANCE_PARAMS, GUIDANCE_STATE.
    cause: (1,), receives the cause of the reaction. Before the first estimate nothing can be left.
    """
    if supervision.aborted != NOT_ABORTED:
        supervision.reaction = ABORT
        state.held = 0
        cause[0] = supervision.aborted
        return
    phase = state.held_phase if state.held != 0 else guidance_state.phase
    kind = guidance.kind_of(guidance_params, phase)
    cause[0] = NOT_ABORTED
    reaction = _wanted(params, state, kind, t_s, estimate.health, cause)
    supervision.reaction = reaction
    if estimate.valid == 0:
        return
    if reaction == ABORT:
        _abort(guidance_params, guidance_state, t_s, estimate, cause[0], supervision)
    elif reaction >= HOLD and reaction > state.held:
        state.outside = 0
        if state.held == 0:
            state.before_s = state.held_since_s if state.held_since_s > 0.0 else -np.inf
            state.held_since_s, state.held_phase = t_s, phase
        state.held = reaction
        distance = guidance_params.abort_distance if reaction == RETREAT else 0.0
        _leave(guidance_params, guidance_state, t_s, estimate, distance)
    elif state.held != 0 and reaction >= HOLD and t_s - state.held_since_s > params.hold_max_s:
        cause[0] = HELD_TOO_LONG
        _abort(guidance_params, guidance_state, t_s, estimate, HELD_TOO_LONG, supervision)
    elif state.held != 0 and reaction < HOLD and _may_resume(guidance_params, state, guidance_state, t_s):
        state.held = 0
        guidance.resume(guidance_params, guidance_state, t_s, state.held_phase)
    else:
        supervision.reaction = max(reaction, state.held)
        return
    if state.held != 0:
        supervision.reaction = max(reaction, state.held)
    guidance.reference(guidance_params, guidance_state, t_s, reference)
