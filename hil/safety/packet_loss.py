"""Losses on a wire: single packets are forgiven, bursts are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hil.safety.alarms import Alarm


@dataclass(slots=True)
class LeakyBucket:
    """Fills by one a lost packet, leaks one in ``forget_s``; more than ``capacity`` in it is too many."""

    capacity: float
    forget_s: float
    level: float = 0.0
    _looked_s: float = -float("inf")

    def add(self, n: int, t_s: float) -> bool:
        """Put in ``n`` packets lost up to ``t_s``; return whether that is too many.

        Time that runs backwards leaks nothing.
        """
        if t_s > self._looked_s:
            self.level = max(0.0, self.level - (t_s - self._looked_s) / self.forget_s)
            self._looked_s = t_s
        self.level += n
        return self.level > self.capacity

    def empty(self) -> None:
        self.level = 0.0


class LinkWatch:
    """One device's bucket, fed by a counter that only grows (a smaller number than before: it began anew)."""

    def __init__(self, device: str, bucket: LeakyBucket, lost: Callable[[], int]) -> None:
        self.device = device
        self._bucket = bucket
        self._lost = lost
        self._before = 0

    def restart(self) -> None:
        """Forget what was lost so far: the link was opened anew."""
        self._before = self._lost()
        self._bucket.empty()

    def check(self, now_s: float) -> Alarm | None:
        """Return an alarm where too many packets were lost lately."""
        count = self._lost()
        new = max(0, count - self._before)
        self._before = count
        if not self._bucket.add(new, now_s):
            return None
        bucket = self._bucket
        limit = f"{bucket.capacity:g} at once, 1 in {bucket.forget_s:g} s"
        return Alarm(now_s, self.device, "lost packets", f"{bucket.level:.1f}", limit)
