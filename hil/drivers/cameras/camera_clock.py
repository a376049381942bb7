"""Times of exposure in bench time, from a camera's own clock."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

_HISTORY: Final = 64  # frames; 10 s at 6.25 Hz, in which a clock of 50 ppm drifts by 0.5 ms
_JUMP_S: Final = 0.25
_SETTLED: Final = 8  # frames; the first ones after a start are slow


class CameraClock:
    """Offset between a camera's clock and bench time, from bounds that each frame gives.

    With software triggers no exposure precedes its trigger: the earliest one in recent frames is ``latency_s`` after
    it. Without them the fastest frame arrives ``latency_s`` after its exposure. The error of the estimate is what the
    best frame was slower than that. A frame counts if its trigger is certain: the trigger before was answered in time.
    """

    def __init__(self, latency_s: float, triggered: bool) -> None:
        self._latency_s = latency_s if triggered else -latency_s
        self._best = max if triggered else min
        self._triggered = triggered
        self._offsets: deque[float] = deque(maxlen=_HISTORY)
        self._arrived_s = -math.inf  # arrival of the previous frame
        self.jumps = 0
        """Number of times that the camera's clock has jumped, after which its offset is estimated again."""

    def add(self, stamp_s: float, arrived_s: float, triggers_s: Sequence[float] = ()) -> None:
        """Add a frame with the camera's time ``stamp_s`` that arrived at ``arrived_s`` of bench time.

        stamp_s: nan for an incomplete frame, whose stamp may be another one's. triggers_s: bench times of recent
        software triggers, ascending.
        """
        bound_s = self._bound_s(arrived_s, triggers_s)
        if math.isnan(stamp_s) or bound_s is None:
            return
        offset = bound_s - stamp_s
        if self._offsets and abs(offset - self._best(self._offsets)) > _JUMP_S:
            self._offsets.clear()
            self.jumps += 1
        self._offsets.append(offset)

    def unstamped_s(self, arrived_s: float, triggers_s: Sequence[float] = ()) -> float:
        """Return the bench time of the exposure of a frame without a time stamp; nan if its trigger is not certain."""
        bound_s = self._bound_s(arrived_s, triggers_s)
        return math.nan if bound_s is None else bound_s + self._latency_s

    def _bound_s(self, arrived_s: float, triggers_s: Sequence[float]) -> float | None:
        """Return the time of a frame's trigger, None if that is not certain; without triggers the time of arrival."""
        before_s, self._arrived_s = self._arrived_s, arrived_s
        return _certain_trigger(triggers_s, before_s, arrived_s) if self._triggered else arrived_s

    def exposed_s(self, stamp_s: float) -> float:
        """Return the bench time of the exposure with the camera's time ``stamp_s``; nan before enough frames."""
        return stamp_s + self._best(self._offsets) + self._latency_s if len(self._offsets) >= _SETTLED else math.nan


def _certain_trigger(triggers_s: Sequence[float], before_s: float, arrived_s: float) -> float | None:
    """Return the time of the trigger of a frame that arrived at ``arrived_s``, the one before it at ``before_s``."""
    *earlier, newest_s = [t_s for t_s in triggers_s if t_s <= arrived_s] or [math.inf]
    answered = not earlier or earlier[-1] <= before_s < newest_s
    return newest_s if answered and newest_s <= arrived_s else None
