"""What happens when cycles come late: nothing but a count, a hold, or a safe stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from hil.core.messages import Array
from hil.errors import SafetyTrip
from hil.loop.rate_keeper import Rate, Tick

_HISTOGRAM_US = tuple(2**power for power in range(17))  # 1 us to 65 ms


class OverrunMonitor:
    """A leaky bucket of lost periods: single ones leak away, a burst trips.

    Each lost period is a drop; the bucket leaks ``allowed`` drops in ``window_s`` of bench time, and trips
    when it holds more than ``allowed``. action: "log" never trips; "hold" hands the trip to ``on_hold``,
    once until the bucket is empty again, and raises it where nobody has set that; "safe_stop" raises it.
    """

    def __init__(self, action: Literal["log", "hold", "safe_stop"], allowed: int, window_s: float) -> None:
        self._action = action
        self._allowed = allowed
        self._window_s = window_s
        self._level = 0.0
        self._looked_s = 0.0
        self._tripped = False
        self.on_hold: Callable[[SafetyTrip], None] | None = None

    def wait(self, rate: Rate) -> Tick:
        """Wait for the next cycle of ``rate``; raise SafetyTrip when too many have come late."""
        tick = rate.wait()
        self.check(tick)
        return tick

    def check(self, tick: Tick) -> None:
        """Take account of the periods that were lost before ``tick``; raise SafetyTrip when they are too many."""
        if not tick.skipped:
            return
        # allowed = 0 leaks as if it were 1: it trips at the first drop in any case
        leaked = (tick.now_s - self._looked_s) * max(self._allowed, 1) / self._window_s
        self._looked_s = tick.now_s
        level = max(self._level - leaked, 0.0)
        self._tripped &= level > 0.0
        self._level = level + tick.skipped
        if self._level <= self._allowed or self._action == "log" or self._tripped:
            return
        self._tripped = True
        trip = SafetyTrip(
            "loop",
            "late cycles",
            f"lost {self._level:.0f} periods (the last cycle ended {tick.overrun_s * 1e3:.1f} ms after its deadline)",
            f"{self._allowed} in {self._window_s:g} s",
        )
        if self._action == "hold" and self.on_hold is not None:
            self.on_hold(trip)
        else:
            raise trip


def lateness_percentiles_us(lateness_s: Array) -> dict[str, float]:
    """Return p50, p99, p999 and max in microseconds."""
    if not len(lateness_s):
        return {"p50": 0.0, "p99": 0.0, "p999": 0.0, "max": 0.0}
    p50, p99, p999, largest = np.percentile(lateness_s * 1e6, [50.0, 99.0, 99.9, 100.0])
    return {"p50": float(p50), "p99": float(p99), "p999": float(p999), "max": float(largest)}


def lateness_histogram(lateness_s: Array) -> list[dict[str, float | int | None]]:
    """Return how many cycles woke up less late than each power of two, us, and not less than the one before.

    The last entry, ``below_us`` None, has those beyond the largest.
    """
    bins = np.searchsorted(_HISTOGRAM_US, lateness_s * 1e6, side="right")
    counts = np.bincount(bins, minlength=len(_HISTOGRAM_US) + 1)
    return [{"below_us": b, "cycles": int(n)} for b, n in zip((*_HISTOGRAM_US, None), counts, strict=True)]
