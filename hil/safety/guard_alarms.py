"""Alarms of the bench guard."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from hil.bench import bench_guard, guard, keep_out
from hil.models.bodies import PAIR
from hil.safety.alarms import Alarm

_RANGE, _DISTANCE, _ROTATION = "range to the target", "distance from the truth", "rotation from the truth"
_LIMITED, _DEMAND, _POSE = "limited setpoints", "distance from the demand", "pose against encoders"
_PLANE: Final = "distance from the target along the docking axis"
_BODIES: Final = "distance of chaser and target"
BENCH_BODIES: Final = "distance of bodies"
GUARD_QUANTITIES = (_RANGE, _PLANE, _BODIES, BENCH_BODIES, _DISTANCE, _ROTATION, _LIMITED, _DEMAND, _POSE)
"""Monitored quantities, those of the vision unit without the axis."""
_LETTERS = "xyz"


def guard_alarm(now_s: float, axis_names: Sequence[str], code: int, found: np.record) -> Alarm:
    """Return the alarm of the bench guard. code: as returned by ``check_bench``; found: BREACH."""
    if is_of_volume(code):
        return volume_alarm(now_s, code, found)
    value, limit = float(found.value), float(found.high)
    match code:
        case keep_out.KEEP_OUT | keep_out.PLANE:
            return _keep_out_alarm(now_s, code, found, "")
        case bench_guard.BODIES_MEET:
            return bodies_alarm(now_s, _BODIES, "keep_out.bodies", found)
        case bench_guard.POSITION:
            return Alarm(now_s, "bench", _DISTANCE, _metres(value), _metres(limit))
        case bench_guard.ATTITUDE:
            return Alarm(now_s, "bench", _ROTATION, _degrees(value), _degrees(limit))
        case bench_guard.LIMITED:
            return Alarm(now_s, "bench", _LIMITED, f"{value:.0f} in a row", f"{limit:.0f}")
        case bench_guard.AXIS:
            axis = int(found.axis)
            shown = _metres if axis < 3 else _degrees
            return Alarm(now_s, axis_names[axis], _DEMAND, shown(value), shown(limit))
    about = _LETTERS[int(found.axis)]
    if code == bench_guard.VISION_POSITION:
        return Alarm(now_s, "vmu", f"{_POSE}, {about}", _metres(value), _metres(limit))
    return Alarm(now_s, "vmu", f"{_POSE}, about {about}", _degrees(value), _degrees(limit))


def volume_alarm(now_s: float, code: int, found: np.record) -> Alarm:
    """Return the alarm of the guard volume by the encoders. code: as returned by ``enters_volume``; found: BREACH."""
    if code == guard.COLLISION:
        return bodies_alarm(now_s, BENCH_BODIES, "bench.bodies", found)
    return _keep_out_alarm(now_s, code - guard.BY_ENCODERS, found, " by the encoders")


def is_of_volume(code: int) -> bool:
    """Return whether ``code``, of ``first_breach``, is of the guard volume."""
    return code == guard.COLLISION or code > guard.BY_ENCODERS


def _keep_out_alarm(now_s: float, code: int, found: np.record, source: str) -> Alarm:
    quantity = _RANGE if code == keep_out.KEEP_OUT else _PLANE
    return Alarm(now_s, "bench", quantity, f"{_metres(found.value)}{source}", _at_closing_rate(found))


def bodies_alarm(now_s: float, quantity: str, key: str, found: np.record) -> Alarm:
    """Return the alarm of two bodies of the list ``key``. found: BREACH."""
    moving, fixed = divmod(int(found.axis), PAIR)
    value = f"{_metres(found.value)} ({key} {moving} and {fixed})"
    return Alarm(now_s, "bench", quantity, value, _at_closing_rate(found))


def is_of_guard(code: int) -> bool:
    """Return whether the bench guard has ended the compiled loop. code: of ``run_cycles``."""
    return code >= keep_out.KEEP_OUT


def _at_closing_rate(found: np.record) -> str:
    return f"{_metres(found.high)} and more at a closing rate of {found.low:.4f} m/s"


def _metres(metres: float) -> str:
    return f"{metres:.4f} m"


def _degrees(radians: float) -> str:
    return f"{math.degrees(radians):.3f} deg"
