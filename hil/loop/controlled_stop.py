"""Controlled stop of the bench: stop category 1 of IEC 60204-1 (SS1 of IEC 61800-5-2).

Each axis brakes along its ramp, watched by its encoder, and loses its torque once all axes stand. An axis that leaves
its ramp, or is not seen to follow it, loses its torque at once: category 0. The holding brakes of gravity-loaded axes
close before the torque goes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.messages import Array
from hil.drivers.base import AxisGroup
from hil.errors import BenchError, DriveFault, FaultKind, LinkLost, PlugInError, SafetyTrip
from hil.loop.cycle import Loop
from hil.loop.rate_keeper import Rate

REACTION_S: Final = 0.12
"""Allowed from the command until an axis brakes: wire, drive, and the age of its feedback."""
OFF_RAMP_S: Final = 0.1
"""Time above the ramp after which an axis loses its torque."""
STANDSTILL_S: Final = 0.1
"""Time at rest after which an axis counts as standing."""
BRAKE_CONFIRMED_S: Final = 0.1
"""Beyond the time of the brakes, until their contact must be read in its new position."""


@dataclass(frozen=True, slots=True)
class BrakeTimes:
    """Holding brakes of gravity-loaded axes: closing and opening time, s; 0 without such an axis."""

    close_s: float = 0.0
    open_s: float = 0.0


class Ramp:
    """Speeds of the axes of a device during a stop, against the ramp that each must follow.

    deceleration (n,): of the ramps, m/s2 or rad/s2. rest: speed below which an axis counts as at rest, also the
    tolerance of the ramp, m/s or rad/s. stopped_s: bench time of the command. rotates: they rotate, rad and rad/s.
    """

    def __init__(
        self, axes: AxisGroup, deceleration: Array, rest: float, stopped_s: float, rotates: bool = False
    ) -> None:
        self.axes = axes
        self._rotates = rotates
        self.rested_s = stopped_s
        """Bench time since which all axes are at rest; inf while one moves."""
        self._deceleration = deceleration
        self._rest = rest
        self._stopped_s = stopped_s
        self._seen: deque[tuple[float, Array]] = deque()
        self._lost_since_s = math.inf
        self._off_since_s = np.full(len(deceleration), math.inf)
        self._first: Array | None = None
        self.failure: PlugInError | None = None
        """What the driver of the axes has raised during the stop."""
        with suppress(BenchError):
            self._first = np.abs(axes.read(stopped_s).rate)

    @property
    def end_s(self) -> float:
        """Bench time at which the axes must stand: their ramps, and the times of standstill and of a late detection."""
        longest = 0.0 if self._first is None else float((self._first / self._deceleration).max())
        return self._stopped_s + REACTION_S + longest + OFF_RAMP_S + 2.0 * STANDSTILL_S

    def is_lost(self, now_s: float) -> bool:
        """Return whether the feedback has been missing for ``OFF_RAMP_S``; the fault of the stop is its cause."""
        return now_s - self._lost_since_s >= OFF_RAMP_S

    def check(self, now_s: float) -> Alarm | None:
        """Return the alarm of an axis that has left its ramp for ``OFF_RAMP_S``, None if all follow it."""
        try:
            feedback = self.axes.read(now_s)
        except BenchError as error:
            self.failure = error if isinstance(error, PlugInError) else self.failure
            self.rested_s = math.inf
            self._lost_since_s = min(self._lost_since_s, now_s)
            return None
        self._lost_since_s = math.inf
        speed = np.abs(feedback.rate)
        if self._first is None:
            self._first = speed
        excess = np.maximum(speed - self._allowed(now_s), self._mean_speed(now_s, feedback.position))
        self._off_since_s = np.where(excess > 0.0, np.minimum(self._off_since_s, now_s), math.inf)
        self.rested_s = min(self.rested_s, now_s) if speed.max() <= self._rest else math.inf
        axis = int(self._off_since_s.argmin())
        if now_s - self._off_since_s[axis] < OFF_RAMP_S:
            return None
        allowed, name = float(self._allowed(now_s)[axis]), self.axes.axis_names[axis]
        return table.SPEED_IN_A_STOP.alarm(now_s, name, allowed + excess[axis], allowed, rotates=self._rotates)

    def _allowed(self, now_s: float) -> Array:
        """Return the highest speed (n,) that the ramps allow at ``now_s``."""
        assert self._first is not None
        braked_s = max(0.0, now_s - self._stopped_s - REACTION_S)
        return np.asarray(np.maximum(0.0, self._first - self._deceleration * braked_s) + self._rest)

    def _mean_speed(self, now_s: float, position: Array) -> Array:
        """Return by how much the mean speed over the last ``OFF_RAMP_S`` is above the ramp at their begin, (n,).

        It comes from the change of position: a drive may report another speed than its axis has.
        """
        self._seen.append((now_s, position))
        while len(self._seen) > 2 and now_s - self._seen[1][0] >= OFF_RAMP_S:
            self._seen.popleft()
        since_s, start = self._seen[0]
        if now_s - since_s < OFF_RAMP_S:
            return np.full(len(position), -math.inf)
        return np.asarray(np.abs(position - start) / (now_s - since_s) - self._allowed(since_s))


class ControlledStop:
    """One stop of the bench: ``brake``, then ``remove_torque``.

    brakes: holding brakes of the gravity-loaded axes. ended: whether the operator ends a watched operational stop,
    called with the bench time in each cycle of it.
    """

    def __init__(self, loop: Loop, rate: Rate, brakes: BrakeTimes, ended: Callable[[float], bool]) -> None:
        self._loop = loop
        self._rate = rate
        self._brakes = brakes
        self._ended = ended
        self.cut = False
        """Whether an axis lost its torque before all stood."""

    def brake(self, each: Callable[[float], None] = lambda _: None) -> None:
        """Stop all axes and wait until they stand, or until one has lost its torque. Never raises BenchError.

        each: called with the bench time of each cycle.
        """
        loop, now_s = self._loop, self._rate.now_s()
        self._ramps = self._begin(now_s)
        loop.bench.stop(now_s)
        loop.target.stop(now_s)
        each(now_s)
        while not (self.cut or self._stands(now_s)):
            now_s = self.watch()
            if now_s > max(ramp.end_s for ramp in self._ramps) and not self.cut:
                self._cut(now_s)
            each(now_s)

    def remove_torque(self) -> None:
        """Close the holding brakes, wait until they hold, then switch the torque off. Never raises BenchError."""
        if self.cut:
            return
        now_s = self._rate.now_s()
        if self._brakes.close_s > 0.0:
            self._loop.safety_io.release_brakes(False, now_s)
            now_s = self._wait_for_brakes(now_s)
        if self.cut:
            return
        self._loop.bench.disable(now_s)
        self._loop.target.disable(now_s)
        end_s = now_s + self._brakes.close_s  # of drives that close their brakes themselves
        while now_s < end_s:
            now_s = self._rate.wait().now_s
            self._loop.safety_io.keep_closed(now_s)
        self._loop.safety_io.stop(now_s)

    @property
    def failures(self) -> list[PlugInError]:
        """What drivers have raised during the stop."""
        return [ramp.failure for ramp in self._ramps if ramp.failure is not None]

    def _begin(self, now_s: float) -> list[Ramp]:
        bench, limits = self._loop.bench, self._loop.bench.safety.limits
        deceleration = bench.params.acceleration_max
        ramps = [
            Ramp(bench.rails, deceleration[:3], limits.rest_mps, now_s),
            Ramp(bench.turntable, deceleration[3:], limits.rest_radps, now_s, rotates=True),
        ]
        for group in self._loop.target.groups:
            rest = limits.rest_radps if group.rotates else limits.rest_mps
            ramps.append(Ramp(group.axes, group.acceleration_max, rest, now_s, group.rotates))
        return ramps

    def _stands(self, now_s: float) -> bool:
        return all(now_s - ramp.rested_s >= STANDSTILL_S for ramp in self._ramps)

    def watch(self) -> float:
        """Wait for the next cycle and check all axes; return its bench time."""
        now_s = self._rate.wait().now_s
        self._loop.safety_io.keep_closed(now_s)
        alarms = [alarm for ramp in self._ramps if (alarm := ramp.check(now_s))]
        if alarms or any(ramp.is_lost(now_s) for ramp in self._ramps):
            self._cut(now_s)
        for alarm in alarms:
            self._loop.bench.safety.alarms.latch(alarm)
        return now_s

    def _cut(self, now_s: float) -> None:
        """Switch the torque of all axes off: drives of one safety relay lose it together."""
        self.cut = True
        self._loop.safety_io.stop(now_s)
        self._loop.bench.disable(now_s)
        self._loop.target.disable(now_s)

    def _wait_for_brakes(self, now_s: float) -> float:
        """Wait until the brakes have closed; return the bench time.

        While their contact does not read closed, the axes stay in a watched operational stop (SOS), with an alarm,
        until the contact closes or the operator ends it.
        """
        closed_s = now_s + self._brakes.close_s
        reported = False
        while not self.cut and (now_s < closed_s or self._loop.safety_io.brakes_closed(now_s) is False):
            now_s = self.watch()
            if reported and self._ended(now_s):
                break
            if not reported and now_s > closed_s + BRAKE_CONFIRMED_S:
                reported = True
                alarm = table.HOLDING_BRAKES.alarm(now_s, "io", "not closed: axes held by their drives", "closed")
                self._loop.bench.safety.alarms.latch(alarm)
        return now_s


_ESTOP_DETECTED_S: Final = 0.06  # bench time: the coupler is polled every 20 ms
_COUPLER_LOSS_DETECTED_S: Final = 0.6  # until a dead coupler is detected


class RootCause:
    """Search for the root cause of ``fault`` while the bench is being stopped.

    An emergency stop, an opened interlock or a dead coupler removes the torque, and the drives may report that before
    the safety chain is read. The search ends when the chain has been read; in simulated time it ends at once.
    A fault before the drives were ``powered`` has no other cause: devices may not be open yet.
    """

    def __init__(self, fault: BenchError, loop: Loop, rate: Rate, powered: bool = True) -> None:
        self._fault = fault
        self._loop = loop
        torque_is_off = isinstance(fault, DriveFault) and fault.kind is FaultKind.TORQUE_OFF
        wait_s = _COUPLER_LOSS_DETECTED_S if torque_is_off else _ESTOP_DETECTED_S
        self._end_s = rate.now_s() + wait_s
        self._found = not powered or not loop.safety_io.has_chain or not rate.paced

    def poll(self, now_s: float, chain_opened: bool) -> BenchError | None:
        """Return the root cause, which may be the fault itself; None until it is found.

        chain_opened: the stop has opened the safety chain, which is then no cause.
        """
        if self._found or now_s >= self._end_s:
            return self._fault
        bench = self._loop.bench
        try:
            bench.poll_safety_inputs(now_s)
            if (alarm := bench.safety.interlock_power(now_s)) is not None:
                return alarm.trip()
            self._loop.safety_io.check(now_s)
        except BenchError as cause:
            if isinstance(self._fault, LinkLost | PlugInError):  # a root cause itself
                return self._fault
            if not (chain_opened and isinstance(cause, SafetyTrip) and cause.alarm.code == table.SAFETY_CHAIN.code):
                return cause
        return None
