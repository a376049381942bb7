"""Cyclic exchange of setpoints and feedback: thread and life cycle shared by drivers of up to six axes.

The caller's side (``send``, ``read``) never blocks. The thread owns the link from ``open`` to ``close``: it exchanges
when a setpoint arrives, at most at the rate of the rig file, and every PERIOD_S without one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.core.clock import BenchClock
from hil.core.messages import Array, AxisFeedback, Homing
from hil.core.plug_ins import call, is_plug_in, plug_in_error
from hil.drivers.axes import SetpointLimits
from hil.drivers.latest import Latest
from hil.drivers.returned import checked_feedback
from hil.drivers.setpoint_limiter import (
    ExchangePacer,
    ProfiledMove,
    SetpointLimiter,
    compile_profile,
    setpoint_limiters,
)
from hil.errors import DeviceError, LinkLost

PERIOD_S = 0.02  # bench time between exchanges when no setpoints arrive
_SETPOINT_DUE_S = 0.03  # after an exchange triggered by a setpoint: no exchange may delay the next setpoint
_RATE_HOLD_S = 0.1  # age of a setpoint from which its position is kept and its rate dropped
_STOP_WALL_S = 0.08  # longest wait of stop and close for the thread


class ExchangeLink(Protocol):
    """Link to the n drives. Calls block for a bounded time; errors are DeviceErrors.

    Positions and rates have shape (n,) and are in m and m/s, or rad and rad/s.
    """

    has_profiles: bool
    """Whether ``move_to`` starts profiled moves of the drives."""
    jogging: bool
    """Whether setpoints are passed on while an axis is not homed; cleared before homing."""

    def open(self) -> AxisFeedback:
        """Connect, enable the drives at their present positions; return these."""

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Send the setpoint; return feedback, None if it is incomplete.

        After ``quick_stop`` and ``move_to``, and while an axis is neither homed nor jogged, the setpoint is not
        passed on and feedback is read only.
        """

    def home(self) -> None:
        """Start homing of the axes that are not homed; feedback reports the progress."""

    def move_to(self, position: Array, rate: Array) -> None:
        """Start profiled moves to ``position``, at most at ``rate``; called only if ``has_profiles``."""

    def quick_stop(self) -> None:
        """Command a quick stop that holds until the next ``open``."""

    def disable(self) -> None:
        """Switch the torque of the drives off until the next ``open``; only after ``quick_stop``."""

    def close(self) -> None:
        """Close the link. Idempotent."""

    def counters(self) -> dict[str, int]:
        """Return the counters since ``open``."""


class CyclicAxisGroup:
    """AxisGroup on an ``ExchangeLink``: rails (m, m/s) or turntable (rad, rad/s).

    After ``stop``, and after homing has failed, the axes hold until the next ``open``, and ``send`` returns the
    position that they hold. The same applies while an axis is not homed, and after ``move_to``.
    """

    def __init__(self, config: AxisGroupTable, clock: BenchClock, link: ExchangeLink, name: str) -> None:
        self.name = name
        self._limits = SetpointLimits(name, config)
        self.axis_names = self._limits.names
        self._config = config
        self._timeout_s = config.timeout_s
        self._clock = clock
        self._link = link
        self._box: Latest[AxisFeedback] = Latest(name)
        self._box.fail(LinkLost(name, "is not open"))
        self._thread: threading.Thread | None = None
        self._wake = clock.event()
        self._closing = threading.Event()
        self._stopping = threading.Event()
        self._stopped = clock.event()
        self._disabling = threading.Event()
        self._disabled = False
        self._homing_requested = threading.Event()
        self._jogging = False
        self._goal: tuple[Array, Array] | None = None
        self._profile: ProfiledMove | None = None
        self._limiters: list[SetpointLimiter] = []
        self._pacer = ExchangePacer(config.exchanges_max_hz)
        self._rest = np.zeros(len(self.axis_names))
        self._setpoint: tuple[Array, Array, float] = (self._rest, self._rest, 0.0)

    def open(self, now_s: float) -> None:
        """Connect, enable the drives, hold the present position. Raises DeviceError."""
        self.close()
        if self._thread is not None and self._thread.is_alive():
            raise LinkLost(self.name, "the previous link has not been closed yet")
        self._box = Latest(self.name)
        for event in (
            self._wake, self._closing, self._stopping, self._stopped, self._disabling, self._homing_requested
        ):  # fmt: skip
            event.clear()
        self._disabled = False
        self._goal = self._profile = None
        self._pacer.restart()
        self._jogging = self._link.jogging = False
        compile_profile()  # outside the cycle
        try:
            feedback = self._checked(self._link.open, call(self.name, self._link.open))
        except DeviceError as error:
            self._box.fail(error)
            raise
        self._setpoint = (feedback.position, self._rest, now_s)
        self._limiters = setpoint_limiters(self._config)
        self._restart_limiters()
        self._box.put(feedback, self._clock.now_s())
        self._thread = self._clock.start_thread(self._run, f"{self.name}-io")

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed; ``read`` reports the progress."""
        self._box.check()
        if not self._stopping.is_set():
            self._homing_requested.set()
            self._wake.set()

    def set_jogging(self, on: bool) -> None:
        feedback = self._box.peek()
        if on and feedback is not None:
            self._setpoint = (feedback.position.copy(), self._rest, self._setpoint[2])
            self._link.jogging = True  # stays set, so that the drives keep receiving a setpoint
        self._jogging = on

    def set_limits(self, rate: Array, acceleration: Array) -> None:
        """Set the limits (n,) within which an axis catches up after a lost response."""
        for limiter, limits in zip(self._limiters, zip(rate.tolist(), acceleration.tolist(), strict=True), strict=True):
            limiter.set_limits(*limits)

    def move_to(self, position: Array, rate: Array, now_s: float) -> Array:
        """Move to ``position`` at most at ``rate`` and hold there; return the accepted goal.

        Used for parking, by profiles of the drives if they have them. Returns at once; later setpoints are rejected
        until the next ``open``. Errors as for ``send``.
        """
        self._box.check()
        goal, speed = self._limits.accepted_goal(position, rate)
        feedback = self._box.peek()
        if feedback is not None and self._rejects_setpoints(feedback):
            return feedback.position.copy()
        self._goal = (goal, speed)
        self._wake.set()
        return goal.copy()

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Set the newest setpoint; return the accepted position.

        The position is limited to the travel and the rate to its limit; an axis limited in position gets rate 0.
        Raises SafetyTrip for a value that is not finite, DeviceError once the link has failed.
        """
        self._box.check()
        accepted, accepted_rate = self._limits.accepted(position, rate, self._jogging)
        feedback = self._box.peek()
        if feedback is not None and (self._goal is not None or self._rejects_setpoints(feedback)):
            return feedback.position.copy()
        self._setpoint = (accepted, accepted_rate, now_s)
        if self._pacer.is_due(now_s):
            self._wake.set()
        return accepted.copy()

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback. Raises LinkTimeout if it is older than ``timeout_s``."""
        feedback = self._box.get(now_s, self._timeout_s)
        if self._homing_requested.is_set():  # not started yet
            begun = (Homing.DONE if state is Homing.DONE else Homing.UNDER_WAY for state in feedback.homing)
            return replace(feedback, homing=tuple(begun))
        return feedback

    def counters(self) -> dict[str, int]:
        """Return the counters of the link since ``open``."""
        return self._link.counters()

    def stop(self, now_s: float) -> None:
        """Quick stop; the axes hold until the next ``open``."""
        self._stopping.set()
        self._wake.set()
        if self._thread is not None:
            self._stopped.wait(_STOP_WALL_S)

    def disable(self, now_s: float) -> None:
        """Switch the torque of the drives off until the next ``open``."""
        self._stopping.set()
        self._disabling.set()
        self._wake.set()

    def close(self) -> None:
        """Quick stop unless already stopped, then close the link."""
        self._closing.set()
        self._wake.set()
        if self._thread is not None:
            self._clock.join(self._thread, _STOP_WALL_S)
        self._box.fail(LinkLost(self.name, "is closed"))

    def _run(self) -> None:
        try:
            self._serve()
        except DeviceError as error:
            self._fail(error)
        except (Exception, SystemExit) as error:  # any error that ends the thread is reported to the cycle
            self._fail(plug_in_error(self.name, error))
        finally:
            self._stopped.set()
            try:
                call(self.name, self._link.close)
            except DeviceError as error:
                self._box.fail(error)

    def _serve(self) -> None:
        triggered = False
        while not self._closing.is_set():
            started_s = self._due_s()
            if self._stopping.is_set() and not self._stopped.is_set():
                self._link.quick_stop()
                self._stopped.set()
            if self._disabling.is_set() and not self._disabled:
                self._link.disable()
                self._disabled = True
            homing = self._homing_requested.is_set() and not self._stopped.is_set()
            if homing:
                self._link.jogging = False
                self._link.home()
            feedback = call(self.name, self._link.exchange, *self._next_setpoint(started_s))
            if feedback is not None:
                self._update(self._checked(self._link.exchange, feedback))
                if homing:
                    self._homing_requested.clear()
            triggered = self._wait(started_s + (_SETPOINT_DUE_S if triggered else PERIOD_S))
        if not self._stopped.is_set():
            self._link.quick_stop()

    def _checked(self, method: Callable[..., object], feedback: AxisFeedback) -> AxisFeedback:
        """Return the feedback that ``method`` of the link has returned. Raises PlugInError if it is none."""
        if not is_plug_in(type(self._link)):
            return feedback
        return checked_feedback(self.name, method, feedback, len(self.axis_names))

    def _due_s(self) -> float:
        """Return the bench time for which the next exchange is due."""
        return self._clock.now_s()

    def _next_setpoint(self, now_s: float) -> tuple[Array, Array]:
        """Return the position and rate due now."""
        position, rate, sent_s = self._setpoint
        if self._goal is not None and not self._stopped.is_set():
            if self._profile is None:
                self._profile = ProfiledMove(position, *self._goal, self._limits.acceleration_max, now_s)
                if self._link.has_profiles:
                    self._link.move_to(*self._goal)
            return self._limited(*self._profile.at(now_s), now_s, now_s)
        return self._limited(position, rate if now_s - sent_s <= _RATE_HOLD_S else self._rest, sent_s, now_s)

    def _limited(self, position: Array, rate: Array, sent_s: float, now_s: float) -> tuple[Array, Array]:
        """Return position and rate to deliver now."""
        feedback = self._box.peek()
        assert feedback is not None
        measured = zip(feedback.position.tolist(), feedback.rate.tolist(), strict=True)
        setpoints = zip(position.tolist(), rate.tolist(), strict=True)
        delivered = [
            limiter.next(*setpoint, sent_s, now_s, (feedback.t_s, *sample))
            for limiter, setpoint, sample in zip(self._limiters, setpoints, measured, strict=True)
        ]
        limited = np.array(delivered)
        return limited[:, 0], limited[:, 1]

    def _restart_limiters(self) -> None:
        """Continue from the present setpoint, at rest."""
        position, _, sent_s = self._setpoint
        for limiter, value in zip(self._limiters, position.tolist(), strict=True):
            limiter.restart(value, sent_s)

    def _update(self, feedback: AxisFeedback) -> None:
        previous = self._box.peek()
        if previous is not None and not _all_homed(previous) and not self._link.jogging:
            # homing moves the zero: an earlier setpoint would refer to the old one
            self._setpoint = (feedback.position.copy(), self._rest, feedback.t_s)
            self._restart_limiters()
        if Homing.FAILED in feedback.homing:
            self._stopping.set()
        self._box.put(feedback, feedback.t_s)

    def _rejects_setpoints(self, feedback: AxisFeedback) -> bool:
        if self._stopping.is_set() or self._homing_requested.is_set():
            return True
        return not (self._jogging or _all_homed(feedback))

    def _wait(self, until_s: float) -> bool:
        """Wait for the next setpoint, at most until ``until_s``; return whether one arrived."""
        left_s = (until_s - self._clock.now_s()) / self._clock.speed
        triggered = self._wake.wait(max(0.0, left_s))
        self._wake.clear()
        return triggered

    def _fail(self, error: DeviceError) -> None:
        """Report ``error`` to the cycle, and try to stop the drives."""
        self._box.fail(error)
        try:
            self._link.quick_stop()
        except Exception as second:  # a consequence of the first error
            error.add_note(f"the quick stop after it could not be sent: {second}")


def _all_homed(feedback: AxisFeedback) -> bool:
    return all(state is Homing.DONE for state in feedback.homing)
