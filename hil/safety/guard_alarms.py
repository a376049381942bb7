"""Alarms of the bench guard."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.bench import bench_guard
from hil.safety.alarms import Alarm

_LETTERS = "xyz"


def guard_alarm(now_s: float, axis_names: Sequence[str], code: int, found: np.record) -> Alarm:
    """Return the alarm of the bench guard. code: as returned by ``check_bench``; found: BREACH."""
    value, limit = float(found.value), float(found.high)
    match code:
        case bench_guard.KEEP_OUT:
            allowed = f"{limit:.4f} m and more at a closing rate of {found.low:.4f} m/s"
            return Alarm(now_s, "bench", "range to the target", _metres(value), allowed)
        case bench_guard.POSITION:
            return Alarm(now_s, "bench", "distance from the truth", _metres(value), _metres(limit))
        case bench_guard.ATTITUDE:
            return Alarm(now_s, "bench", "rotation from the truth", _degrees(value), _degrees(limit))
        case bench_guard.LIMITED:
            return Alarm(now_s, "bench", "limited setpoints", f"{value:.0f} in a row", f"{limit:.0f}")
        case bench_guard.AXIS:
            axis = int(found.axis)
            shown = _metres if axis < 3 else _degrees
            return Alarm(now_s, axis_names[axis], "distance from the demand", shown(value), shown(limit))
    about = _LETTERS[int(found.axis)]
    if code == bench_guard.VISION_POSITION:
        return Alarm(now_s, "vmu", f"pose against encoders, {about}", _metres(value), _metres(limit))
    return Alarm(now_s, "vmu", f"pose against encoders, about {about}", _degrees(value), _degrees(limit))


def is_of_guard(code: int) -> bool:
    """Return whether the bench guard has ended the compiled loop. code: of ``run_loop``."""
    return bench_guard.KEEP_OUT <= code <= bench_guard.VISION_ATTITUDE


def _metres(metres: float) -> str:
    return f"{metres:.4f} m"


def _degrees(radians: float) -> str:
    return f"{math.degrees(radians):.3f} deg"
