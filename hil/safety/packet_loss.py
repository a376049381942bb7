"""Losses of a link or of the loop, and a second source of an axis' speed.

Single losses are tolerated, bursts raise an alarm. The speed that a drive reports is compared with the change of its
position.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.messages import Array, AxisFeedback


@dataclass(slots=True)
class LeakyBucket:
    """Level that rises by one per loss and decays by one per ``forget_s``; it trips above ``capacity``.

    fullest: largest level since it was emptied.
    """

    capacity: float
    forget_s: float
    level: float = 0.0
    fullest: float = 0.0
    _updated_s: float = -float("inf")

    def add(self, n: float, t_s: float) -> bool:
        """Add ``n`` losses up to ``t_s``; return whether the level exceeds the capacity.

        Without decay if time runs backwards.
        """
        if t_s > self._updated_s:
            self.level = max(0.0, self.level - (t_s - self._updated_s) / self.forget_s)
            self._updated_s = t_s
        self.level += n
        self.fullest = max(self.fullest, self.level)
        return self.level > self.capacity

    def empty(self) -> None:
        self.level = self.fullest = 0.0


class LinkWatch:
    """Packet loss of one device, from its counter of lost packets (a decrease means that the counter restarted)."""

    def __init__(self, device: str, bucket: LeakyBucket, lost: Callable[[], int]) -> None:
        self.device = device
        self._bucket = bucket
        self._lost = lost
        self._before = 0

    def restart(self) -> None:
        """Discard earlier losses: the link was reopened."""
        self._before = self._lost()
        self._bucket.empty()

    def margin(self) -> dict[str, Any]:
        """Return the largest level against its limit, by the keys of ``Outcome.measured["limits"]``; without times."""
        return {"value": self._bucket.fullest, "limit": self._bucket.capacity}

    def check(self, now_s: float) -> Alarm | None:
        """Return an alarm if too many packets were lost recently."""
        count = self._lost()
        new = max(0, count - self._before)
        self._before = count
        if not self._bucket.add(new, now_s):
            return None
        bucket = self._bucket
        drained = f" at once, 1 per {bucket.forget_s:g} s"
        return table.LOST_PACKETS.alarm(now_s, self.device, bucket.level, bucket.capacity, notes=("", drained))


_WINDOW_S: Final = 0.1
_FRACTION_OF_SPEED: Final = 0.1
_CONFIRMED_S: Final = 0.1  # of a mismatch, until it counts


class SpeedCheck:
    """Compares mean speeds of the axes of one device over 0.1 s: reported ones, and those by their positions.

    mismatch_max: allowed difference, m/s or rad/s, in addition to a tenth of the larger speed.
    """

    def __init__(self, mismatch_max: float) -> None:
        self._mismatch_max = mismatch_max
        self.restart()

    def restart(self) -> None:
        """Forget earlier feedback: homing moves the zero, an opened device starts anywhere."""
        self._samples: deque[tuple[float, Array, Array]] = deque()
        self._last_rate: Array | float = 0.0
        self._since_s: Array | float = np.inf

    def update(self, feedback: AxisFeedback) -> tuple[int, float, float] | None:
        """Return axis, reported mean speed and mean speed by its position if they differ for 0.1 s, else None."""
        samples, t_s = self._samples, feedback.t_s
        if samples and t_s <= samples[-1][0]:
            return None
        path = np.zeros(len(feedback.rate))
        if samples:
            before_s, _, path = samples[-1]
            path = path + 0.5 * (t_s - before_s) * (feedback.rate + self._last_rate)
        self._last_rate = feedback.rate
        samples.append((t_s, feedback.position, path))
        while len(samples) > 2 and t_s - samples[1][0] >= _WINDOW_S:
            samples.popleft()
        first_s, position, first_path = samples[0]
        window_s = t_s - first_s
        if window_s < _WINDOW_S:
            return None
        reported, moved = (path - first_path) / window_s, (feedback.position - position) / window_s
        allowed = self._mismatch_max + _FRACTION_OF_SPEED * np.maximum(np.abs(reported), np.abs(moved))
        self._since_s = since_s = np.where(np.abs(reported - moved) > allowed, np.minimum(self._since_s, t_s), np.inf)
        axis = int(since_s.argmin())
        if t_s - since_s[axis] < _CONFIRMED_S:
            return None
        return axis, float(reported[axis]), float(moved[axis])
