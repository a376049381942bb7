"""Second source of an axis' speed: the drive's report against the change of its position."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from hil.core.messages import Array, AxisFeedback

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
