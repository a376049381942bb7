"""Whether the axes stand where they should: following error that grows with speed, soft limits, guard volume.

The guard volume by the encoders: bodies of the bench that must not meet, and the keep-out of the chaser's reference
point. It holds in every mode in which axes are commanded, once all of them are homed.

Rails in m, gimbals in rad; axes 0..2 are the rails x y z, 3..5 the gimbals roll pitch yaw.
"""

from __future__ import annotations

import math

import numpy as np

from hil.bench.keep_out import BREACH as BREACH
from hil.bench.keep_out import KEEP_OUT_ZONE, check_keep_out
from hil.bench.keep_out import NOTHING as NOTHING
from hil.core.jit import entry, kernel
from hil.maths import euler, quat, stack
from hil.maths.arrays import fill
from hil.models.bodies import BODIES, CLOSING, DISTANCE, STOPPING, WHICH, are_apart, clearance, travel_to_rest

GUARD = np.dtype(
    [
        ("following_max", "f8", 6),  # at rest
        ("following_per_speed", "f8", 6),  # s, added for each unit of commanded speed
        ("low", "f8", 6),
        ("high", "f8", 6),
        ("order", "i8", 3),  # gimbals outer to inner, 0 roll, 1 pitch, 2 yaw
        ("homed", "i8"),  # 1: positions are known, and the guard volume holds
        ("zone", KEEP_OUT_ZONE),
        ("arm", "f8", 3),  # m, in c, from the turntable's centre of rotation to the chaser's reference point
        ("arm_length", "f8"),  # m
        ("carriage", BODIES),  # that move with the rails, in L about the turntable's centre of rotation
        ("turntable", BODIES),  # that rotate as well, in c about the same centre; low and high at ``rest``
        ("rest", "f8", 3),  # rad, gimbals that are fixed, others at 0
        ("lab", BODIES),  # that stand still, in L
        ("distance", "f8"),  # m, least one between bodies
        ("reaction_s", "f8"),
        ("deceleration", "f8"),  # m/s^2, that all rails have
        ("turning_deceleration", "f8"),  # rad/s^2, that all gimbals have
    ],
    align=True,
)

FOLLOWING, TRAVEL, NOT_FINITE = range(1, 4)
COLLISION = 16
"""Bodies of the bench too near to each other; the numbers between belong to ``keep_out`` and ``bench_guard``."""
BY_ENCODERS = 32
"""Added to a code of ``keep_out`` that holds for the position by the encoders."""


@kernel
def bodies_meet(moving, r, q, v, rate, fixed, least, reaction_s, deceleration, turning_deceleration, breach):
    """Return whether braking would not keep two bodies apart by ``least``, m. Arguments: see ``clearance``.

    ``breach`` (BREACH) then has the number of the pair, the distance as ``value``, the closing rate as ``low`` and
    the least distance allowed at it as ``high``.
    """
    if moving.n == 0 or fixed.n == 0:
        return False
    nearest = stack.vector(4)
    if clearance(moving, r, q, v, rate, fixed, reaction_s, deceleration, turning_deceleration, least, nearest) >= least:
        return False
    breach.axis, breach.value, breach.low = int(nearest[WHICH]), nearest[DISTANCE], nearest[CLOSING]
    breach.high = least + nearest[STOPPING]
    return True


@kernel
def _bench_meets(guard, axes, breach):
    """Return whether the bodies of the bench come too near to each other; ``breach`` then has the pair."""
    q, rate = stack.vector(4), 0.0
    fill(q, 0.0)
    q[3] = 1.0
    if bodies_meet(
        guard.carriage, axes.rail_m, q, axes.rail_mps, 0.0, guard.lab,
        guard.distance, guard.reaction_s, guard.deceleration, guard.turning_deceleration, breach,
    ):  # fmt: skip
        return True
    euler.to_quaternion_into(axes.gimbal_rad, guard.order, q)
    for i in range(3):
        rate += abs(axes.gimbal_radps[i])
    return bodies_meet(
        guard.turntable, axes.rail_m, q, axes.rail_mps, rate, guard.lab,
        guard.distance, guard.reaction_s, guard.deceleration, guard.turning_deceleration, breach,
    )  # fmt: skip


@kernel
def _enters_keep_out(guard, axes, turning, breach):
    """Return ``check_keep_out`` of the chaser's reference point by the axes. turning: rotation, rad, until rest."""
    r, q = stack.vector(3), stack.vector(4)
    euler.to_quaternion_into(axes.gimbal_rad, guard.order, q)
    quat.transform_back_into(q, guard.arm, r)
    for i in range(3):
        r[i] += axes.rail_m[i]
    return check_keep_out(
        guard.zone, r, axes.rail_mps, guard.arm_length * turning, guard.reaction_s, guard.deceleration, breach
    )


@kernel
def enters_volume(guard, axes, breach):
    """Return COLLISION, or a number of ``keep_out`` plus BY_ENCODERS, if the axes would enter the guard volume.

    axes: AXES; they brake now. NOTHING if they would not, or if they are not homed.
    """
    if guard.homed == 0:
        return NOTHING
    angle, turned, rate, speed, along = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        angle += abs(axes.gimbal_rad[i])
        turned += abs(axes.gimbal_rad[i] - guard.rest[i])
        rate += abs(axes.gimbal_radps[i])
        speed += abs(axes.rail_mps[i])
        along += guard.zone.axis[i] * (axes.rail_m[i] + guard.arm[i])
    turning = travel_to_rest(rate, guard.reaction_s, guard.turning_deceleration)
    farthest, rotation = travel_to_rest(speed, guard.reaction_s, guard.deceleration), angle + turning
    # sums bound angles and speeds: far from the volume neither attitude nor distances are computed
    least = guard.distance + farthest
    is_apart = are_apart(guard.carriage, axes.rail_m, 0.0, guard.lab, least) and are_apart(
        guard.turntable, axes.rail_m, turned + turning, guard.lab, least
    )
    if not is_apart and _bench_meets(guard, axes, breach):
        return COLLISION
    if along - farthest - guard.arm_length * rotation >= max(guard.zone.radius, guard.zone.plane):
        return NOTHING
    cause = _enters_keep_out(guard, axes, turning, breach)
    return NOTHING if cause == NOTHING else cause + BY_ENCODERS


@entry
def first_breach(guard, setpoint, feedback, breach):
    """Return what is wrong with the axes, NOTHING if all is well; ``breach`` (BREACH) then names axis and limits.

    setpoint, feedback: AXES of one moment. The following error may be ``following_max`` plus
    ``following_per_speed`` times the commanded speed; a position may lie beyond the travel by that
    much, because a setpoint may lie at its end. Of several axes the first one counts. The guard volume counts
    last.
    """
    for axis in range(6):
        i = axis % 3
        if axis < 3:
            demand, speed, measured = setpoint.rail_m[i], setpoint.rail_mps[i], feedback.rail_m[i]
        else:
            demand, speed, measured = setpoint.gimbal_rad[i], setpoint.gimbal_radps[i], feedback.gimbal_rad[i]
        allowed = guard.following_max[axis] + guard.following_per_speed[axis] * abs(speed)
        low, high = guard.low[axis] - allowed, guard.high[axis] + allowed
        error = abs(demand - measured)
        # "not <=" also catches nan
        if not error <= allowed:
            breach.axis, breach.value, breach.low, breach.high = axis, error, 0.0, allowed
            return FOLLOWING
        if not low <= measured <= high:
            breach.axis, breach.value, breach.low, breach.high = axis, measured, low, high
            return TRAVEL
    return enters_volume(guard, feedback, breach)


@kernel
def first_beyond_travel(guard, feedback, slack, breach):
    """Return TRAVEL where an axis stands beyond its travel by more than ``slack`` (6,), or NOT_FINITE, or NOTHING."""
    for axis in range(6):
        measured = feedback.rail_m[axis % 3] if axis < 3 else feedback.gimbal_rad[axis % 3]
        breach.axis, breach.value, breach.low, breach.high = axis, measured, guard.low[axis], guard.high[axis]
        if not math.isfinite(measured):
            return NOT_FINITE
        if not guard.low[axis] - slack[axis] <= measured <= guard.high[axis] + slack[axis]:
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
