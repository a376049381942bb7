"""Time of a tracker against bench time: offset and drift by its stamps, and the rest of its latency by motion."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.drivers.vmu.unit_clock import UnitClock
from hil.maths import linear
from hil.parts.tracker.frames import TrackedFrame

_SOLVED_EACH: Final = 50  # samples
_UNKNOWN_S: Final = 0.01  # sigma of a latency before any motion
_FLOOR_S: Final = 1e-4  # of its sigma: errors of the encoders' own stamps
_RIDGE: Final = 1e-9
_TERMS: Final = 7  # constant, position and rotation vector, of which an error of geometry is a linear function


class TrackerClock:
    """Clock of a tracker. Its fastest frame of each window counts: what remains of the latency is constant."""

    def __init__(self) -> None:
        self._clock = UnitClock(0.0)

    def bench_s(self, frame: TrackedFrame) -> float:
        """Return the moment of ``frame`` in bench time, s, later than it was by the tracker's least latency."""
        self._clock.add(frame.received_s - frame.stamp_s - frame.age_s, frame.received_s)
        return frame.stamp_s - 1e-6 * self._clock.numbers()["clock_ahead_us"]

    def numbers(self) -> dict[str, int]:
        """Return lead, us, drift, ns/s, and largest step, us, of the clock."""
        return self._clock.numbers()


class LatencyEstimate:
    """Latency of a tracker behind the encoders, by least squares on the difference of their poses while axes move.

    A pose that is late by x is behind by x times the rate. Errors of geometry are not latency: a linear function of the
    pose is estimated as well. sigmas: of the six components, m and rad.
    """

    def __init__(self, sigmas: Array) -> None:
        self._weights = 1.0 / np.square(sigmas)
        self._first: Array | None = None
        self._n = 0
        self._zz = np.zeros((_TERMS, _TERMS))
        self._zv, self._zd = np.zeros((_TERMS, 6)), np.zeros((_TERMS, 6))
        self._vv, self._vd = np.zeros(6), np.zeros(6)
        self.value_s, self.sigma_s = 0.0, _UNKNOWN_S
        """Latency and its standard deviation, s; close to 0, and large, before there is motion."""

    def add(self, off: Array, pose: Array, rate: Array) -> None:
        """Add a sample: tracker less encoders (6,), as if there were no latency, pose (6,) and rate (6,) by these.

        Components that are not measured are nan.
        """
        off, rate = np.nan_to_num(off), np.where(np.isnan(off), 0.0, rate)
        self._first = pose.copy() if self._first is None else self._first
        z = np.concatenate([[1.0], pose - self._first])
        self._zz += z[:, None] * z
        self._zv -= z[:, None] * rate
        self._zd += z[:, None] * off
        self._vv += rate * rate
        self._vd -= rate * off
        self._n += 1
        if self._n % _SOLVED_EACH == 0:
            self._solve()

    def _solve(self) -> None:
        diagonal = self._zz.diagonal()
        zz = self._zz + np.diag(_RIDGE * diagonal + 1e-12)
        both = linear.solve(zz, np.column_stack([self._zv, self._zd]))
        of_rate, of_off = both[:, :6], both[:, 6:]
        information = (self._vv - (self._zv * of_rate).sum(axis=0)) * self._weights
        moment = (self._vd - (self._zv * of_off).sum(axis=0)) * self._weights
        total = linear.total(np.maximum(information, 0.0)) + 1.0 / (_UNKNOWN_S * _UNKNOWN_S)
        self.value_s = linear.total(moment) / total
        self.sigma_s = max(_FLOOR_S, 1.0 / math.sqrt(total))
