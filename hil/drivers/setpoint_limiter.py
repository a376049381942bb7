"""Setpoints on their way to the drives: their rate, profiled moves, and the end of a gap.

An axis that has missed some setpoints catches up within the limits of its move.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.core.messages import Array
from hil.models.profile import along_line

_FIRST_PERIOD_S: Final = 0.02
_GAP: Final = 1.5  # multiple of the usual setpoint interval; a drive bridges it by its feed-forward rate
_UNANSWERED: Final = 2.5  # multiple of the same interval without feedback: setpoints may have been lost
_BRIDGED_S: Final = 0.01  # a drive bridges this anyway, however fast setpoints usually come
_SMOOTHING: Final = 0.1  # weight of the newest time between two setpoints
_MISMATCH: Final = 0.05  # fraction of one period's path by which an axis may miss its setpoint after catching up
_SMOOTH: Final = 0.02  # fraction by which the end of catching up may exceed the jerk limit


class SetpointLimiter:
    """Stream of setpoints of one axis, as the drive receives it; m and m/s, or rad and rad/s.

    Setpoints in regular succession pass unchanged: the caller limits them. After a gap (a lost response, a late cycle)
    the newest one may be far from the last one that was delivered, and a drive would go there as fast as it can.
    The stream then continues from where and how fast the axis moves, and catches up within ``set_limits``.

    averaging_s: time of the sliding mean that limits the jerk of setpoints, 0 without a limit. The axis then catches up
    with the setpoint ahead by half of it, and the mean of that path is delivered: its jerk is at most twice the
    acceleration limit per ``averaging_s``.
    """

    def __init__(self, rate_max: float, acceleration_max: float, averaging_s: float = 0.0) -> None:
        self._averaging_s = averaging_s
        self.set_limits(rate_max, acceleration_max)
        self.restart(0.0, 0.0)

    def set_limits(self, rate_max: float, acceleration_max: float) -> None:
        """Set the limits of the present move, m/s and m/s2, or rad/s and rad/s2."""
        self._rate_max, self._acceleration_max = rate_max, acceleration_max

    def restart(self, position: float, now_s: float) -> None:
        """Continue from ``position``, at rest."""
        self._position, self._rate = position, 0.0
        self._set_rate = self._set_acceleration = 0.0
        self._set_s = self._delivered_s = now_s
        self._period_s = _FIRST_PERIOD_S
        self._missed = self._behind = False
        self._mean: _SlidingMean | None = None

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
            begins = not self._behind or self._is_astray(now_s, measured, bridged_s)
            if self._rate != 0.0 and begins:  # the drive has moved further, or has braked
                _, self._position, self._rate = measured
            if self._averaging_s > 0.0 and begins:
                self._position += 0.5 * self._averaging_s * self._rate
                self._mean = _SlidingMean(self._averaging_s, self._position, self._rate)
                self._delivered_s = max(self._delivered_s, now_s - self._period_s)
            self._behind = True
        if elapsed_s > 0.0:
            self._period_s += _SMOOTHING * (min(elapsed_s, 2.0 * self._period_s) - self._period_s)
            change = (rate - self._set_rate) / elapsed_s
            self._set_acceleration = min(self._acceleration_max, max(-self._acceleration_max, change))
        step_s = min(now_s - self._delivered_s, bridged_s)
        self._set_s, self._set_rate, self._delivered_s = max(set_s, self._set_s), rate, now_s
        if self._mean is not None:
            return self._catch_up_smoothly(self._mean, position, rate, step_s)
        if self._behind:
            self._catch_up(position, rate, step_s)
        else:
            self._position, self._rate = position, rate
        return self._position, self._rate

    def _is_astray(self, now_s: float, measured: tuple[float, float, float], bridged_s: float) -> bool:
        """Return whether the axis is further from the stream, while it catches up, than it moves in ``bridged_s``."""
        delivered = self._position if self._mean is None else self._mean.value()[0]
        position = measured[1] + measured[2] * (now_s - measured[0])
        return abs(position - delivered) > self._rate_max * bridged_s

    def _catch_up_smoothly(
        self, mean: _SlidingMean, position: float, rate: float, step_s: float
    ) -> tuple[float, float]:
        """Advance by ``step_s`` towards where the setpoint will be; return the mean on the way there."""
        if step_s > 0.0:
            ahead_s = 0.5 * self._averaging_s
            self._approach(position + ahead_s * rate, rate + ahead_s * self._set_acceleration, step_s)
            mean.add(step_s, self._position)
        smooth, smooth_rate = mean.value()
        change = _SMOOTH * 2.0 * self._acceleration_max / self._averaging_s * step_s * step_s
        if abs(position - smooth) <= change * step_s and abs(rate - smooth_rate) <= change:
            self._position, self._rate, self._behind, self._mean = position, rate, False, None
            return position, rate
        return smooth, smooth_rate

    def _catch_up(self, position: float, rate: float, step_s: float) -> None:
        """Advance by ``step_s`` towards a setpoint that moves at ``rate``; end when it is reached."""
        if step_s <= 0.0:
            return
        behind, change = position - self._position - rate * step_s, self._acceleration_max * step_s
        near = change * step_s + _MISMATCH * abs(rate) * self._period_s
        if abs(behind) <= near and abs(rate - self._rate) <= change:
            self._position, self._rate, self._behind = position, rate, False
            return
        self._approach(position, rate, step_s)

    def _approach(self, position: float, rate: float, step_s: float) -> None:
        """Advance by ``step_s`` towards a setpoint that moves at ``rate``, within the limits."""
        distance = position - self._position
        change = self._acceleration_max * step_s
        behind = distance - rate * step_s
        twice = 2.0 * self._acceleration_max * abs(behind)
        closing = math.sqrt(change * change + twice) - change  # for a setpoint that keeps its rate
        energy = twice + math.copysign(rate * rate, rate * behind)
        ending = math.copysign(math.sqrt(abs(energy)), energy)  # for one that brakes as well
        side = math.copysign(1.0, behind)
        target_rate = side * min(side * rate + closing, ending)
        target_rate = min(self._rate_max, max(-self._rate_max, target_rate))
        self._rate = min(self._rate + change, max(self._rate - change, target_rate))
        self._position += self._rate * step_s


def setpoint_limiters(config: AxisGroupTable) -> list[SetpointLimiter]:
    """Return the limiter of each axis, with the limits of the rig file."""
    return [SetpointLimiter(*axis.limits[2:4], axis.averaging_s) for axis in config.axes]


class _SlidingMean:
    """Mean over the last ``span_s`` of a position that moves in straight pieces, and at ``rate`` before the first."""

    def __init__(self, span_s: float, position: float, rate: float) -> None:
        self._span_s = span_s
        self._origin = position
        self._points = deque([(-span_s, -span_s * rate, 0.0), (0.0, 0.0, -0.5 * span_s * span_s * rate)])
        """Time, s, position from the origin, and its integral since the first point."""

    def add(self, step_s: float, position: float) -> None:
        """Add the position ``step_s`` after the last one."""
        previous_s, previous, integral = self._points[-1]
        moved, t_s = position - self._origin, previous_s + step_s
        self._points.append((t_s, moved, integral + 0.5 * (previous + moved) * step_s))
        while self._points[1][0] <= t_s - self._span_s:
            self._points.popleft()

    def value(self) -> tuple[float, float]:
        """Return the mean and its rate."""
        (first_s, first, first_integral), (second_s, second, _) = self._points[0], self._points[1]
        end_s, end, end_integral = self._points[-1]
        since_s = end_s - self._span_s - first_s
        begin = first + (second - first) * since_s / (second_s - first_s)
        integral = end_integral - first_integral - 0.5 * (first + begin) * since_s
        return self._origin + integral / self._span_s, (end - begin) / self._span_s


_EARLY: Final = 0.125  # fraction of a period: jitter of setpoints at a multiple of the exchange rate


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


class ProfiledMove:
    """Move from ``start`` to ``goal``, at most at ``rate`` and ``acceleration``, all (n,); starts at ``start_s``."""

    def __init__(self, start: Array, goal: Array, rate: Array, acceleration: Array, start_s: float) -> None:
        self._start = start.copy()
        self._path = goal - start
        self._rate = rate
        self._acceleration = acceleration
        self._start_s = start_s
        self._point = np.empty(3)

    def at(self, t_s: float) -> tuple[Array, Array]:
        """Return position and rate, (n,) each, due at ``t_s``."""
        position, rate = self._start.copy(), np.zeros(len(self._start))
        for axis in range(len(position)):
            limit = float(self._acceleration[axis])
            length = abs(float(self._path[axis]))
            along_line(length, float(self._rate[axis]), limit, limit, t_s - self._start_s, self._point)
            sign = np.sign(self._path[axis])
            position[axis] += sign * self._point[0]
            rate[axis] = sign * self._point[1]
        return position, rate


def compile_profile() -> None:
    """Compile the kernel of a profile outside the cycle."""
    one = np.ones(1)
    ProfiledMove(np.zeros(1), one, one, one, 0.0).at(0.5)
