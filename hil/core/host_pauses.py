"""Pauses of the host: times by which it let a thread continue later than planned."""

from __future__ import annotations

from typing import Final

_SHORTEST_S: Final = 0.005  # a shorter one is lateness, and no cause of a silence
_KEPT_S: Final = 1.0


class HostPauses:
    """The pause of a thread that was noted last; times are those of the monotonic clock, s."""

    def __init__(self) -> None:
        self._pause_s, self._at_s = 0.0, 0.0

    def note(self, late_s: float, wall_s: float) -> None:
        """Take a wait that has ended ``late_s`` late at ``wall_s``; it is a pause if it is long enough."""
        if late_s > _SHORTEST_S:
            self._pause_s, self._at_s = late_s, wall_s

    def recent_s(self, wall_s: float) -> float:
        """Return the pause, s, if it was within the last second; 0 otherwise."""
        return self._pause_s if wall_s - self._at_s < _KEPT_S else 0.0


def pause_text(what: str, pause_s: float) -> str:
    """Return a pause of ``what`` as an addition to the text of an alarm, with what to do; "" without one."""
    if pause_s <= 0.0:
        return ""
    return f" (the host paused {what} for {1e3 * pause_s:.0f} ms: end other programs, check with hil preflight)"
