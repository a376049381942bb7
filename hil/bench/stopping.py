"""The way to a stand: each axis loses as much speed a step as it may, and ends where that takes it."""

from __future__ import annotations

from hil.bench.kinematics import limit_jerk, write_axis
from hil.core.jit import kernel


@kernel
def slower(rate, loss):
    """Return ``rate`` brought towards zero by ``loss``, never past it."""
    if rate > loss:
        return rate - loss
    if rate < -loss:
        return rate + loss
    return 0.0


@kernel
def brake_step(params, motion, out):
    """Write the next setpoint, AXES, of axes that are to stand as soon as they may; return how many still move.

    params: BENCH_PARAMS. motion: MOTION, where the last setpoints are and how fast they went; moved on
    in place. From the speed v an axis goes no further than ``v^2 / (2 acceleration)`` and never turns
    back. A setpoint that ``limit_setpoint`` gave has this way before it within the travel; it is cut
    there all the same. An axis with a limit of its jerk stands later, by the setpoints of which it gets the mean.
    """
    for axis in range(6):
        rate = slower(motion.rate[axis], params.acceleration_max[axis] * params.dt_s)
        position = motion.position[axis]
        if rate != 0.0:
            # from the inside not past an end; from beyond an end not jumping back to it
            low, high = min(params.low[axis], position), max(params.high[axis], position)
            position = min(high, max(low, position + rate * params.dt_s))
        motion.rate[axis] = rate
        motion.position[axis] = position
        write_axis(axis, position, rate, out)
    limit_jerk(params, motion, out)
    moving = 0
    for i in range(3):
        moving += (out.rail_mps[i] != 0.0) + (out.gimbal_radps[i] != 0.0)
    return moving
