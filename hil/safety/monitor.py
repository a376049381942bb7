"""Safety monitor of the bench. Checks in each cycle whether the bench may continue, and returns the alarm if not.

It owns mode, emergency stop, alarms and packet-loss monitors, but no device. The table ``CHECKS`` lists the checks of
each mode; ``alarm_table`` lists all alarms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hil.bench import guard as guards
from hil.config.rig import Rig
from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.kernel_record import kernel_record
from hil.core.messages import HOMED, NO_LIMIT, Array, AxisFeedback, Homing, new
from hil.core.modes import Mode, ModeMachine
from hil.errors import SafetyTrip
from hil.safety.alarms import AlarmLog
from hil.safety.motion_guards import JogGuard, breach_alarm
from hil.safety.packet_loss import LinkWatch, SpeedCheck


class EmergencyStop:
    """Latch of the emergency stop.

    The input is evaluated by level: one sample while the button is pressed latches. A reset acts only on its rising
    edge while the button is released; a reset held from before, or with an edge while pressed, has no effect.
    """

    def __init__(self) -> None:
        self.latched = False
        self.pressed = False
        self._reset_before = True  # a reset held at program start is no edge

    def update(self, pressed: bool | None, reset: bool = False) -> None:
        """Update with the levels of button and reset input; ``pressed`` None: unknown, which counts as pressed."""
        self.pressed = pressed is None or pressed
        if self.pressed:
            self.latched = True
        elif reset and not self._reset_before:
            self.latched = False
        self._reset_before = reset

    def reset(self) -> bool:
        """Reset on the operator's command, which counts as an edge; return whether the latch is released."""
        if not self.pressed:
            self.latched = False
        return not self.latched


_SWITCHES: Final = {-1: "low", 1: "high"}
_REST_MPS = 0.01
_REST_RADPS = math.radians(1.0)
_SLACK_M = 0.001
_SLACK_RAD = 0.001


@dataclass(frozen=True, slots=True)
class Checks:
    """Checks of a mode: ``open``: emergency stop and age of the feedback; ``enabled``: local enabling input;
    ``homed``: all axes homed; ``homing``: no axis failed to home; ``switches``: no axis on a limit switch;
    ``commanded``: age of the setpoints; ``following``: following error and soft limits; ``speed``: reported speed
    against the change of position."""

    open: bool = True
    enabled: bool = True
    homed: bool = False
    homing: bool = False
    switches: bool = False
    commanded: bool = False
    following: bool = False
    speed: bool = True


_ALL = Checks(homed=True, switches=True, commanded=True, following=True)

CHECKS: Final[dict[Mode, Checks]] = {
    Mode.OFF: Checks(open=False, enabled=False, speed=False),
    Mode.STANDBY: Checks(enabled=False),  # the drives hold the axes; ``interlock_power`` keeps them there
    Mode.HOMING: Checks(homing=True, speed=False),  # the drives move the axes to the home switches by themselves
    Mode.JOGGING: Checks(commanded=True, following=True),  # the jog itself respects the switches: it may move off one
    Mode.PLACING: _ALL,
    Mode.ARMED: Checks(homed=True, switches=True, following=True),  # the drives hold the last setpoint
    Mode.RUNNING: _ALL,
    Mode.PARKING: _ALL,
    Mode.HOLD: _ALL,
    Mode.SAFE_STOP: Checks(open=False, enabled=False, speed=False),
}


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Limits of the checks. guard: GUARD. feedback_age_max_s: of rails and turntable. slack (6,): position beyond the
    travel that is allowed when the bench is armed, m and rad. rest_mps, rest_radps: below these speeds an axis counts
    as at rest."""

    guard: np.record
    feedback_age_max_s: tuple[float, float]
    command_age_max_s: float
    homing_timeout_s: float
    slack: Array
    rest_mps: float = _REST_MPS
    rest_radps: float = _REST_RADPS
    speed_mismatch_max: tuple[float, float] = (0.05, math.radians(5.0))
    """Of rails and turntable, m/s and rad/s."""
    parking_rate_fraction: float = 0.25
    """Of the speed limits."""
    jog_rate_fraction: float = 0.1
    """Of the speed limits."""


def safety_limits(rig: Rig, guard: np.record) -> SafetyLimits:
    """Return the safety limits of ``rig``; guard: its GUARD."""
    rails, turntable = rig.rails, rig.turntable
    return SafetyLimits(
        guard=guard,
        feedback_age_max_s=(rails.timeout_s, turntable.timeout_s),
        command_age_max_s=rig.safety.command_age_max_s,
        homing_timeout_s=rig.safety.homing_timeout_s,
        slack=np.array([_SLACK_M] * 3 + [_SLACK_RAD] * 3),
        speed_mismatch_max=(rails.speed_mismatch_max_mps, math.radians(turntable.speed_mismatch_max_degps)),
        parking_rate_fraction=rig.safety.parking_rate_fraction,
        jog_rate_fraction=rig.safety.jog_rate_fraction,
    )


class SafetyMonitor:
    """Decides in each cycle between continuing and a safe stop; stores requests for a hold.

    axis_names: full names of rails x y z, turntable roll pitch yaw. links: packet-loss monitors.
    """

    def __init__(self, limits: SafetyLimits, axis_names: Sequence[str], links: Sequence[LinkWatch] = ()) -> None:
        self.modes = ModeMachine()
        self.alarms = AlarmLog()
        self.estop = EmergencyStop()
        self.locally_enabled = True
        """Local enabling input: the switch at the bench permits power and motion, or the bench has none."""
        self.limits = limits
        self.hold_reason = ""
        """Reason of a requested hold; empty if none is requested."""
        self._axis_names = tuple(axis_names)
        self._links = tuple(links)
        self._guard = kernel_record(limits.guard.copy())
        self._breach = kernel_record(new(guards.BREACH))
        self.jog_guard = JogGuard(limits.guard)
        self._speed_checks = [SpeedCheck(limit) for limit in limits.speed_mismatch_max]
        self._checked_mode = self.modes.mode
        self._checks = CHECKS[self._checked_mode]

    def check(
        self,
        now_s: float,
        rails: AxisFeedback,
        turntable: AxisFeedback,
        commanded_s: float,
        setpoint: np.record,
        feedback: np.record,
    ) -> Alarm | None:
        """Return the alarm that stops the bench, None if it may continue.

        rails, turntable: newest feedback; ``feedback``: both as AXES. setpoint: AXES, the last command; commanded_s:
        bench time at which it was sent, nan if none was sent since the bench was armed.
        """
        mode = self.modes.mode
        if mode is not self._checked_mode:
            self._checked_mode, self._checks = mode, CHECKS[mode]
            for check in self._speed_checks:
                check.restart()
        checks = self._checks
        if checks.open:
            if self.estop.latched:
                return self._emergency_stop(now_s)
            if checks.enabled and not self.locally_enabled:
                return not_enabled(now_s)
            rails_max_s, turntable_max_s = self.limits.feedback_age_max_s
            if not now_s - rails.t_s <= rails_max_s:
                return self._stale_feedback(now_s, 0, rails, rails_max_s)
            if not now_s - turntable.t_s <= turntable_max_s:
                return self._stale_feedback(now_s, 3, turntable, turntable_max_s)
        if checks.homing and (alarm := self.homing_failed(now_s, rails, turntable)):
            return alarm
        if checks.homed and (rails.homing != HOMED or turntable.homing != HOMED):
            return self._not_homed(now_s, rails, turntable)
        if checks.switches and (rails.limit != NO_LIMIT or turntable.limit != NO_LIMIT):
            return self._on_limit_switch(now_s, rails, turntable)
        if checks.commanded and now_s - commanded_s > self.limits.command_age_max_s:
            return table.AGE_OF_SETPOINT.alarm(now_s, "bench", now_s - commanded_s, self.limits.command_age_max_s)
        if checks.following:
            is_homed = rails.homing == HOMED and turntable.homing == HOMED
            self._guard.homed = is_homed and mode is not Mode.JOGGING  # which has a guard volume of its own
            breach = guards.first_breach(self._guard, setpoint, feedback, self._breach)
            if breach != guards.NOTHING:
                return breach_alarm(now_s, self._axis_names, breach, self._breach)
            if mode is Mode.JOGGING and is_homed and (alarm := self.jog_guard.check(now_s, setpoint, feedback)):
                return alarm
        return self._check_speeds(now_s, rails, turntable) if checks.speed else None

    def _check_speeds(self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback) -> Alarm | None:
        """Return the alarm of an axis whose reported speed is not the change of its position."""
        for device, (check, feedback) in enumerate(zip(self._speed_checks, (rails, turntable), strict=True)):
            if (mismatch := check.update(feedback)) is not None:
                axis, reported, moved = mismatch
                name = self._axis_names[3 * device + axis]
                return table.SPEED.alarm(now_s, name, reported, moved, rotates=device == 1)
        return None

    def interlock_power(self, now_s: float) -> Alarm | None:
        """Return the alarm that forbids enabling the drives, and any command to move, None if allowed."""
        if self.estop.latched:
            return self._emergency_stop(now_s)
        return None if self.locally_enabled else not_enabled(now_s)

    def interlock_motion(
        self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback, feedback: np.record
    ) -> Alarm | None:
        """Return the alarm that forbids motion, None if allowed; checked before placing, arming and resuming."""
        if alarm := self.interlock_power(now_s):
            return alarm
        if rails.homing != HOMED or turntable.homing != HOMED:
            return self._not_homed(now_s, rails, turntable)
        if rails.limit != NO_LIMIT or turntable.limit != NO_LIMIT:
            return self._on_limit_switch(now_s, rails, turntable)
        breach = guards.first_beyond_travel(self._guard, feedback, self.limits.slack, self._breach)
        if breach != guards.NOTHING:
            return breach_alarm(now_s, self._axis_names, breach, self._breach)
        return self.interlock_seed(now_s, feedback)

    def interlock_seed(self, now_s: float, feedback: np.record) -> Alarm | None:
        """Return an alarm if an axis moves: setpoints are seeded only from axes at rest."""
        moving = guards.first_moving(feedback, self.limits.rest_mps, self.limits.rest_radps)
        if moving < 0:
            return None
        rotates = moving >= 3
        value = feedback.gimbal_radps[moving - 3] if rotates else feedback.rail_mps[moving]
        limit = self.limits.rest_radps if rotates else self.limits.rest_mps
        return table.SPEED_BEFORE_MOTION.alarm(now_s, self._axis_names[moving], value, limit, rotates=rotates)

    def check_links(self, now_s: float) -> Alarm | None:
        """Return an alarm if a device has lost too many packets recently; called a few times per second."""
        for link in self._links:
            if alarm := link.check(now_s):
                return alarm
        return None

    def link_margins(self) -> dict[str, dict[str, Any]]:
        """Return the margin of each link to its loss of packets, by the names of the limits."""
        return {f"lost_packets_of_{link.device}": link.margin() for link in self._links}

    def restart(self) -> None:
        """Restart after the devices were opened: earlier packet loss and hold requests do not count."""
        self.hold_reason = ""
        for link in self._links:
            link.restart()

    def request_hold(self, reason: str) -> None:
        """Request a hold before the next cycle; executed in RUNNING and PLACING."""
        self.hold_reason = self.hold_reason or reason

    def reset(self, now_s: float) -> Alarm | None:
        """Reset all alarms, or return the alarm that forbids it."""
        if not self.estop.reset():
            return table.EMERGENCY_STOP.alarm(now_s, "bench", "pressed", "released")
        if not self.locally_enabled:
            return not_enabled(now_s)
        self.alarms.reset()
        return None

    def widen_travel(self, low: Array, high: Array) -> None:
        """Replace the soft limits (6,) for a jog."""
        self._guard.low, self._guard.high = low, high

    def restore_travel(self) -> None:
        self.widen_travel(self.limits.guard.low, self.limits.guard.high)

    def homing_failed(self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback) -> Alarm | None:
        """Return an alarm if an axis failed to home."""
        for axis, state in enumerate((*rails.homing, *turntable.homing)):
            if state is Homing.FAILED:
                return table.HOMING.alarm(now_s, self._axis_names[axis], "failed", "home switch found")
        return None

    def homing_timeout(
        self, now_s: float, since_s: float, rails: AxisFeedback, turntable: AxisFeedback
    ) -> Alarm | None:
        """Return an alarm for the first axis that is not homed after the homing timeout."""
        limit_s = self.limits.homing_timeout_s
        if now_s - since_s <= limit_s:
            return None
        axis = next(i for i, state in enumerate((*rails.homing, *turntable.homing)) if state is not Homing.DONE)
        return table.HOMING.alarm(now_s, self._axis_names[axis], now_s - since_s, limit_s)

    def _emergency_stop(self, now_s: float) -> Alarm:
        value = "pressed" if self.estop.pressed else "released, not reset"
        return table.EMERGENCY_STOP.alarm(now_s, "bench", value, "released and reset")

    def _stale_feedback(self, now_s: float, first_axis: int, feedback: AxisFeedback, limit_s: float) -> Alarm:
        device = self._axis_names[first_axis].partition(".")[0]
        return table.AGE_OF_FEEDBACK.alarm(now_s, device, now_s - feedback.t_s, limit_s)

    def _not_homed(self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback) -> Alarm:
        states = (*rails.homing, *turntable.homing)
        axis = next(i for i, state in enumerate(states) if state != Homing.DONE)
        value = {Homing.NEEDED: "not homed", Homing.UNDER_WAY: "under way", Homing.FAILED: "failed"}[states[axis]]
        return table.HOMING.alarm(now_s, self._axis_names[axis], value, "done")

    def _on_limit_switch(self, now_s: float, rails: AxisFeedback, turntable: AxisFeedback) -> Alarm:
        switches = (*rails.limit, *turntable.limit)
        axis = next(i for i, switch in enumerate(switches) if switch != 0)
        return table.LIMIT_SWITCH.alarm(now_s, self._axis_names[axis], _SWITCHES[switches[axis]], "none")


def not_enabled(now_s: float) -> Alarm:
    """Return the alarm of a local enabling input that permits neither power nor motion."""
    return table.LOCAL_ENABLE.alarm(now_s, "io", "off", "on")


def hold_trip(reason: str) -> SafetyTrip:
    """Return the error of a hold requested for ``reason`` in a run without an operator to resume it."""
    return table.HOLD.trip("bench", f"({reason})", "only in attended runs")
