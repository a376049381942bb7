"""The one supervisor: told in each cycle what is known, it says whether the bench may go on.

It has the mode, the emergency stop, the alarms and the links' buckets, and nothing of the devices
themselves. What it checks in which mode is the table ``CHECKS``; docs/safety.md lists every alarm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.bench import guard as guards
from hil.core.messages import HOMED, NO_LIMIT, Array, AxisFeedback, Homing, new
from hil.core.modes import Mode, ModeMachine
from hil.safety.alarms import Alarm, AlarmLog
from hil.safety.estop import EmergencyStop
from hil.safety.limits import SafetyLimits
from hil.safety.packet_loss import LinkWatch

_SWITCHES: Final = {-1: "low", 1: "high"}


@dataclass(frozen=True, slots=True)
class Checks:
    """What is looked at: ``open``: emergency stop and age of feedback; ``homed``: every axis knows its place;
    ``homing``: none has failed to find it; ``switches``: none stands on a limit switch; ``commanded``: age of
    the setpoints; ``following``: following error, soft limits."""

    open: bool = True
    homed: bool = False
    homing: bool = False
    switches: bool = False
    commanded: bool = False
    following: bool = False


_ALL = Checks(homed=True, switches=True, commanded=True, following=True)

CHECKS: Final[dict[Mode, Checks]] = {
    Mode.OFF: Checks(open=False),
    Mode.STANDBY: Checks(),
    Mode.HOMING: Checks(homing=True),  # on its way to the switches, under the drives' own command
    Mode.JOGGING: Checks(commanded=True, following=True),  # the jog itself obeys the switches: it may leave one
    Mode.PLACING: _ALL,
    Mode.ARMED: Checks(homed=True, switches=True, following=True),  # the drives hold the last setpoint by themselves
    Mode.RUNNING: _ALL,
    Mode.PARKING: _ALL,
    Mode.HOLD: _ALL,
    Mode.SAFE_STOP: Checks(open=False),
}


class SafetyMonitor:
    """Decides, in each cycle, between going on and a safe stop; keeps what asks for a hold.

    axis_names: rails x y z, turntable roll pitch yaw, full. links: the buckets of lost packets.
    """

    def __init__(self, limits: SafetyLimits, axis_names: Sequence[str], links: Sequence[LinkWatch] = ()) -> None:
        self.modes = ModeMachine()
        self.alarms = AlarmLog()
        self.estop = EmergencyStop()
        self.limits = limits
        self.hold_reason = ""
        """Why the bench is to be held; empty while nothing asks for it."""
        self._axis_names = tuple(axis_names)
        self._links = tuple(links)
        self._guard = limits.guard.copy()
        self._breach = new(guards.BREACH)
        self._seen_mode = self.modes.mode
        self._checks = CHECKS[self._seen_mode]

    def check(
        self,
        now_s: float,
        rails: AxisFeedback,
        turntable: AxisFeedback,
        commanded_s: float,
        setpoint: np.record,
        feedback: np.record,
    ) -> Alarm | None:
        """Return the alarm that stops the bench, None where it may go on.

        rails, turntable: the newest feedback; ``feedback``: both as AXES. setpoint: AXES, where they should
        be; commanded_s: bench time at which it was sent, nan if none was sent since the bench was armed.
        """
        mode = self.modes.mode
        if mode is not self._seen_mode:
            self._seen_mode, self._checks = mode, CHECKS[mode]
        checks = self._checks
        if checks.open:
            if self.estop.latched:
                return self._emergency_stop(now_s)
            rails_max_s, turntable_max_s = self.limits.feedback_age_max_s
            if not now_s - rails.t_s <= rails_max_s:
                return self._too_old(now_s, 0, rails, rails_max_s)
            if not now_s - turntable.t_s <= turntable_max_s:
                return self._too_old(now_s, 3, turntable, turntable_max_s)
        if checks.homing and (alarm := self.homing_failed(now_s, rails, turntable)):
            return alarm
        if checks.homed and (rails.homing != HOMED or turntable.homing != HOMED):
            return self._not_homed(now_s, rails, turntable)
        if checks.switches and (rails.limit != NO_LIMIT or turntable.limit != NO_LIMIT):
            return self._on_a_switch(now_s, rails, turntable)
        if checks.commanded and now_s - commanded_s > self.limits.command_age_max_s:
            age, limit = f"{now_s - commanded_s:.3f} s", f"{self.limits.command_age_max_s:g} s"
            return Alarm(now_s, "bench", "age of the setpoint", age, limit)
        if checks.following:
            breach = guards.first_breach(self._guard, setpoint, feedback, self._breach)
            if breach != guards.NOTHING:
                return breach_alarm(now_s, self._axis_names, breach, self._breach)
        return None

    def interlock_open(self, now_s: float) -> Alarm | None:
        """Return why no drive may be enabled, None where they may."""
        return self._emergency_stop(now_s) if self.estop.latched else None

    def interlock_motion(
        self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback, feedback: np.record
    ) -> Alarm | None:
        """Return why no setpoint may be given yet, None where one may: asked before placing, arming and resuming."""
        if self.estop.latched:
            return self._emergency_stop(now_s)
        if rails.homing != HOMED or turntable.homing != HOMED:
            return self._not_homed(now_s, rails, turntable)
        if rails.limit != NO_LIMIT or turntable.limit != NO_LIMIT:
            return self._on_a_switch(now_s, rails, turntable)
        breach = guards.first_beyond_travel(self._guard, feedback, self.limits.slack, self._breach)
        if breach != guards.NOTHING:
            return breach_alarm(now_s, self._axis_names, breach, self._breach)
        return self.interlock_seed(now_s, feedback)

    def interlock_seed(self, now_s: float, feedback: np.record) -> Alarm | None:
        """Return an alarm where an axis moves: references are seeded from axes that stand."""
        moving = guards.first_moving(feedback, self.limits.stand_mps, self.limits.stand_radps)
        if moving < 0:
            return None
        if moving < 3:
            value, limit = f"{feedback.rail_mps[moving]:.4f} m/s", f"{self.limits.stand_mps:g} m/s"
        else:
            value = f"{math.degrees(feedback.gimbal_radps[moving - 3]):.3f} deg/s"
            limit = f"{math.degrees(self.limits.stand_radps):g} deg/s"
        return Alarm(now_s, self._axis_names[moving], "speed at arming", value, limit)

    def check_links(self, now_s: float) -> Alarm | None:
        """Return an alarm where a device has lost too many packets lately; a few times a second is often enough."""
        for link in self._links:
            if alarm := link.check(now_s):
                return alarm
        return None

    def opened(self) -> None:
        """Begin anew after the devices were opened: what was lost before does not count."""
        self.hold_reason = ""
        for link in self._links:
            link.restart()

    def request_hold(self, reason: str) -> None:
        """Let the bench be held before the next cycle; obeyed in running and in placing."""
        self.hold_reason = self.hold_reason or reason

    def reset(self, now_s: float) -> Alarm | None:
        """Take a reset: return what still forbids it, or let go of all alarms."""
        if not self.estop.reset():
            return Alarm(now_s, "bench", "emergency stop", "pressed", "released")
        self.alarms.reset()
        return None

    def widen_travel(self, low: Array, high: Array) -> None:
        """Replace the soft limits (6,) for a jog."""
        self._guard.low, self._guard.high = low, high

    def restore_travel(self) -> None:
        self.widen_travel(self.limits.guard.low, self.limits.guard.high)

    def homing_failed(self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback) -> Alarm | None:
        """Return an alarm where an axis did not find its home switch."""
        for axis, state in enumerate((*rails.homing, *turntable.homing)):
            if state is Homing.FAILED:
                return Alarm(now_s, self._axis_names[axis], "homing", "failed", "every axis finds its switch")
        return None

    def homing_timeout(
        self, now_s: float, since_s: float, rails: AxisFeedback, turntable: AxisFeedback
    ) -> Alarm | None:
        """Return an alarm that names the first axis without a place once homing has used up its time."""
        limit_s = self.limits.homing_timeout_s
        if now_s - since_s <= limit_s:
            return None
        axis = next(i for i, state in enumerate((*rails.homing, *turntable.homing)) if state is not Homing.DONE)
        return Alarm(
            now_s, self._axis_names[axis], "homing", f"not done after {now_s - since_s:.1f} s", f"{limit_s:g} s"
        )

    def _emergency_stop(self, now_s: float) -> Alarm:
        value = "pressed" if self.estop.pressed else "released, not reset"
        return Alarm(now_s, "bench", "emergency stop", value, "released and reset")

    def _too_old(self, now_s: float, first_axis: int, feedback: AxisFeedback, limit_s: float) -> Alarm:
        device = self._axis_names[first_axis].partition(".")[0]
        return Alarm(now_s, device, "age of the feedback", f"{now_s - feedback.t_s:.3f} s", f"{limit_s:g} s")

    def _not_homed(self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback) -> Alarm:
        states = (*rails.homing, *turntable.homing)
        axis = next(i for i, state in enumerate(states) if state != Homing.DONE)
        value = {Homing.NEEDED: "not homed", Homing.UNDER_WAY: "under way", Homing.FAILED: "failed"}[states[axis]]
        return Alarm(now_s, self._axis_names[axis], "homing", value, "done")

    def _on_a_switch(self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback) -> Alarm:
        switches = (*rails.limit, *turntable.limit)
        axis = next(i for i, switch in enumerate(switches) if switch != 0)
        return Alarm(now_s, self._axis_names[axis], "limit switch", _SWITCHES[switches[axis]], "none")


def breach_alarm(now_s: float, axis_names: Sequence[str], what: int, found: np.record) -> Alarm:
    """Return the alarm for ``what`` the guard's kernels returned and ``found`` (BREACH)."""
    axis = int(found.axis)
    name = axis_names[axis]
    if what == guards.FOLLOWING:
        return Alarm(now_s, name, "following error", _shown(axis, found.value), _limit(axis, found.high))
    if what == guards.NOT_FINITE:
        return Alarm(now_s, name, "position", str(float(found.value)), "a finite number")
    limit = f"{_limit(axis, found.low)} to {_limit(axis, found.high)}"
    return Alarm(now_s, name, "position", _shown(axis, found.value), limit)


def _shown(axis: int, value: float) -> str:
    return f"{value:.4f} m" if axis < 3 else f"{math.degrees(value):.3f} deg"


def _limit(axis: int, value: float) -> str:
    return f"{value:g} m" if axis < 3 else f"{math.degrees(value):g} deg"
