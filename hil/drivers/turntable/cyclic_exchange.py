"""The life that both turntable drivers share: one thread exchanges setpoints for feedback over a link.

The loop's side (``send``, ``read``) only touches boxes. The thread's side owns the link from
``open`` to ``close``: it exchanges as soon as a setpoint is there, and every PERIOD_S without one.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Protocol

import numpy as np

from hil.config.rig import Turntable
from hil.core.clock import Clock
from hil.core.messages import Array, AxisFeedback, Homing
from hil.drivers.axes import ServoAxes
from hil.drivers.base import ANYWHERE_HIGH, ANYWHERE_LOW, GIMBAL_NAMES, accepted_setpoint, full_names
from hil.drivers.latest import Latest
from hil.drivers.turntable.profiled_move import ProfiledMove, compile_glide
from hil.errors import DeviceError, LinkLost

PERIOD_S = 0.02  # bench time between exchanges when no setpoints come
_PATIENCE_S = 0.03  # after an exchange that a setpoint asked for: the next setpoint comes soon, do not run into it
_RATE_HOLD_S = 0.1  # a setpoint older than this has lost its sender: keep its position, not its rate
_STOP_WALL_S = 0.08  # longest wait of stop and close for the thread


class ExchangeLink(Protocol):
    """One wire to three drives; every call may wait, but only for a bounded time. Errors are DeviceErrors."""

    profiles: bool
    """Whether ``move_to`` makes the drives go by profiles of their own."""
    jogged: bool
    """Whether setpoints are passed on although an axis does not know its place; off again before homing."""

    def open(self) -> AxisFeedback:
        """Connect, enable the drives holding where they stand; return where that is."""

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Give position (3,), rad, and rate (3,), rad/s; return feedback, or None if it came incomplete.

        After ``quick_stop`` and ``move_to``, and while an axis does not know its place and is not jogged, the
        setpoint is not passed on, only feedback is fetched.
        """

    def home(self) -> None:
        """Let the axes that do not know their places look for their home switches; feedback tells how far."""

    def move_to(self, position: Array, rate: Array) -> None:
        """Let the drives go to position (3,), rad, at most at rate (3,), rad/s; only where ``profiles``."""

    def quick_stop(self) -> None:
        """Command standstill; holds until the next ``open``."""

    def close(self) -> None:
        """Let go of the wire. Idempotent."""

    def counters(self) -> dict[str, int]:
        """Return what was counted since ``open``."""


class CyclicTurntable:
    """A turntable behind a ``ExchangeLink``; keeps the promises of ``AxisGroup``.

    Angles rad, rates rad/s, order roll, pitch, yaw. After ``stop``, and after a homing that failed, the
    axes stand until the next ``open``: ``send`` then returns where they stand. It does so as well while
    an axis does not know its place, and after ``move_to``.
    """

    def __init__(self, config: Turntable, clock: Clock, link: ExchangeLink, name: str = "turntable") -> None:
        self.name = name
        self.axis_names = full_names(name, GIMBAL_NAMES)
        axes = ServoAxes(config)
        self._low, self._high, self._rate_max = axes.low, axes.high, axes.rate_max
        self._acceleration_max = axes.acceleration_max
        self._timeout_s = config.timeout_s
        self._clock = clock
        self._link = link
        self._box: Latest[AxisFeedback] = Latest(name)
        self._box.fail(LinkLost(name, "is not open"))
        self._thread: threading.Thread | None = None
        self._wake = threading.Event()
        self._closing = threading.Event()
        self._stopping = threading.Event()
        self._stopped = threading.Event()
        self._homing_asked = threading.Event()
        self._jogging = False
        self._goal: tuple[Array, Array] | None = None
        self._glide: ProfiledMove | None = None
        self._setpoint: tuple[Array, Array, float] = (np.zeros(3), np.zeros(3), 0.0)

    def open(self, now_s: float) -> None:
        """Connect, enable the drives, hold the present position. Raises DeviceError."""
        self.close()
        if self._thread is not None and self._thread.is_alive():
            raise LinkLost(self.name, "the former link has not let go of the wire yet")
        self._box = Latest(self.name)
        for event in (self._wake, self._closing, self._stopping, self._stopped, self._homing_asked):
            event.clear()
        self._goal = self._glide = None
        self._jogging = self._link.jogged = False
        accepted_setpoint(self.axis_names, self._low, self._low, self._high)  # compiles, so that no send has to
        compile_glide()
        try:
            feedback = self._link.open()
        except DeviceError as error:
            self._box.fail(error)
            raise
        self._setpoint = (feedback.position, np.zeros(3), now_s)
        self._box.put(feedback, self._clock.now_s())
        self._thread = threading.Thread(target=self._run, daemon=True, name=f"{self.name}-io")
        self._thread.start()

    def home(self, now_s: float) -> None:
        """Let each axis that does not know its place look for its home switch; ``read`` tells how far it is."""
        self._box.check()
        if not self._stopping.is_set():
            self._homing_asked.set()
            self._wake.set()

    def set_jogging(self, on: bool) -> None:
        """While on, take setpoints of axes that are not homed, and cut none to the travel."""
        standing = self._box.peek()
        if on and standing is not None:
            self._setpoint = (standing.position.copy(), np.zeros(3), self._setpoint[2])
            self._link.jogged = True  # from now on, so that the drives go on being told where to stand
        self._jogging = on

    def move_to(self, position: Array, rate: Array, now_s: float) -> Array:
        """Let the axes go to position (3,), rad, and stand there, at most at rate (3,), rad/s; return the goal.

        For parking: by the drives' own profiles where they have them. Returns at once; later setpoints are
        refused until the next ``open``. Errors as for ``send``.
        """
        self._box.check()
        goal = accepted_setpoint(self.axis_names, position, self._low, self._high)
        speed = accepted_setpoint(self.axis_names, np.abs(rate), np.zeros(3), self._rate_max, "rate")
        standing = self._box.peek()
        if standing is not None and self._takes_no_setpoints(standing):
            return standing.position.copy()
        self._goal = (goal, speed)
        self._wake.set()
        return goal.copy()

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Hand over the newest setpoint (3,), rad, and its rate (3,), rad/s; return the accepted position.

        Position is cut to the travel and rate to its limit; an axis at its cut gets no rate. Raises
        SafetyTrip for a number that is not finite, DeviceError once the link has failed.
        """
        self._box.check()
        low, high = (ANYWHERE_LOW, ANYWHERE_HIGH) if self._jogging else (self._low, self._high)
        accepted = accepted_setpoint(self.axis_names, position, low, high)
        wanted_rate = accepted_setpoint(self.axis_names, rate, -self._rate_max, self._rate_max, "rate")
        standing = self._box.peek()
        if standing is not None and (self._goal is not None or self._takes_no_setpoints(standing)):
            return standing.position.copy()
        self._setpoint = (accepted, np.where(accepted == position, wanted_rate, 0.0), now_s)
        self._wake.set()
        return accepted.copy()

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback. Raises LinkTimeout when it is older than ``timeout_s``."""
        feedback = self._box.get(now_s, self._timeout_s)
        if self._homing_asked.is_set():  # asked for, and nothing heard of it yet
            roll, pitch, yaw = (Homing.DONE if known is Homing.DONE else Homing.UNDER_WAY for known in feedback.homing)
            return replace(feedback, homing=(roll, pitch, yaw))
        return feedback

    def counters(self) -> dict[str, int]:
        """Return what the link counted since ``open``."""
        return self._link.counters()

    def stop(self, now_s: float) -> None:
        """Quick stop: the axes come to a stand and stay there until the next ``open``."""
        self._stopping.set()
        self._wake.set()
        if self._thread is not None:
            self._stopped.wait(_STOP_WALL_S)

    def close(self) -> None:
        """Quick stop if that has not happened, then let go of the wire."""
        self._closing.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join(_STOP_WALL_S)
        self._box.fail(LinkLost(self.name, "is closed"))

    def _run(self) -> None:
        try:
            self._serve()
        except DeviceError as error:
            self._fail(error)
        except Exception as error:  # a dying thread must tell the loop, whatever it died of
            lost = LinkLost(self.name, f"link failed: {error!r}")
            lost.__cause__ = error
            self._fail(lost)
        finally:
            self._stopped.set()
            self._link.close()

    def _serve(self) -> None:
        asked = False
        while not self._closing.is_set():
            started_s = self._clock.now_s()
            if self._stopping.is_set() and not self._stopped.is_set():
                self._link.quick_stop()
                self._stopped.set()
            homing = self._homing_asked.is_set() and not self._stopped.is_set()
            if homing:
                self._link.jogged = False
                self._link.home()
            feedback = self._link.exchange(*self._next_setpoint(started_s))
            if feedback is not None:
                self._take(feedback)
                if homing:
                    self._homing_asked.clear()
            asked = self._wait(started_s + (_PATIENCE_S if asked else PERIOD_S))
        if not self._stopped.is_set():
            self._link.quick_stop()

    def _next_setpoint(self, now_s: float) -> tuple[Array, Array]:
        """Return the position and rate that are due now."""
        position, rate, sent_s = self._setpoint
        if self._goal is not None and not self._stopped.is_set():
            if self._glide is None:
                self._glide = ProfiledMove(position, *self._goal, self._acceleration_max, now_s)
                if self._link.profiles:
                    self._link.move_to(*self._goal)
            return self._glide.at(now_s)
        return position, rate if now_s - sent_s <= _RATE_HOLD_S else np.zeros(3)

    def _take(self, feedback: AxisFeedback) -> None:
        before = self._box.peek()
        if before is not None and not _all_know_their_places(before) and not self._link.jogged:
            # found just now: what was commanded before meant other places
            self._setpoint = (feedback.position.copy(), np.zeros(3), feedback.t_s)
        if Homing.FAILED in feedback.homing:
            self._stopping.set()
        self._box.put(feedback, feedback.t_s)

    def _takes_no_setpoints(self, standing: AxisFeedback) -> bool:
        if self._stopping.is_set() or self._homing_asked.is_set():
            return True
        return not (self._jogging or _all_know_their_places(standing))

    def _wait(self, until_s: float) -> bool:
        """Wait for the next setpoint, at most to ``until_s``; return whether one came."""
        left_s = (until_s - self._clock.now_s()) / self._clock.speed
        asked = self._wake.wait(max(0.0, left_s))
        self._wake.clear()
        return asked

    def _fail(self, error: DeviceError) -> None:
        """Leave ``error`` for the loop; a drive that still listens is stopped."""
        self._box.fail(error)
        try:
            self._link.quick_stop()
        except Exception as second:  # the first error tells the story, this one is a footnote to it
            error.add_note(f"the quick stop after it could not be sent: {second}")


def _all_know_their_places(feedback: AxisFeedback) -> bool:
    return all(known is Homing.DONE for known in feedback.homing)
