"""Losses of a link or of the loop: single ones are tolerated, bursts raise an alarm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hil.safety.alarms import Alarm


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
        limit = f"{bucket.capacity:g} at once, 1 per {bucket.forget_s:g} s"
        return Alarm(now_s, self.device, "lost packets", f"{bucket.level:.1f}", limit)
