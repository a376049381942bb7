"""Profiled move from rest to rest: setpoints for drives without profiles of their own."""

from __future__ import annotations

import numpy as np

from hil.core.messages import Array
from hil.models.profile import along_line


class ProfiledMove:
    """Move from ``start`` to ``goal``, at most at ``rate`` and ``acceleration``, all (n,); starts at ``start_s``."""

    def __init__(self, start: Array, goal: Array, rate: Array, acceleration: Array, start_s: float) -> None:
        self._start = start.copy()
        self._path = goal - start
        self._rate = rate
        self._acceleration = acceleration
        self._start_s = start_s
        self._point = np.empty(3)

    def at(self, t_s: float) -> tuple[Array, Array]:
        """Return position and rate, (n,) each, due at ``t_s``."""
        position, rate = self._start.copy(), np.zeros(len(self._start))
        for axis in range(len(position)):
            limit = float(self._acceleration[axis])
            length = abs(float(self._path[axis]))
            along_line(length, float(self._rate[axis]), limit, limit, t_s - self._start_s, self._point)
            sign = np.sign(self._path[axis])
            position[axis] += sign * self._point[0]
            rate[axis] = sign * self._point[1]
        return position, rate


def compile_profile() -> None:
    """Compile the kernel of a profile outside the cycle."""
    one = np.ones(1)
    ProfiledMove(np.zeros(1), one, one, one, 0.0).at(0.5)
