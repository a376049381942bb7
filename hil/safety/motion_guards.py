"""Alarms of the motion guards, and the guard volume while an axis is jogged.

A jog into the volume is not started, or braked; one out of it is permitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from hil.bench import bench_guard, guard, keep_out
from hil.bench import guard as guards
from hil.bench.keep_out import NOTHING
from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, new
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


_LEAVING_S: Final = 0.1  # of a setpoint's motion, after which axes that leave the volume must not be deeper in it
_WIDER_M: Final = 2.0
_EARLIER_S: Final = 0.2  # by which a jog brakes before the alarm


class JogGuard:
    """Guard volume of the axes by their encoders, for axes that may stand within it. guard: GUARD."""

    def __init__(self, guard: np.record) -> None:
        self._guard = kernel_record(guard.copy())
        self._early = kernel_record(guard.copy())
        self._early.reaction_s += _EARLIER_S
        self._parts = _wider_parts(guard)
        self._breach = kernel_record(new(guards.BREACH))
        self._at = kernel_record(new(AXES))

    def check(self, now_s: float, setpoint: np.record, feedback: np.record) -> Alarm | None:
        """Return the alarm of axes that move into the volume, None if they do not. setpoint, feedback: AXES."""
        return self._alarm(now_s, self._guard, setpoint, feedback)

    def check_jog(self, now_s: float, axis: int, rate: float, feedback: np.record) -> Alarm | None:
        """Return the alarm of a jog of ``axis`` that would reach the volume if it continued, None if it would not.

        rate: of the jog with its sign, m/s or rad/s. feedback: AXES.
        """
        setpoint = new(AXES)
        setpoint.rail_m, setpoint.gimbal_rad = feedback.rail_m, feedback.gimbal_rad
        setpoint["rail_mps" if axis < 3 else "gimbal_radps"][axis % 3] = rate
        return self._alarm(now_s, self._early, setpoint, setpoint)

    def check_position(self, axes: np.record) -> Alarm | None:
        """Return the alarm if ``axes`` (AXES), at rest there, would be within the volume, None if outside it."""
        at = self._at
        at.rail_m, at.gimbal_rad = axes.rail_m, axes.gimbal_rad
        return self._found(0.0, self._guard, at)

    def check_motion(self, axes: np.record) -> Alarm | None:
        """Return the alarm of a run or a move in which the axes are at ``axes`` (AXES), with its rates."""
        return self._found(0.0, self._guard, axes)

    def _found(self, now_s: float, guard: np.record, axes: np.record) -> Alarm | None:
        code = int(guards.enters_volume(guard, kernel_record(axes), self._breach))
        return None if code == NOTHING else breach_alarm(now_s, (), code, self._breach)

    def _alarm(self, now_s: float, guard: np.record, setpoint: np.record, axes: np.record) -> Alarm | None:
        alarm = self._found(now_s, guard, axes)
        return alarm if alarm is not None and not self._leaves(setpoint) else None

    def _leaves(self, setpoint: np.record) -> bool:
        """Return whether axes at ``setpoint`` come no deeper into any part with its rates; never if bodies meet."""
        before = [self._depth(part, setpoint, 0.0) for part in self._parts]
        after = [self._depth(part, setpoint, _LEAVING_S) for part in self._parts]
        return max(before) < np.inf and all(b <= a for a, b in zip(before, after, strict=True))

    def _depth(self, part: np.record, setpoint: np.record, after_s: float) -> float:
        """Return how deep, m, the axes would rest in ``part`` after ``after_s`` of the setpoint's motion.

        0 outside it, inf if bodies meet.
        """
        at, breach = self._at, self._breach
        at.rail_m = setpoint.rail_m + after_s * setpoint.rail_mps
        at.gimbal_rad = setpoint.gimbal_rad + after_s * setpoint.gimbal_radps
        code = int(guards.enters_volume(part, at, breach))
        if code == NOTHING:
            return 0.0
        return np.inf if code == guards.COLLISION and not breach.value > 0.0 else float(breach.high - breach.value)


def _wider_parts(guard: np.record) -> list[np.record]:
    """Return GUARD with each part alone, so wide that axes at an alarm are in it: carriage, turntable, keep-out."""
    parts = [guard.copy() for _ in range(3)]
    for k, part in enumerate(parts):
        part.distance += _WIDER_M
        if k != 0:
            part.carriage.n = 0
        if k != 1:
            part.turntable.n = 0
        if k != 2:
            part.zone.radius, part.zone.plane = 0.0, -np.inf
    wide = parts[2].zone
    wide.plane += _WIDER_M
    if wide.radius > 0.0:
        wide.radius += _WIDER_M
    return [kernel_record(part) for part in parts]
