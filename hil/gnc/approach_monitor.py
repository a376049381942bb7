"""Approach monitor: checks corridor, closing rate and ready state, and starts an abort.

The corridor surrounds the line of the present phase: its radius is a fraction of the range (a cone with
its tip in the target's reference point), but never less than a minimum. The closing rate may be
``closing_floor`` at the ready point's range and nearer, and grows with range up to ``closing_greatest``.

In the loop both are checked on the estimate, with what it may be wrong by added: the protection level to the position,
``confidence`` standard deviations to the closing rate. The less is known, the less is permitted. A limit counts as
broken when it is exceeded for ``persistence`` consecutive cycles. While the filters converge after the first pose, for
a limited time, it has to be exceeded by ``confidence`` standard deviations instead. The same margins on the truth,
without allowance, are part of the verdict after the run.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.gnc import docking_go, guidance
from hil.maths import stack
from hil.maths.arrays import copy_into
from hil.models.bodies import BODIES, are_apart, chord, clearance

NOT_ABORTED, CORRIDOR, CLOSING_RATE, ORDERED = range(4)
FIRST_HEALTH_CAUSE = 4
"""Cause of an abort for the first bit of ``hil_gnc_health``; the others follow."""
UNPROTECTED, HELD_TOO_LONG, BENCH_DISAGREES, SENSOR_SUSPECT, CAUSE_UNKNOWN = 10, 11, 12, 13, 14
FIRST_BITS = UNPROTECTED - FIRST_HEALTH_CAUSE
"""Bits of health whose causes follow ``FIRST_HEALTH_CAUSE``; those of further bits follow ``HELD_TOO_LONG``."""
_CONVERGED_SHARE = 0.85  # of an alert limit
_ROOT_2 = math.sqrt(2.0)
_FAR = 0.6  # of the corridor's radius, from the plan at the start
ALONG, ACROSS, ATTITUDE = range(3)
"""Alert limits and protection levels: along the docking axis, across it, of the attitude."""

BREAK = np.dtype([("value", "f8"), ("limit", "f8")], align=True)
"""Value of a quantity that has broken its limit, and the limit."""

APPROACH_MONITOR_PARAMS = np.dtype(
    [
        ("cone", "f8"),  # tangent of the corridor's half angle
        ("minimum_radius", "f8"),  # m
        ("closing_floor", "f8"),  # m/s
        ("closing_slope", "f8"),  # 1/s
        ("closing_greatest", "f8"),  # m/s
        ("floor_range", "f8"),  # m
        ("confidence", "f8"),  # standard deviations
        ("persistence", "i8"),  # cycles
        ("abort_at_s", "f8"),  # time of the run, inf for never
        # alert limits: largest protection levels
        ("axis", "f8", 3),  # docking axis, unit vector in H
        ("alert_distance", "f8"),  # m, along the axis at range 0
        ("alert_slope", "f8"),  # its increase with range
        ("keep_out", "f8"),  # m, range that the chaser must be able to stop before, whatever the error; 0 for none
        ("brake", "f8"),  # m/s^2, of an abort
        ("chaser", BODIES),  # in c about the chaser's reference point
        ("target", BODIES),  # in H about the target's
        ("distance", "f8"),  # m, least one between bodies of both
        ("alert_turn", "f8"),  # m, by which an attitude error within its alert limit moves a body of the chaser at most
        ("alert_corridor", "f8"),  # across the axis, fraction of the corridor's radius
        ("alert_angle", "f8"),  # rad
        # ready state: largest deviations (Table III)
        ("ready_point", "f8", 3),  # m, in H
        ("ready_distance", "f8", 3),  # m
        ("ready_rate", "f8", 3),  # m/s
        ("ready_angle", "f8"),  # rad
        ("ready_angular_rate", "f8"),  # rad/s
        ("level_sigmas", "f8"),  # K of a component's level
        ("across_sigmas", "f8"),  # of the level of two components
        ("across_share", "f8"),  # of what else is in a component's level, of two components
        ("go_sigmas", "f8"),  # of an estimate without a level of its own
        ("go_fraction", "f8"),  # of the tolerances within which the encoders must be
        ("dwell_s", "f8"),  # for which the ready state must have held for docking to be a go
    ],
    align=True,
)


@kernel
def corridor_radius(params, distance):
    """Return the radius of the corridor, m, at the range ``distance``, m."""
    return max(params.minimum_radius, params.cone * distance)


@kernel
def corridor_margin(params, from_H, to_H, r_CT_H):
    """Return how far, m, ``r_CT_H`` is inside the corridor about the line ``from_H`` to ``to_H``; negative outside."""
    square = 0.0
    along = 0.0
    for i in range(3):
        step = to_H[i] - from_H[i]
        square += step * step
        along += step * (r_CT_H[i] - from_H[i])
    fraction = min(1.0, max(0.0, along / square)) if square > 0.0 else 0.0
    off = 0.0
    distance = 0.0
    for i in range(3):
        off += (r_CT_H[i] - from_H[i] - fraction * (to_H[i] - from_H[i])) ** 2
        distance += r_CT_H[i] ** 2
    return corridor_radius(params, math.sqrt(distance)) - math.sqrt(off)


@kernel
def closing_limit(params, distance):
    """Return the greatest closing rate, m/s, at the range ``distance``, m."""
    allowed = params.closing_floor + params.closing_slope * max(0.0, distance - params.floor_range)
    return min(params.closing_greatest, allowed)


@kernel
def closing_margin(params, r_CT_H, v_CT_H):
    """Return allowed minus actual closing rate, m/s; negative if the range falls too fast."""
    square = 0.0
    product = 0.0
    for i in range(3):
        square += r_CT_H[i] ** 2
        product += r_CT_H[i] * v_CT_H[i]
    distance = math.sqrt(square)
    rate = product / distance if distance > 0.0 else 0.0
    return closing_limit(params, distance) + rate


@kernel
def range_of(r_CT_H):
    """Return the distance from the target, m."""
    return math.sqrt(r_CT_H[0] ** 2 + r_CT_H[1] ** 2 + r_CT_H[2] ** 2)


@kernel
def largest_sigma(sigma):
    """Return the largest of ``sigma`` (3,), 0 if they are unknown (nan)."""
    largest = 0.0
    for i in range(3):
        if sigma[i] > largest:
            largest = sigma[i]
    return largest


@kernel
def alert_limits(params, r_CT_H, v_CT_H, q_CH, limits):
    """Write the alert limits ``limits`` (3,): along the docking axis, across it, m, and of the attitude, rad.

    Along: a base that grows with range, at most what is left to the keep-out after braking from the closing rate. Along
    and across, together, at most what is left between the bodies of chaser and target.
    """
    square, product = 0.0, 0.0
    for i in range(3):
        square += r_CT_H[i] * r_CT_H[i]
        product += r_CT_H[i] * v_CT_H[i]
    distance = math.sqrt(square)
    along = params.alert_distance + params.alert_slope * distance
    if params.keep_out > 0.0:
        closing = max(0.0, -product / distance) if distance > 0.0 else 0.0
        along = max(0.0, min(along, distance - params.keep_out - closing * closing / (2.0 * params.brake)))
    limits[ALONG] = along
    limits[ACROSS] = params.alert_corridor * corridor_radius(params, distance)
    reserve, speed = params.distance + params.alert_turn, abs(v_CT_H[0]) + abs(v_CT_H[1]) + abs(v_CT_H[2])
    enough = _ROOT_2 * max(limits[ALONG], limits[ACROSS]) + reserve
    if not are_apart(params.chaser, r_CT_H, chord(q_CH), params.target, enough + speed * speed / (2.0 * params.brake)):
        closest = stack.vector(4)
        gap = clearance(
            params.chaser, r_CT_H, q_CH, v_CT_H, 0.0, params.target, 0.0, params.brake, 1.0, enough, closest
        )  # fmt: skip
        each = max(0.0, gap - reserve) / _ROOT_2
        limits[ALONG], limits[ACROSS] = min(limits[ALONG], each), min(limits[ACROSS], each)
    limits[ATTITUDE] = params.alert_angle


@kernel
def protection_levels(params, estimate, levels):
    """Write the protection levels of ``estimate`` in the order of ``alert_limits``, nan if it reports none.

    Across the axis an error has two components: without a fault its length is beyond K2 sigma with the same
    probability as one component is beyond K sigma, K2 = sqrt(-2 ln p); what else is in the levels adds to it.
    """
    along, across, sigma, rest = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        part, level = abs(params.axis[i]), estimate.protection_level_m[i]
        if part > 0.0:  # a level may be infinite
            along += part * level
        if part < 1.0:
            share = 1.0 - part * part
            across += share * level * level
            sigma = max(sigma, share * estimate.sigma_r_m[i] ** 2)
            rest = max(rest, share * max(0.0, level - params.level_sigmas * estimate.sigma_r_m[i]) ** 2)
    across = math.sqrt(across)
    if sigma > 0.0:
        across = min(across, params.across_sigmas * math.sqrt(sigma) + params.across_share * math.sqrt(rest))
    levels[ALONG], levels[ACROSS], levels[ATTITUDE] = along, across, estimate.protection_level_rad


@kernel
def level_share(params, estimate, levels, limits):
    """Return the largest of the protection levels of ``estimate`` over its alert limit, 0 if it reports none.

    levels, limits: (3,), written.
    """
    alert_limits(params, estimate.r_CT_H, estimate.v_CT_H, estimate.q_CH, limits)
    protection_levels(params, estimate, levels)
    return largest_share(levels, limits)


@kernel
def largest_share(levels, limits):
    """Return the largest of ``levels`` (3,) over its limit, inf over a limit of 0; 0 if none is positive."""
    share = 0.0
    for i in range(3):
        if levels[i] > limits[i]:  # the limit may be 0
            share = max(share, levels[i] / limits[i] if limits[i] > 0.0 else np.inf)
        elif levels[i] > 0.0:
            share = max(share, levels[i] / limits[i])
    return share


@kernel
def has_converged(params, estimate, share, converged_mps):
    """Return whether the filters have converged: level over limit ``share``, allowance of the closing rate, m/s."""
    # the level rises a little while the filters have few poses
    return share <= _CONVERGED_SHARE and params.confidence * largest_sigma(estimate.sigma_v_mps) <= converged_mps


@kernel
def _enter(params, estimate, reference, reactions, supervision):
    """Take note, once the filters have converged, whether the approach begins inside the corridor and near its plan.

    Otherwise it is ``outside``: the approach stops and is planned again from there.
    """
    square, distance = 0.0, 0.0
    for i in range(3):
        square += (estimate.r_CT_H[i] - reference.r_CT_H[i]) ** 2
        distance += estimate.r_CT_H[i] ** 2
    far = math.sqrt(square) > _FAR * corridor_radius(params, math.sqrt(distance))
    reactions.entered = 1
    if far or supervision.corridor_margin_m < 0.0:
        reactions.outside = 1


@kernel
def check(params, t_s, estimate, reference, ordered, reactions, go, supervision):
    """Check the estimate (NAVIGATION); write ``supervision`` (SUPERVISION). Return whether an abort has to begin now.

    ordered: 1 if the operator has ordered an abort. reactions: REACTION_STATE. go: GO_CHECK. Before the first
    pose nothing is checked; after an abort the margins are still written, but have no effect. An estimate without
    protection level and sigma is taken as it is.
    """
    if estimate.valid == 0:
        supervision.ready_since_s = np.nan
        go.given = 0
        return False
    supervision.corridor_margin_m = corridor_margin(params, reference.from_H, reference.to_H, estimate.r_CT_H)
    supervision.closing_margin_mps = closing_margin(params, estimate.r_CT_H, estimate.v_CT_H)
    docking_go.update(params, t_s, estimate, reactions.beyond, go, supervision)
    if supervision.aborted != NOT_ABORTED:
        return False
    cause = NOT_ABORTED
    across = reactions.level[ACROSS]
    off = across if 0.0 < across < np.inf else 0.0  # one without a bound has its own reaction
    off_mps = params.confidence * largest_sigma(estimate.sigma_v_mps)
    if reactions.converged == 0:
        off, off_mps = -params.confidence * largest_sigma(estimate.sigma_r_m), -off_mps
    elif reactions.entered == 0:
        _enter(params, estimate, reference, reactions, supervision)
    if supervision.corridor_margin_m < off and reactions.entered != 0 and reactions.outside == 0:
        cause = CORRIDOR
        reactions.broken.limit = corridor_radius(params, range_of(estimate.r_CT_H))
        reactions.broken.value = reactions.broken.limit - supervision.corridor_margin_m + off
    elif supervision.closing_margin_mps < off_mps:
        cause = CLOSING_RATE
        reactions.broken.limit = closing_limit(params, range_of(estimate.r_CT_H))
        reactions.broken.value = reactions.broken.limit - supervision.closing_margin_mps + off_mps
    supervision.broken_cycles = supervision.broken_cycles + 1 if cause != NOT_ABORTED else 0
    if ordered != 0 or t_s >= params.abort_at_s:
        cause = ORDERED
    elif supervision.broken_cycles < params.persistence:
        return False
    supervision.aborted = cause
    supervision.aborted_at_s = t_s
    return True


@kernel
def update(params, guidance_params, guidance_state, t_s, estimate, reference, ordered, reactions, go, supervision):
    """Check the estimate; if an abort has to begin, start it in ``guidance_state`` and in ``reference``.

    guidance_params, guidance_state: GUIDANCE_PARAMS, GUIDANCE_STATE. Other arguments: see ``check``.
    """
    if check(params, t_s, estimate, reference, ordered, reactions, go, supervision):
        guidance.start_abort(guidance_params, guidance_state, t_s, estimate.r_CT_H, estimate.v_CT_H)
        guidance.reference(guidance_params, guidance_state, t_s, reference)


@kernel
def abort_from_reference(params, guidance_params, guidance_state, t_s, reference, ordered, supervision):
    """Start an ordered abort from the reference, without an estimate. Arguments: see ``update``."""
    supervision.corridor_margin_m = supervision.closing_margin_mps = np.nan
    if supervision.aborted != NOT_ABORTED or not (ordered != 0 or t_s >= params.abort_at_s):
        return
    supervision.aborted = ORDERED
    supervision.aborted_at_s = t_s
    from_H, speed_H = stack.vector(3), stack.vector(3)
    copy_into(from_H, reference.r_CT_H)
    copy_into(speed_H, reference.v_CT_H)
    guidance.start_abort(guidance_params, guidance_state, t_s, from_H, speed_H)
    guidance.reference(guidance_params, guidance_state, t_s, reference)
