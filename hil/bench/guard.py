"""Whether the axes stand where they should: following error that grows with speed, and soft limits.

Rails in m, gimbals in rad; axes 0..2 are the rails x y z, 3..5 the gimbals roll pitch yaw.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel

GUARD = np.dtype(
    [
        ("following_max", "f8", 6),  # at rest
        ("following_per_speed", "f8", 6),  # s, added for each unit of commanded speed
        ("low", "f8", 6),
        ("high", "f8", 6),
    ],
    align=True,
)

BREACH = np.dtype([("axis", "i8"), ("value", "f8"), ("low", "f8"), ("high", "f8")], align=True)

NOTHING, FOLLOWING, TRAVEL, NOT_FINITE = range(4)


@kernel
def first_breach(guard, setpoint, feedback, breach):
    """Return what is wrong with the axes, NOTHING if all is well; ``breach`` (BREACH) then names axis and limits.

    setpoint, feedback: AXES of one moment. The following error may be ``following_max`` plus
    ``following_per_speed`` times the commanded speed; a position may lie beyond the travel by that
    much, because a setpoint may lie at its end. Of several axes the first one counts.
    """
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
