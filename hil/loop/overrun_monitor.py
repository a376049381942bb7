"""Overrun policy of the loop: log, hold or safe stop; statistics of the cycles' lateness."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from hil.core import alarm_table as table
from hil.core.messages import Array
from hil.errors import SafetyTrip
from hil.loop.rate_keeper import Rate, Tick
from hil.safety.packet_loss import LeakyBucket

_HISTOGRAM_US = tuple(2**power for power in range(17))  # 1 us to 65 ms


class OverrunMonitor:
    """Leaky bucket of lost periods: single losses are tolerated, a burst trips.

    Each lost cycle adds one, a lost tick of axes that are faster than the cycle its part; the level decays by
    ``allowed`` per ``window_s`` of bench time, and trips above ``allowed``. action: "log" never trips; "hold" passes
    the trip to ``on_hold``, once until the bucket is empty again, and raises it if ``on_hold`` is not set; "safe_stop"
    raises it. ticks: of a cycle.
    """

    def __init__(
        self,
        action: Literal["log", "hold", "safe_stop"],
        allowed: int,
        window_s: float,
        ticks: int = 1,
        on_hold: Callable[[SafetyTrip], None] | None = None,
    ) -> None:
        self._action = action
        self._allowed = allowed
        self._window_s = window_s
        self._ticks = ticks
        # allowed = 0 decays like 1: it trips at the first lost period in any case
        self._bucket = LeakyBucket(allowed, window_s / max(allowed, 1))
        self._tripped = False
        self._worst_s: float | None = None
        self._broken: tuple[float, float] | None = None
        self.on_hold = on_hold

    def restart(self) -> None:
        """Begin the margin of a run; what was lost before still leaks away."""
        self._bucket.fullest, self._worst_s, self._broken = self._bucket.level, None, None

    def margin(self) -> dict[str, Any] | None:
        """Return the largest level since the restart against its limit, by the keys of ``Outcome.measured["limits"]``.

        None if lost periods have no effect.
        """
        if self._action == "log":
            return None
        worst = {"value": self._bucket.fullest, "limit": float(self._allowed), "at_s": self._worst_s}
        return worst | {"broken_s": self._broken and self._broken[0], "broken_value": self._broken and self._broken[1]}

    def wait(self, rate: Rate) -> Tick:
        """Wait for the next cycle of ``rate``; raise SafetyTrip after too many lost periods."""
        tick = rate.wait()
        self.check(tick)
        return tick

    def check(self, tick: Tick) -> None:
        """Count the periods lost before ``tick``; raise SafetyTrip if they are too many."""
        if not tick.skipped:
            return
        lost, previous, t_s = tick.skipped / self._ticks, self._bucket.fullest, tick.now_s - tick.run_zero_s
        beyond = self._bucket.add(lost, tick.now_s)
        self._tripped &= self._bucket.level > lost
        if self._bucket.fullest > previous:
            self._worst_s = t_s
        if beyond and self._broken is None:
            self._broken = (t_s, self._bucket.level)
        if not beyond or self._action == "log" or self._tripped:
            return
        self._tripped = True
        late = f" (last cycle ended {tick.overrun_s * 1e3:.1f} ms after its deadline)"
        notes = (late, f" in {self._window_s:g} s")
        trip = table.LOST_PERIODS.trip("loop", self._bucket.level, self._allowed, notes=notes)
        if self._action == "hold" and self.on_hold is not None:
            self.on_hold(trip)
        else:
            raise trip


def lateness_percentiles_us(lateness_s: Array) -> dict[str, Any]:
    """Return p50, p99, p999 and max in microseconds; None if no cycle has a lateness, as in lock-step."""
    finite = lateness_s[np.isfinite(lateness_s)]
    if not len(finite):
        return dict.fromkeys(("p50", "p99", "p999", "max"), None if len(lateness_s) else 0.0)
    p50, p99, p999, largest = np.percentile(finite * 1e6, [50.0, 99.0, 99.9, 100.0])
    return {"p50": float(p50), "p99": float(p99), "p999": float(p999), "max": float(largest)}


def lateness_histogram(lateness_s: Array) -> list[dict[str, float | int | None]]:
    """Return the number of cycles with a lateness below each power of two, us, and not below the previous one.

    The last entry, ``below_us`` None, counts those beyond the largest bound.
    """
    bins = np.searchsorted(_HISTOGRAM_US, lateness_s[np.isfinite(lateness_s)] * 1e6, side="right")
    counts = np.bincount(bins, minlength=len(_HISTOGRAM_US) + 1)
    return [{"below_us": b, "cycles": int(n)} for b, n in zip((*_HISTOGRAM_US, None), counts, strict=True)]
