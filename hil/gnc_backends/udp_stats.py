"""Statistics of the link to a GNC: round trips, delays and missing replies, as numbers for JSON."""

from __future__ import annotations

import math
import time
from typing import Any, Final

import numpy as np

from hil.frmn.link import Link

_SENT: Final = 1024  # inputs whose time of sending is kept


class LinkStats:
    """Counts the outcome of each input. mode: "lock-step" or "free-running"."""

    def __init__(self, link: Link, mode: str) -> None:
        self.mode = mode
        self.coasted = self.closed = 0
        """Cycles without a reply in which the last command was kept; in which all thrusters were closed."""
        self.late = 0
        """Replies that came after the timeout of their cycle."""
        self.resent = 0
        self.losses = 0
        self._link = link
        self._sent_s = np.full(_SENT, math.nan)
        self._round_trips_s: list[float] = []
        self._delays: dict[int, int] = {}

    def sent(self, cycle: int) -> None:
        """Record that the input ``cycle`` is sent now."""
        self._sent_s[cycle % _SENT] = time.monotonic()

    def answered(self, cycle: int, received_s: float) -> None:
        """Record that the reply to input ``cycle`` came at ``received_s``, monotonic time."""
        self._round_trips_s.append(received_s - float(self._sent_s[cycle % _SENT]))
        self._sent_s[cycle % _SENT] = math.nan

    def used(self, delay: int) -> None:
        """Record that a reply acts ``delay`` cycles after its input."""
        self._delays[delay] = self._delays.get(delay, 0) + 1

    def as_json(self) -> dict[str, Any]:
        """Return all statistics; unknown ones are None."""
        trips_us = 1e6 * np.array([trip for trip in self._round_trips_s if math.isfinite(trip)])
        clock, used = self._link.clock, sum(self._delays.values())
        return {
            "mode": self.mode,
            "round_trip_us": {
                name: float(np.percentile(trips_us, percent)) if len(trips_us) else None
                for name, percent in (("p50", 50.0), ("p99", 99.0), ("max", 100.0))
            },
            "delay_cycles": sum(delay * n for delay, n in self._delays.items()) / used if used else None,
            "delay_cycles_max": max(self._delays, default=None),
            "answers": used,
            "coasted_cycles": self.coasted,
            "closed_cycles": self.closed,
            "late": self.late,
            "resent": self.resent,
            "losses": self.losses,
            "joined": self._link.joined,
            "clock_offset_us": 1e6 * clock.offset_s if clock.known else None,
            "clock_round_trip_us": 1e6 * clock.round_trip_s if clock.known else None,
            **self._link.counters(),
            "refused": list(self._link.complaints),
        }
