"""Jogging: one axis at a limited speed for as long as a dead-man key is refreshed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.core.messages import Array
from hil.core.operator_commands import DEAD_MAN_S

SHARE_OF_RATE_NOT_HOMED = 0.02  # rate limit of an axis that is not homed
_FAR = 100.0  # m or rad: further than any axis goes


@dataclass(slots=True)
class DeadMan:
    """A key that counts as pressed for ``holds_s`` after each refresh, which may change it."""

    holds_s: float = DEAD_MAN_S
    refreshed_s: float = -float("inf")

    def refresh(self, now_s: float, holds_s: float = DEAD_MAN_S) -> None:
        self.refreshed_s, self.holds_s = now_s, holds_s

    def pressed(self, now_s: float) -> bool:
        """Return whether the last refresh is recent; one from the future does not count."""
        return 0.0 <= now_s - self.refreshed_s <= self.holds_s


class Jog:
    """Target and limits of one axis while its jog key is pressed.

    params: BENCH_PARAMS of the bench. axis: 0..2 rails, 3..5 gimbals. direction: 1 or -1. homed:
    an axis that is not homed has no soft limits and a lower speed. position (6,): of the axes; an axis beyond
    its travel may only move back. rate_fraction: of the axis' speed limit.
    """

    def __init__(
        self, params: np.record, axis: int, direction: int, homed: bool, position: Array, rate_fraction: float = 0.1
    ) -> None:
        if axis not in range(6) or direction not in (-1, 1):
            raise ValueError(f"axis {axis}, direction {direction}: allowed 0..5 and -1 or 1")
        self.axis = axis
        self.direction = direction
        self.key = DeadMan()
        self.was_kept_clear = False
        """Whether the guard volume has stopped this jog."""
        self.params = params.copy()
        self.params.rate_max[axis] *= rate_fraction if homed else min(rate_fraction, SHARE_OF_RATE_NOT_HOMED)
        for i in range(6):
            low, high = params.low[i], params.high[i]
            free = i == axis and not homed
            self.params.low[i] = -_FAR + position[i] if free else min(low, position[i])
            self.params.high[i] = _FAR + position[i] if free else max(high, position[i])
        self._target = self.params.high[axis] if direction > 0 else self.params.low[axis]

    def may_move(self, now_s: float, limit: int) -> bool:
        """Return whether the key is pressed and no switch is in the way (``limit``: -1 low, 1 high, 0 none)."""
        return self.key.pressed(now_s) and limit != self.direction

    def aim(self, motion: np.record, out: np.record) -> None:
        """Write the target, AXES: this axis to its end, the others at their positions in ``motion`` (MOTION)."""
        position = motion.position.copy()
        position[self.axis] = self._target
        out.rail_m, out.gimbal_rad = position[:3], position[3:]
        out.rail_mps = 0.0
        out.gimbal_radps = 0.0
