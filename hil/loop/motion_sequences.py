"""Motion sequences outside the closed loop: homing, placing, holding, jogging. Each cycle is monitored."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from hil.bench.jog import Jog
from hil.core import alarm_table as table
from hil.core.gnc_records import GncMode
from hil.core.messages import AXES, HOMED, Homing, new
from hil.core.modes import Mode
from hil.core.operator_commands import TOO_LATE, JogRequest, Operator, OperatorCommand, StopCommanded
from hil.drivers.base import Jogs
from hil.loop.bench_stage import Move
from hil.loop.cycle import Loop
from hil.loop.overrun_monitor import OverrunMonitor
from hil.loop.rate_keeper import Rate, Tick
from hil.loop.run_plan import RunPlan
from hil.loop.target_axes import TargetAxes
from hil.safety.monitor import hold_trip

PROGRESS_CYCLES: Final = 50
_LINK_CHECK_PERIOD_S: Final = 0.1
_STANDSTILL_S: Final = 0.1  # required of an axis that has moved
_HELD_S: Final = 0.3  # the same in a hold: until the encoders have settled at the setpoints that they replace
_MOVING: Final = (Mode.PLACING, Mode.PARKING, Mode.JOGGING)
_SETTLE_S: Final = 3.0  # allowed after placing or homing until all axes are at rest at their targets
_NO_MOVE_S: Final = 1e-3  # shorter moves are rounding
_SETTLED_M: Final = 0.001
_SETTLED_RAD: Final = 0.001
_NOT_REACHED: Final = {Mode.PLACING: table.START_POSE, Mode.PARKING: table.PARK_POSITION}

_GNC_MODES: Final = {Mode.ARMED: GncMode.ARMED, Mode.HOLD: GncMode.HOLD, Mode.RUNNING: GncMode.HOLD}
"""Mode sent to the GNC while the loop is open, else STANDBY; in the first cycle of a hold the mode is still RUNNING."""

ProgressCallback = Callable[[Mode, float], None]
"""Called periodically with the bench's mode and the completed fraction, 0..1."""


class MotionSequencer:
    """Executes motion commands while the loop is open. Each method returns with the axes at rest."""

    def __init__(
        self,
        loop: Loop,
        rate: Rate,
        overrun_monitor: OverrunMonitor,
        plan: RunPlan,
        operator: Operator,
        on_progress: ProgressCallback,
    ) -> None:
        self.loop = loop
        self._rate = rate
        self._overrun_monitor = overrun_monitor
        self._step_s, self._settle_s = plan.tick_s, plan.settle_s
        self._operator = operator
        self._on_progress = on_progress
        self.safety = loop.bench.safety
        self.modes = self.safety.modes
        self.ticks = 0
        self._ticks_per_cycle = plan.ticks
        self.progress_ticks = PROGRESS_CYCLES * plan.ticks
        """Ticks between two reports of progress."""
        self._newest: Tick
        self._target_is_placed = False  # as are further axes, until the next standby
        self.warning_s = 0.0
        """Duration of the warning before the next motion; 0 after it."""
        self._link_check_ticks = max(1, round(_LINK_CHECK_PERIOD_S / plan.tick_s))
        self.link_check_cycles = max(1, self._link_check_ticks // plan.ticks)
        """Cycles between two checks of the links in the closed loop."""

    def tick(self) -> Tick:
        """Wait for the next cycle, read the axes, check them and the links. Raises BenchError, StopCommanded."""
        self._newest = tick = self._overrun_monitor.wait(self._rate)
        self.ticks += 1
        self.check(tick.now_s)
        self._operator.poll(tick.now_s)
        if OperatorCommand.STOP in self._operator.pending:
            raise StopCommanded
        if self.ticks % self._ticks_per_cycle == 0:
            self.loop.gnc.on_idle_cycle(_GNC_MODES.get(self.modes.mode, GncMode.STANDBY), tick.now_s)
        if self.ticks % self._link_check_ticks == 0:
            self.check_links(tick.now_s)
        return tick

    def check(self, now_s: float) -> None:
        """Read the axes and run the safety checks. Raises BenchError."""
        self.loop.safety_io.check(now_s)
        self.loop.bench.read(now_s)
        self.loop.bench.check(now_s)
        self._target_is_placed = self._target_is_placed and self.modes.mode is not Mode.STANDBY
        target = self.loop.target
        (target.check if self._target_is_placed else target.read)(now_s)
        if (mode := self.modes.mode) in _MOVING and all(group.homing == HOMED for group in self.loop.bench.feedback):
            target.check_apart(now_s, mode is Mode.JOGGING, self.loop.bench.accepted, self.loop.now.feedback)

    def check_links(self, now_s: float) -> None:
        """Raise SafetyTrip if a device has lost too many packets recently."""
        alarm = self.safety.check_links(now_s)
        if alarm is not None:
            raise alarm.trip()

    def begin(self) -> Tick:
        """Restart the rate and wait for the first cycle: earlier deadlines do not count."""
        self._rate.restart()
        return self.tick()

    def _warn(self) -> None:
        """Warn before the first motion after the drives were enabled."""
        duration_s, self.warning_s = self.warning_s, 0.0
        if duration_s == 0.0:
            return
        begun_s = now_s = self.tick().now_s
        self.loop.safety_io.warn(True, now_s)
        while now_s - begun_s < duration_s:
            now_s = self.tick().now_s
        self.loop.safety_io.warn(False, now_s)

    def home(self) -> None:
        """Home the axes that need it; one failure stops all."""
        bench, target = self.loop.bench, self.loop.target
        since_s = self.tick().now_s
        if all(group.homing == HOMED for group in bench.feedback) and not target.not_homed(since_s):
            return
        self._warn()
        since_s = self._newest.now_s
        self.modes.go(Mode.HOMING)
        bench.home(since_s)
        target.home(since_s)
        while not all(group.homing == HOMED for group in bench.feedback):
            tick = self.tick()
            self._poll_command(Mode.HOMING)
            if alarm := self.safety.homing_timeout(tick.now_s, since_s, *bench.feedback):
                raise alarm.trip()
            if self.ticks % self.progress_ticks == 0:
                done = sum(state is Homing.DONE for group in bench.feedback for state in group.homing)
                self._on_progress(Mode.HOMING, done / 6.0)
        while name := target.not_homed(self._newest.now_s):
            now_s, limit_s = self.tick().now_s, self.safety.limits.homing_timeout_s
            self._poll_command(Mode.HOMING)
            if now_s - since_s > limit_s:
                raise table.HOMING.trip(name, now_s - since_s, limit_s)
        self.tick()
        self._await_standstill()
        self.modes.go(Mode.STANDBY)

    def _await_standstill(self) -> None:
        """Wait until all axes are at rest; raise SafetyTrip for an axis that still moves after ``_SETTLE_S``.

        An axis may still brake past its home switch, or catch up with a late setpoint. After motion it must be at
        rest for ``_STANDSTILL_S``, because its speed is also zero where it reverses.
        """
        feedback = self.loop.now.feedback
        begun_s = now_s = self._newest.now_s
        moved_s = -math.inf
        while (moving := self.safety.interlock_seed(now_s, feedback)) or now_s - moved_s < _STANDSTILL_S:
            if moving:
                moved_s = now_s
                if now_s - begun_s > _SETTLE_S:
                    raise moving.trip()
            now_s = self.tick().now_s

    def seed_for_run(self) -> Tick:
        """Seed the setpoints with the encoder positions once the axes are at rest; return the newest tick.

        Warns before the first motion.
        """
        self._warn()
        self._await_standstill()
        self.loop.bench.seed_for_run(self._newest.now_s)
        return self._newest

    def place(self) -> None:
        """Move the target to its place, then all axes slowly to the start pose; wait until they are at rest there."""
        target = new(AXES)
        self.loop.bench.start_axes(self.loop.now.truth, target)
        self.begin()
        tick = self.seed_for_run()
        self.modes.go(Mode.PLACING)
        self.loop.target.place(self._tick_without_hold, self._step_s)
        self._target_is_placed = True
        tick = self._newest
        while not self._move_to(target, tick):
            tick = self.hold(self._newest)

    def _tick_without_hold(self) -> Tick:
        """``tick`` in a motion that cannot be held: a hold becomes a safe stop."""
        tick = self.tick()
        if self.hold_requested(self.modes.mode):
            text = self.safety.hold_reason or "commanded by the operator"
            raise table.HOLD.trip("bench", f"({text})", "once target and further axes stand")
        return tick

    def park(self, target: np.record) -> None:
        """Move all axes slowly to the park position ``target`` (AXES), then those of the target and further ones.

        The turntable moves by its drives' profiles, after which it accepts no setpoints until it is reopened. The axes
        must be at rest, see ``brake``.
        """
        self.begin()
        tick = self.seed_for_run()
        if name := self.loop.target.not_homed(tick.now_s):
            raise table.HOMING.trip(name, "not done", "done before parking")
        self.modes.go(Mode.PARKING)
        bench, fraction = self.loop.bench, self.safety.limits.parking_rate_fraction
        bench.park_turntable(target, tick.now_s)

        def parked() -> Tick:
            bench.command(target, self._newest.now_s)
            return self._tick_without_hold()

        if self._move_to(target, tick):
            self.loop.target.park(parked, self._step_s, fraction)
        else:  # hold requested: the bench stays where it stops
            self.brake()
        self.modes.go(Mode.STANDBY)

    def visit(self, target: np.record, is_done: Callable[[float], bool]) -> None:
        """Move all axes slowly to ``target`` (AXES), hold them there until ``is_done`` of the time, and go to standby.

        ``is_done`` is called every cycle with the axes at rest; it must not wait.
        """
        bench = self.loop.bench
        self.begin()
        tick = self.seed_for_run()
        self.modes.go(Mode.PLACING)
        while not self._move_to(target, tick):
            tick = self.hold(self._newest)
        tick = self._newest
        while not is_done(tick.now_s):
            bench.command(target, tick.now_s, bench.params)
            tick = self.tick()
            self.require_resumable_hold()
        self.modes.go(Mode.STANDBY)

    def brake(self) -> None:
        """Brake all axes to standstill."""
        bench = self.loop.bench
        tick = self.begin()
        while bench.brake(tick.now_s) or not bench.at_rest(tick.now_s):
            tick = self.tick()

    def _move_to(self, target: np.record, tick: Tick) -> bool:
        """Execute one move from the present positions; return False if a hold interrupted it."""
        bench, now, mode = self.loop.bench, self.loop.now, self.modes.mode
        setpoint = new(AXES)
        parking = mode is Mode.PARKING
        fraction = self.safety.limits.parking_rate_fraction if parking else Move.FRACTION_OF_LIMITS
        move = Move(bench.params, now.feedback, target, fraction)
        cycle = 0
        while True:
            moved_s = cycle * self._step_s  # a late cycle delays the move
            ended = move.duration_s + self._settle_s - moved_s < _NO_MOVE_S
            if ended and self._is_at(target) and bench.at_rest(tick.now_s):
                return True
            if moved_s > move.duration_s + _SETTLE_S:
                raise _NOT_REACHED[mode].trip("bench", "not reached", _SETTLE_S)
            move.at(moved_s + self._step_s, setpoint)
            bench.command(setpoint, tick.now_s, move.limits)
            tick = self.tick()
            if self.hold_requested(mode):
                return False
            cycle += 1
            if cycle % self.progress_ticks == 0 and move.duration_s > 0.0:
                self._on_progress(mode, min(1.0, moved_s / move.duration_s))

    def _is_at(self, target: np.record) -> bool:
        feedback = self.loop.now.feedback
        return bool(
            np.abs(feedback.rail_m - target.rail_m).max() < _SETTLED_M
            and np.abs(feedback.gimbal_rad - target.gimbal_rad).max() < _SETTLED_RAD
        )

    def hold_requested(self, mode: Mode) -> bool:
        """Return whether a hold is commanded or requested. Raises StopCommanded; SafetyTrip if it cannot be resumed."""
        self.require_resumable_hold()
        return bool(self.safety.hold_reason) or self._poll_command(mode) is OperatorCommand.HOLD

    def require_resumable_hold(self) -> None:
        """Raise SafetyTrip if a hold is requested that no operator can end."""
        if self.safety.hold_reason and not (self._operator.can_resume and self.loop.bench.can_hold):
            raise hold_trip(self.safety.hold_reason)

    def hold(self, tick: Tick) -> Tick:
        """Brake all axes and hold them until RESUME; return the tick of the resumption.

        tick: one without a setpoint yet. Poses received meanwhile are discarded; at the end the setpoints are seeded
        from the encoders. RESUME waits for the GNC and the standstill only as long as the operator still means it.
        """
        bench = self.loop.bench
        held_mode = self.modes.mode
        self.modes.go(Mode.HOLD)
        resume, moved_s = False, tick.now_s
        while True:
            if bench.brake(tick.now_s) or not bench.at_rest(tick.now_s):
                moved_s = tick.now_s
            command = self._poll_command(Mode.HOLD)
            resume = command is OperatorCommand.RESUME or (resume and command is not OperatorCommand.HOLD)
            blocking = self.loop.gnc.blocking_reason or ("axes moved" if tick.now_s - moved_s < _HELD_S else "")
            if resume and self._operator.is_late(OperatorCommand.RESUME):
                resume = False
                self._operator.rejections.append(f"bench: resume {TOO_LATE} ({blocking or 'no cycle in time'})")
            if resume and not blocking:
                break
            tick = self.tick()
            if held_mode is Mode.RUNNING:
                self.loop.discard_frames(tick.now_s)
            if self.ticks % self.progress_ticks == 0:
                self._on_progress(Mode.HOLD, 0.0)
        bench.seed_for_run(tick.now_s)
        self.loop.vision.not_before_s = tick.now_s
        self.safety.hold_reason = ""
        self.modes.go(held_mode)
        return tick

    def jog(self) -> None:
        """Jog the requested axis until the operator releases the key and the axis is at rest."""
        request = self._operator.jog_request()
        bench = self.loop.bench
        if request is not None and self.warning_s > 0.0:
            self.begin()
            self._warn()
            request = self._operator.jog_request()
        if request is None:  # the key was released meanwhile
            self._operator.end_jog()
            return
        tick = self.begin()
        for group in self.loop.target.groups:
            if request.axis in group.axes.axis_names:
                self._jog_group(group, request, tick)
                return
        jog = self._begin_jog(request, tick)
        if jog is None:
            self._operator.end_jog()
            return
        try:
            moving = True
            while moving or not bench.at_rest(tick.now_s):
                moving = self._jog_step(jog, tick)
                tick = self.tick()
        finally:
            self._operator.end_jog()
            bench.set_jogging(False)
            self.safety.restore_travel()
        self.modes.go(Mode.STANDBY)

    def _begin_jog(self, request: JogRequest, tick: Tick) -> Jog | None:
        """Seed the setpoints and enter JOGGING; None, with a rejection, if this axis cannot be jogged."""
        bench = self.loop.bench
        axis = bench.axis_names.index(request.axis) if request.axis in bench.axis_names else -1
        if axis < 0 or request.direction not in (-1, 1):
            self._operator.rejections.append(f"bench: cannot jog {request.axis} by {request.direction}")
            return None
        homing = (*bench.feedback[0].homing, *bench.feedback[1].homing)
        bench.seed(tick.now_s)
        homed, fraction = homing[axis] is Homing.DONE, self.safety.limits.jog_rate_fraction
        jog = Jog(bench.params, axis, request.direction, homed, bench.motion.position, fraction)
        if not bench.set_jogging(True):
            alarm = self.safety.interlock_motion(tick.now_s, *bench.feedback, self.loop.now.feedback)
            if alarm is not None:  # these devices accept setpoints only when homed and within travel
                self._operator.rejections.append(alarm.text)
                return None
        jog.key.refresh(tick.now_s, request.hold_s)
        self.safety.widen_travel(jog.params.low, jog.params.high)
        self.modes.go(Mode.JOGGING)
        return jog

    def _jog_step(self, jog: Jog, tick: Tick) -> bool:
        """Send the next setpoint of a jog; return whether it continues."""
        bench = self.loop.bench
        self._poll_command(Mode.JOGGING)
        request = self._operator.jog_request()
        if request is not None and request == JogRequest(bench.axis_names[jog.axis], jog.direction):
            jog.key.refresh(tick.now_s, request.hold_s)
        switch = (*bench.feedback[0].limit, *bench.feedback[1].limit)[jog.axis]
        if not (jog.may_move(tick.now_s, switch) and self._keeps_clear(jog, tick)):
            return bench.brake(tick.now_s, jog.params) or jog.key.pressed(tick.now_s)
        setpoint = new(AXES)
        jog.aim(bench.motion, setpoint)
        bench.command(setpoint, tick.now_s, jog.params)
        return True

    def _keeps_clear(self, jog: Jog, tick: Tick) -> bool:
        """Return whether a jog stays out of the guard volume; log once per jog why it does not."""
        bench = self.loop.bench
        if any(group.homing != HOMED for group in bench.feedback):
            return True
        rate = jog.direction * float(jog.params.rate_max[jog.axis])
        alarm = self.safety.jog_guard.check_jog(tick.now_s, jog.axis, rate, self.loop.now.feedback)
        if alarm is not None and not jog.was_kept_clear:
            jog.was_kept_clear = True
            self._operator.rejections.append(f"{bench.axis_names[jog.axis]}: no jog this way: {alarm.text}")
        return alarm is None

    def _jog_group(self, group: TargetAxes, request: JogRequest, tick: Tick) -> None:
        """``jog`` of an axis of the target or a further one, while the drives of rails and turntable hold them."""
        try:
            if rejection := self._jog_rejection(group, request, tick):
                self._operator.rejections.append(rejection)
            else:
                self._jog_axis_of(group, request, tick)
        finally:
            self._operator.end_jog()

    def _jog_rejection(self, group: TargetAxes, request: JogRequest, tick: Tick) -> str:
        """Return why the requested axis of ``group`` cannot be jogged, "" if it can."""
        if request.direction not in (-1, 1):
            return f"bench: cannot jog {request.axis} by {request.direction}"
        alarm = self.safety.interlock_motion(tick.now_s, *self.loop.bench.feedback, self.loop.now.feedback)
        if alarm is not None:  # of rails and turntable, whose travel is not widened
            return alarm.text
        if group.jogs_before_homing and isinstance(group.axes, Jogs):
            return ""
        states = zip(group.axes.axis_names, group.feedback.homing, strict=True)
        unhomed = [name for name, state in states if state is not Homing.DONE]
        return f"{unhomed[0]}: homing not done, required before it is jogged" if unhomed else ""

    def _jog_axis_of(self, group: TargetAxes, request: JogRequest, tick: Tick) -> None:
        """Seed the setpoints, and jog until the key is released and all axes are at rest."""
        bench, axis = self.loop.bench, group.axes.axis_names.index(request.axis)
        bench.seed(tick.now_s)
        limits = self.safety.limits
        rest = limits.rest_radps if group.rotates else limits.rest_mps
        jog = group.begin_jog(axis, request.direction, limits.jog_rate_fraction, tick.now_s, self._step_s)
        jog.key.refresh(tick.now_s, request.hold_s)
        self.modes.go(Mode.JOGGING)
        moving = True
        try:
            while moving or not bench.at_rest(tick.now_s) or np.abs(group.feedback.rate).max() > rest:
                self._poll_command(Mode.JOGGING)
                if (held := self._operator.jog_request()) == request:
                    jog.key.refresh(tick.now_s, held.hold_s)
                if jog.may_move(tick.now_s, group.feedback.limit[axis]):
                    group.jog(jog, tick.now_s)
                    moving = True
                else:
                    moving = group.brake(tick.now_s) or jog.key.pressed(tick.now_s)
                tick = self.tick()
                group.check_motion()
        finally:
            group.end_jog()
        self.modes.go(Mode.STANDBY)

    def _poll_command(self, mode: Mode) -> OperatorCommand | None:
        """Return the next pending command for ``mode``, or None. Raises StopCommanded for STOP."""
        if not self._operator.pending:
            return None
        command = self._operator.pop(mode)
        if command is OperatorCommand.STOP:
            raise StopCommanded
        return command
