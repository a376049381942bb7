"""Cycles of a robot that sends a datagram in each of them: their times by the robot's own clock, answers and counts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Generic, NamedTuple, TypeVar

from hil.core.clock import BenchClock
from hil.drivers.datagrams import DatagramPort
from hil.errors import LinkLost, LinkTimeout

_GAIN, _DRIFT_GAIN = 0.1, 0.0025  # critically damped, per cycle
_SLEW: Final = 0.25  # largest correction, of the time between two cycles: time never turns back
_RATES: Final = (0.8, 1.5)  # cycles of emulated controllers last longer than they say
_POLLS: Final = 0.25  # of the longest silence
_ROUNDING_S: Final = 1e-6
_UNREAD: Final = 100  # cycles that are passed over at once, at most
_LOST_S: Final = 0.05  # arrival that late against its estimate: the estimate restarts

State = TypeVar("State")


class RobotTime:
    """Bench time of a robot's cycles: offset and drift of its clock, from arrivals that vary."""

    def __init__(self) -> None:
        self.t_s = self._robot_s = 0.0
        self.rate = 0.0
        """Bench seconds per second of the robot, 0 before the second cycle."""

    def update(self, robot_s: float, arrived_s: float) -> float:
        """Return the bench time of the cycle at ``robot_s`` of the robot's clock, which arrived at ``arrived_s``."""
        elapsed_s, self._robot_s = robot_s - self._robot_s, robot_s
        expected_s = self.t_s + self.rate * elapsed_s
        error_s = arrived_s - expected_s
        if self.rate == 0.0 or elapsed_s <= 0.0 or error_s > _LOST_S:
            self.t_s, self.rate = arrived_s, self.rate or 1.0
            return self.t_s
        within_s = min(_SLEW * elapsed_s, max(-_SLEW * elapsed_s, _GAIN * error_s))
        change = _DRIFT_GAIN / _GAIN * within_s / elapsed_s
        self.rate = min(_RATES[1], max(_RATES[0], self.rate + change))
        self.t_s = expected_s + within_s
        return self.t_s


class Cycle(NamedTuple, Generic[State]):
    """A cycle of the robot. number: of the datagram. robot_s: time by the robot's clock. state: what it sends."""

    number: int
    robot_s: float
    state: State


class RobotCycles(Generic[State]):
    """Wire of a robot. decode: returns the cycle of a datagram, raises ValueError for one that is damaged.

    step: of the numbers of two consecutive cycles. timeout_s: longest silence, bench time. name: of the device.
    """

    def __init__(
        self,
        clock: BenchClock,
        decode: Callable[[bytes], Cycle[State]],
        step: int,
        period_s: float,
        timeout_s: float,
        name: str,
    ) -> None:
        self._clock, self._decode, self._step, self._name = clock, decode, step, name
        self._period_s, self._timeout_s = period_s, timeout_s
        self._port: DatagramPort | None = None
        self.counts = dict.fromkeys(("exchanges", "lost", "protocol_errors", "duplicates", "late_answers"), 0)

    def open(self, host: str, port: int) -> None:
        """Open the port. Raises LinkLost, also if another program has it."""
        self.close()
        self._time, self._last = RobotTime(), None
        self._received_s = self._clock.now_s()
        self.counts = dict.fromkeys(self.counts, 0)
        try:
            self._port = DatagramPort(
                self._clock, host, port, self._clock.wall_s(_POLLS * self._timeout_s), answered=True
            )
        except OSError as error:
            raise LinkLost(self._name, f"cannot open udp {host}:{port}: {error.strerror or error}") from error

    _last: int | None = None

    @property
    def t_s(self) -> float:
        """Bench time of the last cycle."""
        return self._time.t_s

    @property
    def drift(self) -> float:
        """Bench seconds per second of the robot's clock, less 1."""
        return self._time.rate - 1.0 if self._time.rate else 0.0

    def next(self, may_be_silent: bool = False) -> Cycle[State] | None:
        """Return the newest cycle, None without a new one. Raises LinkTimeout after a silence, LinkLost.

        Cycles before it, which a pause of the host leaves unread, can be answered in time no more.
        """
        if self._port is None:
            raise LinkLost(self._name, "is not open")
        try:
            cycle = self._new_cycle(self._port.read())
            for _ in range(_UNREAD):
                if not self._port.is_readable:
                    break
                newer = self._new_cycle(self._port.read())
                self.counts["late_answers"] += cycle is not None and newer is not None
                cycle = newer or cycle
        except OSError as error:
            raise LinkLost(self._name, f"udp port failed: {error}") from error
        now_s = self._clock.now_s()
        if cycle is None:
            silent_s = now_s - self._received_s
            if silent_s > self._timeout_s - _ROUNDING_S and not may_be_silent:
                raise LinkTimeout(self._name, f"no cycle for {silent_s:.3f} s, allowed {self._timeout_s:g} s")
            return None
        self._received_s = now_s
        self._time.update(cycle.robot_s, now_s)
        return cycle

    def _new_cycle(self, data: bytes) -> Cycle[State] | None:
        """Return the cycle of a datagram, None of a damaged or repeated one; counts what came and what is missing."""
        try:
            cycle = self._decode(data) if data else None
        except ValueError:
            self.counts["protocol_errors"] += 1
            return None
        if cycle is None or cycle.number == self._last:
            self.counts["duplicates"] += cycle is not None
            return None
        if self._last is not None and 1 < (gap := (cycle.number - self._last) // self._step) < 1000:
            self.counts["lost"] += gap - 1
        self._last = cycle.number
        self.counts["exchanges"] += 1
        return cycle

    def answer(self, data: bytes) -> None:
        """Answer the last cycle; counts an answer that leaves in the second half of the cycle."""
        if self._port is not None:
            self.counts["late_answers"] += self._clock.now_s() - self.t_s > 0.5 * self._period_s
            try:
                self._port.answer(data)
            except OSError as error:
                raise LinkLost(self._name, f"udp port failed: {error}") from error

    def close(self) -> None:
        """Close the port. Idempotent."""
        port, self._port = self._port, None
        if port is not None:
            port.close()
