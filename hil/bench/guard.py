"""Whether the axes stand where they should: following error that grows with speed, soft limits, distance of bodies.

Rails in m, gimbals in rad; axes 0..2 are the rails x y z, 3..5 the gimbals roll pitch yaw.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import entry, kernel
from hil.maths import euler, stack
from hil.maths.arrays import fill
from hil.models.bodies import BODIES, CLOSING, DISTANCE, STOPPING, WHICH, clearance

GUARD = np.dtype(
    [
        ("following_max", "f8", 6),  # at rest
        ("following_per_speed", "f8", 6),  # s, added for each unit of commanded speed
        ("low", "f8", 6),
        ("high", "f8", 6),
        ("order", "i8", 3),  # gimbals outer to inner, 0 roll, 1 pitch, 2 yaw
        ("carriage", BODIES),  # that move with the rails, in L about the turntable's centre of rotation
        ("turntable", BODIES),  # that rotate as well, in c about the same centre
        ("lab", BODIES),  # that stand still, in L
        ("distance", "f8"),  # m, least one between bodies
        ("reaction_s", "f8"),
        ("deceleration", "f8"),  # m/s^2, that all rails have
        ("turning_deceleration", "f8"),  # rad/s^2, that all gimbals have
    ],
    align=True,
)

BREACH = np.dtype([("axis", "i8"), ("value", "f8"), ("low", "f8"), ("high", "f8")], align=True)

NOTHING, FOLLOWING, TRAVEL, NOT_FINITE = range(4)
COLLISION = 16
"""Bodies of the bench too near to each other; the numbers between are those of ``bench_guard``."""


@kernel
def bodies_meet(moving, r, q, v, rate, fixed, least, reaction_s, deceleration, turning_deceleration, breach):
    """Return whether braking would not keep two bodies apart by ``least``, m. Arguments as of ``clearance``.

    ``breach`` (BREACH) then has the number of the pair, the distance as ``value``, the closing rate as ``low`` and
    the least distance allowed at it as ``high``.
    """
    if moving.n == 0 or fixed.n == 0:
        return False
    found = stack.vector(4)
    if clearance(moving, r, q, v, rate, fixed, reaction_s, deceleration, turning_deceleration, least, found) >= least:
        return False
    breach.axis, breach.value, breach.low = int(found[WHICH]), found[DISTANCE], found[CLOSING]
    breach.high = least + found[STOPPING]
    return True


@kernel
def _bench_meets(guard, feedback, breach):
    """Return whether the bodies of the bench come too near to each other; ``breach`` then has the pair."""
    if guard.lab.n == 0:
        return False
    q, rate = stack.vector(4), 0.0
    fill(q, 0.0)
    q[3] = 1.0
    if bodies_meet(
        guard.carriage, feedback.rail_m, q, feedback.rail_mps, 0.0, guard.lab,
        guard.distance, guard.reaction_s, guard.deceleration, guard.turning_deceleration, breach,
    ):  # fmt: skip
        return True
    euler.to_quaternion_into(feedback.gimbal_rad, guard.order, q)
    for i in range(3):
        rate += abs(feedback.gimbal_radps[i])
    return bodies_meet(
        guard.turntable, feedback.rail_m, q, feedback.rail_mps, rate, guard.lab,
        guard.distance, guard.reaction_s, guard.deceleration, guard.turning_deceleration, breach,
    )  # fmt: skip


@entry
def first_breach(guard, setpoint, feedback, breach):
    """Return what is wrong with the axes, NOTHING if all is well; ``breach`` (BREACH) then names axis and limits.

    setpoint, feedback: AXES of one moment. The following error may be ``following_max`` plus
    ``following_per_speed`` times the commanded speed; a position may lie beyond the travel by that
    much, because a setpoint may lie at its end. Of several axes the first one counts. Bodies of the bench that come too
    near to each other count before the axes.
    """
    if _bench_meets(guard, feedback, breach):
        return COLLISION
    for axis in range(6):
        i = axis % 3
        if axis < 3:
            wanted, speed, found = setpoint.rail_m[i], setpoint.rail_mps[i], feedback.rail_m[i]
        else:
            wanted, speed, found = setpoint.gimbal_rad[i], setpoint.gimbal_radps[i], feedback.gimbal_rad[i]
        allowed = guard.following_max[axis] + guard.following_per_speed[axis] * abs(speed)
        low, high = guard.low[axis] - allowed, guard.high[axis] + allowed
        error = abs(wanted - found)
        # "not <=" also catches nan
        if not error <= allowed:
            breach.axis, breach.value, breach.low, breach.high = axis, error, 0.0, allowed
            return FOLLOWING
        if not low <= found <= high:
            breach.axis, breach.value, breach.low, breach.high = axis, found, low, high
            return TRAVEL
    return NOTHING


@kernel
def first_beyond_travel(guard, feedback, slack, breach):
    """Return TRAVEL where an axis stands beyond its travel by more than ``slack`` (6,), or NOT_FINITE, or NOTHING."""
    for axis in range(6):
        found = feedback.rail_m[axis % 3] if axis < 3 else feedback.gimbal_rad[axis % 3]
        breach.axis, breach.value, breach.low, breach.high = axis, found, guard.low[axis], guard.high[axis]
        if not math.isfinite(found):
            return NOT_FINITE
        if not guard.low[axis] - slack[axis] <= found <= guard.high[axis] + slack[axis]:
            return TRAVEL
    return NOTHING


@kernel
def first_moving(feedback, rail_mps, gimbal_radps):
    """Return the first axis of ``feedback`` (AXES) that is faster than the given speeds, -1 if none is."""
    for i in range(3):
        if not abs(feedback.rail_mps[i]) <= rail_mps:
            return i
    for i in range(3):
        if not abs(feedback.gimbal_radps[i]) <= gimbal_radps:
            return 3 + i
    return -1
