"""A slow move of axes from rest to rest: setpoints for drives that have no profiles of their own."""

from __future__ import annotations

import numpy as np

from hil.core.messages import Array
from hil.models.profile import along_line


class ProfiledMove:
    """From ``start`` to ``goal``, at most at ``rate`` and ``acceleration``, all (n,); begins at ``start_s``."""

    def __init__(self, start: Array, goal: Array, rate: Array, acceleration: Array, start_s: float) -> None:
        self._start = start.copy()
        self._way = goal - start
        self._rate = rate
        self._acceleration = acceleration
        self._start_s = start_s
        self._at = np.empty(3)

    def at(self, t_s: float) -> tuple[Array, Array]:
        """Return position and rate, (n,) each, due at ``t_s``."""
        position, rate = self._start.copy(), np.zeros(len(self._start))
        for axis in range(len(position)):
            limit = float(self._acceleration[axis])
            length = abs(float(self._way[axis]))
            along_line(length, float(self._rate[axis]), limit, limit, t_s - self._start_s, self._at)
            sign = np.sign(self._way[axis])
            position[axis] += sign * self._at[0]
            rate[axis] = sign * self._at[1]
        return position, rate


def compile_glide() -> None:
    """Compile the kernel of a glide before anyone waits for one."""
    one = np.ones(1)
    ProfiledMove(np.zeros(1), one, one, one, 0.0).at(0.5)
