"""Rate of the exchanges with the drives of an axis group: setpoints may come faster, the newest one is sent."""

from __future__ import annotations

import math
from typing import Final

_EARLY: Final = 0.125  # of a period: jitter of setpoints whose rate is a multiple of that of the exchanges


class ExchangePacer:
    """Selects the setpoints that trigger an exchange, at most ``rate_max_hz`` per second of bench time.

    A setpoint between two exchanges is superseded by the next one, and never queued. Exchanges keep to a grid: a late
    one does not delay those after it. After a pause there is one exchange more.
    """

    def __init__(self, rate_max_hz: float) -> None:
        self._period_s = 1.0 / rate_max_hz
        self.restart()

    def restart(self) -> None:
        """Let the next setpoint trigger an exchange, whenever it comes."""
        self._due_s = -math.inf

    def is_due(self, sent_s: float) -> bool:
        """Return whether the setpoint given at ``sent_s`` of bench time triggers an exchange."""
        if sent_s < self._due_s - _EARLY * self._period_s:
            return False
        self._due_s = max(self._due_s + self._period_s, sent_s)
        return True
