"""Clock of the vision unit against bench time, from the ages of its frames: reception less time stamp."""

from __future__ import annotations

import math

WINDOW = 64
"""Frames of one estimate; its fastest frame counts."""


class UnitClock:
    """Estimate with bounded memory. transmission_s: known time from exposure to reception of the fastest frame.

    A frame takes at least ``transmission_s``, so a unit whose fastest frame is younger by x has a clock that is ahead
    of bench time by at least x. A delay that is not in ``transmission_s`` hides as much of it, but not its drift.
    """

    def __init__(self, transmission_s: float) -> None:
        self._transmission_s = transmission_s
        self._frames = 0
        self._least_s = math.inf
        self._at_s = 0.0
        self._first: tuple[float, float] | None = None  # bench time and least age of the first complete window
        self._last: tuple[float, float] | None = None
        self._step_s = 0.0

    def add(self, age_s: float, received_s: float) -> None:
        """Add a frame of ``age_s``, received at ``received_s`` of bench time."""
        if age_s < self._least_s:
            self._least_s, self._at_s = age_s, received_s
        self._frames += 1
        if self._frames < WINDOW:
            return
        sample = self._at_s, self._least_s
        if self._last is not None:
            self._step_s = max(self._step_s, abs(sample[1] - self._last[1]))
        self._first, self._last = self._first or sample, sample
        self._frames, self._least_s = 0, math.inf

    def numbers(self) -> dict[str, int]:
        """Return the least lead of the clock, us, its drift, ns/s, and its largest change between windows, us."""
        first, last = self._first, self._last
        least_s = last[1] if last is not None else self._least_s
        drift = 0.0
        if first is not None and last is not None and last[0] > first[0]:
            drift = (first[1] - last[1]) / (last[0] - first[0])
        return {
            "clock_ahead_us": round(1e6 * (self._transmission_s - least_s)) if math.isfinite(least_s) else 0,
            "clock_drift_ppb": round(1e9 * drift),
            "clock_step_us": round(1e6 * self._step_s),
        }
