"""Watches the approach: corridor, closing rate, ready state. What it finds leads to an abort.

The corridor surrounds the line of the present phase: its radius is a share of the range (a cone with
its tip in the target's reference point), but never less than a minimum. The closing rate may be
``floor`` at the ready point's range and nearer, and grows with range up to ``greatest``.

In the loop both are judged on the estimate. A limit counts as broken when it is broken by more than
``confidence`` standard deviations of the estimate for ``persistence`` cycles on end: an estimate that
is still converging must not abort an approach that is safe. The same margins on the truth, without
allowance, are part of the verdict after the run.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.gnc import guidance
from hil.maths import quat, stack

NOT_ABORTED, CORRIDOR, CLOSING_RATE, ORDERED = range(4)

SUPERVISION_PARAMS = np.dtype(
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
        # ready state: largest deviations (Table III)
        ("ready_point", "f8", 3),  # m, in H
        ("ready_distance", "f8", 3),  # m
        ("ready_rate", "f8", 3),  # m/s
        ("ready_angle", "f8"),  # rad
        ("ready_angular_rate", "f8"),  # rad/s
    ],
    align=True,
)


@kernel
def corridor_margin(params, from_H, to_H, r_CT_H):
    """Return how far, m, ``r_CT_H`` is inside the corridor about the line ``from_H`` to ``to_H``; negative outside."""
    square = 0.0
    along = 0.0
    for i in range(3):
        way = to_H[i] - from_H[i]
        square += way * way
        along += way * (r_CT_H[i] - from_H[i])
    share = min(1.0, max(0.0, along / square)) if square > 0.0 else 0.0
    off = 0.0
    distance = 0.0
    for i in range(3):
        off += (r_CT_H[i] - from_H[i] - share * (to_H[i] - from_H[i])) ** 2
        distance += r_CT_H[i] ** 2
    return max(params.minimum_radius, params.cone * math.sqrt(distance)) - math.sqrt(off)


@kernel
def closing_limit(params, distance):
    """Return the greatest closing rate, m/s, at the range ``distance``, m."""
    allowed = params.closing_floor + params.closing_slope * max(0.0, distance - params.floor_range)
    return min(params.closing_greatest, allowed)


@kernel
def closing_margin(params, r_CT_H, v_CT_H):
    """Return by how much, m/s, the range falls slower than it may; negative when it falls faster."""
    square = 0.0
    product = 0.0
    for i in range(3):
        square += r_CT_H[i] ** 2
        product += r_CT_H[i] * v_CT_H[i]
    distance = math.sqrt(square)
    rate = product / distance if distance > 0.0 else 0.0
    return closing_limit(params, distance) + rate


@kernel
def margins(params, from_H, to_H, r_CT_H, v_CT_H, corridor, closing):
    """Write ``corridor_margin`` and ``closing_margin`` of each row of the four arrays (n, 3) into (n,)."""
    for k in range(corridor.shape[0]):
        corridor[k] = corridor_margin(params, from_H[k], to_H[k], r_CT_H[k])
        closing[k] = closing_margin(params, r_CT_H[k], v_CT_H[k])


@kernel
def _largest(sigma):
    """Return the largest of ``sigma`` (3,), 0 where it is not known."""
    largest = 0.0
    for i in range(3):
        if sigma[i] > largest:
            largest = sigma[i]
    return largest


@kernel
def _is_ready(params, navigation):
    """Return whether the estimate is within Table III, each axis alone (angles as a rotation vector)."""
    turn = stack.vector(3)
    quat.to_rotation_vector_into(navigation.q_CH, turn)
    for i in range(3):
        if not (
            abs(navigation.r_CT_H[i] - params.ready_point[i]) <= params.ready_distance[i]
            and abs(navigation.v_CT_H[i]) <= params.ready_rate[i]
            and abs(turn[i]) <= params.ready_angle
            and abs(navigation.w_CH_C[i]) <= params.ready_angular_rate
        ):
            return False
    return True


@kernel
def supervise(params, t_s, navigation, reference, ordered, found):
    """Judge the estimate; write ``found`` (SUPERVISION). Returns whether an abort has to begin now.

    ordered: 1 at the order to abort. Before the first pose nothing is judged; after an abort the
    margins are still written, but lead to nothing.
    """
    if navigation.valid == 0:
        found.ready_since_s = np.nan
        return False
    found.corridor_margin_m = corridor_margin(params, reference.from_H, reference.to_H, navigation.r_CT_H)
    found.closing_margin_mps = closing_margin(params, navigation.r_CT_H, navigation.v_CT_H)
    if not _is_ready(params, navigation):
        found.ready_since_s = np.nan
    elif not found.ready_since_s <= t_s:
        found.ready_since_s = t_s
    if found.aborted != NOT_ABORTED:
        return False
    cause = NOT_ABORTED
    if found.corridor_margin_m < -params.confidence * _largest(navigation.sigma_r_m):
        cause = CORRIDOR
    elif found.closing_margin_mps < -params.confidence * _largest(navigation.sigma_v_mps):
        cause = CLOSING_RATE
    found.broken_cycles = found.broken_cycles + 1 if cause != NOT_ABORTED else 0
    if ordered != 0 or t_s >= params.abort_at_s:
        cause = ORDERED
    elif found.broken_cycles < params.persistence:
        return False
    found.aborted = cause
    found.aborted_at_s = t_s
    return True


@kernel
def supervise_and_act(params, guidance_params, flown, t_s, navigation, reference, ordered, found):
    """Supervise; where an abort has to begin, begin it in ``flown`` and in ``reference``. Returns whether one did.

    flown: GUIDANCE_STATE. One kernel with both, so that nothing is left to compile when an abort comes.
    """
    if not supervise(params, t_s, navigation, reference, ordered, found):
        return False
    guidance.start_abort(guidance_params, flown, t_s, navigation.r_CT_H, navigation.v_CT_H)
    guidance.reference(guidance_params, flown, t_s, reference)
    return True
