"""Alarms of the motion guards: bench guard, guard volume, following error and travel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from hil.bench import bench_guard, guard, keep_out
from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.models.bodies import PAIR

_VOLUME: Final = {keep_out.KEEP_OUT: table.RANGE, keep_out.PLANE: table.PLANE}
_BODIES: Final = {
    bench_guard.BODIES_MEET: (table.CHASER_AND_TARGET, "keep_out.bodies"),
    guard.COLLISION: (table.BODIES, "bench.bodies"),
}
_AXIS: Final = {guard.FOLLOWING: table.FOLLOWING_ERROR, bench_guard.AXIS: table.DISTANCE_FROM_DEMAND}
_POSE: Final = {
    bench_guard.VISION_POSITION: table.POSE_AGAINST_ENCODERS,
    bench_guard.VISION_ATTITUDE: table.ATTITUDE_AGAINST_ENCODERS,
}
_BENCH: Final = {
    bench_guard.POSITION: table.DISTANCE_FROM_TRUTH,
    bench_guard.ATTITUDE: table.ROTATION_FROM_TRUTH,
    bench_guard.LIMITED: table.LIMITED_SETPOINTS,
}


def breach_alarm(now_s: float, axis_names: Sequence[str], code: int, breach: np.record) -> Alarm:
    """Return the alarm of a breach. code: as returned by the kernels of the guards; breach: BREACH."""
    axis, value, low, high = int(breach.axis), float(breach.value), float(breach.low), float(breach.high)
    source, closing = "", f" and more at a closing rate of {low:.4f} m/s"
    if code > guard.BY_ENCODERS:
        code, source = code - guard.BY_ENCODERS, " by the encoders"
    if code in _VOLUME:
        return _VOLUME[code].alarm(now_s, "bench", value, high, notes=(source, closing))
    if code in _BODIES:
        kind, key = _BODIES[code]
        moving, fixed = divmod(axis, PAIR)
        return kind.alarm(now_s, "bench", value, high, notes=(f" ({key} {moving} and {fixed})", closing))
    if code in _BENCH:
        return _BENCH[code].alarm(now_s, "bench", value, high)
    if code in _POSE:
        return _POSE[code].alarm(now_s, "vmu", value, high, "xyz"[axis])
    if code in _AXIS:
        return _AXIS[code].alarm(now_s, axis_names[axis], value, high, rotates=axis >= 3)
    if code == guard.NOT_FINITE:
        return table.POSITION.alarm(now_s, axis_names[axis], str(value), "a finite number")
    return table.POSITION.alarm(now_s, axis_names[axis], value, (low, high), rotates=axis >= 3)


def is_of_guard(code: int) -> bool:
    """Return whether the bench guard has ended the compiled loop. code: of ``run_cycles``."""
    return code >= keep_out.KEEP_OUT
