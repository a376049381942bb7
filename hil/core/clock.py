"""Bench time: seconds since the bench was opened. Time is injected as a clock or a number."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Protocol


class Clock(Protocol):
    """Bench time in seconds; ``speed`` is relative to real time (inf: no wall clock)."""

    @property
    def speed(self) -> float: ...

    def now_s(self) -> float: ...


@dataclass(slots=True)
class SimulatedClock:
    """Time that changes only when ``t_s`` is set."""

    t_s: float = 0.0
    speed: float = field(default=float("inf"), init=False)

    def now_s(self) -> float:
        return self.t_s


@dataclass(frozen=True, slots=True)
class WallClock:
    """The monotonic clock of this host, scaled. Processes that share ``epoch_ns`` share bench time."""

    epoch_ns: int = field(default_factory=time.monotonic_ns)
    speed: float = 1.0

    def now_s(self) -> float:
        return (time.monotonic_ns() - self.epoch_ns) * 1e-9 * self.speed

    def wall_ns(self, t_s: float) -> int:
        """Return the monotonic time, ns, at which bench time will be ``t_s``."""
        return self.epoch_ns + round(t_s / self.speed * 1e9)

    def wall_s(self, duration_s: float) -> float:
        """Return ``duration_s`` of bench time in s of wall time."""
        return duration_s / self.speed

    def paced_s(self, period_s: float) -> float:
        """Return the bench time between two steps of work of this host that is due every ``period_s`` in real time.

        Above real time the steps follow one another as fast as in real time: the host is no faster than before.
        """
        return period_s * max(1.0, self.speed)

    def sleep_until(self, t_s: float) -> None:
        """Sleep until bench time ``t_s``; return at once if that has passed."""
        left_ns = self.wall_ns(t_s) - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns * 1e-9)


def utc_ns() -> int:
    """Return nanoseconds since 1970, UTC."""
    return time.time_ns()


def utc_text(time_ns: int | None = None) -> str:
    """Return ``2026-03-01T14:05:06.123Z`` of ``time_ns``, by default of now; the texts sort by time."""
    when = datetime.fromtimestamp((utc_ns() if time_ns is None else time_ns) * 1e-9, UTC)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")
