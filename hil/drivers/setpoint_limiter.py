"""Setpoints on the wire after a gap: an axis that has missed some catches up within the limits of its move."""

from __future__ import annotations

import math
from typing import Final

_FIRST_PERIOD_S: Final = 0.02
_GAP: Final = 1.5  # of the usual time between two setpoints; a drive bridges that by its feed-forward rate
_UNANSWERED: Final = 2.5  # of the same time, without feedback: setpoints may have been lost on the way
_BRIDGED_S: Final = 0.01  # a drive bridges this anyway, however fast setpoints usually come
_SMOOTHING: Final = 0.1  # weight of the newest time between two setpoints
_MISMATCH: Final = 0.05  # of the path of one period, by which an axis may miss its setpoint when it has caught up


class SetpointLimiter:
    """Stream of setpoints of one axis, as the drive receives it; m and m/s, or rad and rad/s.

    Setpoints in regular succession pass unchanged: the caller limits them. After a gap (a lost response, a late cycle)
    the newest one may be far from the last one that was delivered, and a drive would go there as fast as it can.
    The stream then continues from where and how fast the axis moves, and catches up within ``set_limits``.
    """

    def __init__(self, rate_max: float, acceleration_max: float) -> None:
        self.set_limits(rate_max, acceleration_max)
        self.restart(0.0, 0.0)

    def set_limits(self, rate_max: float, acceleration_max: float) -> None:
        """Set the limits of the present move, m/s and m/s2, or rad/s and rad/s2."""
        self._rate_max, self._acceleration_max = rate_max, acceleration_max

    def restart(self, position: float, now_s: float) -> None:
        """Continue from ``position``, at rest."""
        self._position, self._rate = position, 0.0
        self._set_s = self._delivered_s = now_s
        self._period_s = _FIRST_PERIOD_S
        self._missed = self._behind = False

    def next(
        self, position: float, rate: float, set_s: float, now_s: float, measured: tuple[float, float, float]
    ) -> tuple[float, float]:
        """Return the position and rate to deliver at ``now_s`` for the setpoint that was given at ``set_s``.

        measured: bench time, s, position and rate of the axis; old if the drive has not answered.
        """
        elapsed_s = max(0.0, set_s - self._set_s)
        bridged_s = max(_GAP * self._period_s, _BRIDGED_S)
        unanswered = now_s - measured[0] > max(_UNANSWERED * self._period_s, _BRIDGED_S)
        self._missed = self._missed or unanswered or elapsed_s > bridged_s
        if self._missed and not unanswered:
            self._missed = False
            if self._rate != 0.0 and not self._behind:  # the drive has moved further, or has braked
                _, self._position, self._rate = measured
            self._behind = True
        if elapsed_s > 0.0:
            self._period_s += _SMOOTHING * (min(elapsed_s, 2.0 * self._period_s) - self._period_s)
        if self._behind:
            self._catch_up(position, rate, min(now_s - self._delivered_s, bridged_s))
        else:
            self._position, self._rate = position, rate
        self._set_s, self._delivered_s = max(set_s, self._set_s), now_s
        return self._position, self._rate

    def _catch_up(self, position: float, rate: float, step_s: float) -> None:
        """Advance by ``step_s`` towards a setpoint that moves at ``rate``."""
        if step_s <= 0.0:
            return
        distance = position - self._position
        change = self._acceleration_max * step_s
        behind = distance - rate * step_s
        near = change * step_s + _MISMATCH * abs(rate) * self._period_s
        if abs(behind) <= near and abs(rate - self._rate) <= change:
            self._position, self._rate, self._behind = position, rate, False
            return
        twice = 2.0 * self._acceleration_max * abs(behind)
        closing = math.sqrt(change * change + twice) - change  # of a setpoint that moves on at its rate
        energy = twice + math.copysign(rate * rate, rate * behind)
        ending = math.copysign(math.sqrt(abs(energy)), energy)  # of one that brakes as well
        side = math.copysign(1.0, behind)
        wanted = side * min(side * rate + closing, ending)
        wanted = min(self._rate_max, max(-self._rate_max, wanted))
        self._rate = min(self._rate + change, max(self._rate - change, wanted))
        self._position += self._rate * step_s
