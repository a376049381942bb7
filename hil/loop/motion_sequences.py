"""Moving the bench outside the closed loop: homing, placing, holding, jogging. Every tick is supervised."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from hil.bench.jog import Jog
from hil.core.gnc_records import GncMode
from hil.core.messages import AXES, HOMED, Homing, new
from hil.core.modes import Mode
from hil.core.operator_commands import JogRequest, Operator, OperatorCommand, StopCommanded
from hil.errors import SafetyTrip
from hil.loop.bench_stage import Move
from hil.loop.cycle import Loop
from hil.loop.overrun_monitor import OverrunMonitor
from hil.loop.rate_keeper import Rate, Tick

WATCH_CYCLES: Final = 50
_LINKS_EVERY_S: Final = 0.1
_STAND_S: Final = 0.1  # an axis that moved has to stand for so long
_SETTLE_S: Final = 3.0  # after placing or homing, until the axes stand where they should
_NO_MOVE_S: Final = 1e-3  # a move that is shorter, by rounding alone, is none
_SETTLED_M: Final = 0.001
_SETTLED_RAD: Final = 0.001
_PLACE_NAMES: Final = {Mode.PLACING: "start pose", Mode.PARKING: "parking place"}

_FOR_THE_GNC: Final = {Mode.ARMED: GncMode.ARMED, Mode.HOLD: GncMode.HOLD, Mode.RUNNING: GncMode.HOLD}
"""What a GNC is told of the cycles in which the loop is open; in the first one of a hold the mode is still RUNNING."""

ProgressCallback = Callable[[Mode, float], None]
"""Told now and then what the bench is doing and how far along it is, 0..1."""


class MotionSequencer:
    """Does what an operator orders while the loop is open. Each method returns with the axes at rest."""

    def __init__(
        self,
        loop: Loop,
        rate: Rate,
        overrun_monitor: OverrunMonitor,
        step_s: float,
        operator: Operator,
        on_progress: ProgressCallback,
    ) -> None:
        self.loop = loop
        self._rate = rate
        self._overrun_monitor = overrun_monitor
        self._step_s = step_s
        self._operator = operator
        self._on_progress = on_progress
        self.safety = loop.bench.safety
        self.modes = self.safety.modes
        self.ticks = 0
        self._newest: Tick
        self.link_check_cycles = max(1, round(_LINKS_EVERY_S / step_s))
        """Cycles from one look at the links to the next."""

    def tick(self) -> Tick:
        """Wait for the next cycle, read the axes, and let the supervisor look at them and at the links."""
        self._newest = tick = self._overrun_monitor.wait(self._rate)
        self.ticks += 1
        self.check(tick.now_s)
        self._operator.poll(tick.now_s)
        self.loop.gnc.stand(_FOR_THE_GNC.get(self.modes.mode, GncMode.STANDBY), tick.now_s)
        if self.ticks % self.link_check_cycles == 0:
            self.check_links(tick.now_s)
        return tick

    def check(self, now_s: float) -> None:
        """Read the axes and let the supervisor look at them; raises BenchError."""
        self.loop.safety_io.check(now_s)
        self.loop.bench.read(now_s, self.loop.now.feedback)
        self.loop.bench.check(now_s, self.loop.now.feedback)

    def check_links(self, now_s: float) -> None:
        """Raise SafetyTrip where a device has lost too many packets lately."""
        alarm = self.safety.check_links(now_s)
        if alarm is not None:
            raise alarm.trip()

    def begin(self) -> Tick:
        """Count the cycles anew and take the first one: no deadline of before counts."""
        self._rate.restart()
        return self.tick()

    def home(self) -> None:
        """Let the axes that do not know their places find them; one failure stops all."""
        bench = self.loop.bench
        since_s = self.tick().now_s
        if all(group.homing == HOMED for group in bench.seen):
            return
        self.modes.go(Mode.HOMING)
        bench.home(since_s)
        while not all(group.homing == HOMED for group in bench.seen):
            tick = self.tick()
            self._poll_command(Mode.HOMING)
            if alarm := self.safety.homing_timeout(tick.now_s, since_s, *bench.seen):
                raise alarm.trip()
            if self.ticks % WATCH_CYCLES == 0:
                done = sum(state is Homing.DONE for group in bench.seen for state in group.homing)
                self._on_progress(Mode.HOMING, done / 6.0)
        self.tick()
        self._await_standstill()
        self.modes.go(Mode.STANDBY)

    def _await_standstill(self) -> None:
        """Return once all axes stand; SafetyTrip that names the axis that still moves after ``_SETTLE_S``.

        One that has just passed its home switch still brakes, and one whose last setpoint came late still
        catches up. One that moved has to stand for ``_STAND_S``: speed is nought where it turns around, too.
        """
        feedback = self.loop.now.feedback
        begun_s = now_s = self._newest.now_s
        moved_s = -math.inf
        while (moving := self.safety.interlock_seed(now_s, feedback)) or now_s - moved_s < _STAND_S:
            if moving:
                moved_s = now_s
                if now_s - begun_s > _SETTLE_S:
                    raise moving.trip()
            now_s = self.tick().now_s

    def seed_for_run(self) -> Tick:
        """Make the encoders' positions the last setpoint once the axes stand; return the newest tick."""
        self._await_standstill()
        self.loop.bench.seed_for_run(self._newest.now_s, self.loop.now.feedback)
        return self._newest

    def place(self) -> None:
        """Move all axes slowly to the start pose and wait until they stand there."""
        target, truth, at_rest = new(AXES), self.loop.now.truth, np.zeros(3)
        self.loop.bench.axes_of(truth.r_CT_H, at_rest, truth.q_CH, at_rest, target)
        self.begin()
        tick = self.seed_for_run()
        self.modes.go(Mode.PLACING)
        while not self._move_to(target, tick):
            tick = self.hold(tick)

    def park(self, place: np.record) -> None:
        """Move all axes slowly to ``place`` (AXES), where the bench is left; the turntable by its drives' profiles.

        The axes are at rest at its beginning, see ``brake``. Turntables that have gone by themselves take no
        setpoints until they are opened again.
        """
        self.begin()
        tick = self.seed_for_run()
        self.modes.go(Mode.PARKING)
        self.loop.bench.park_turntable(place, tick.now_s)
        if not self._move_to(place, tick):  # a hold was asked for: the bench stays where it comes to a stand
            self.brake()
        self.modes.go(Mode.STANDBY)

    def brake(self) -> None:
        """Bring all axes to a stand where they are."""
        bench, now = self.loop.bench, self.loop.now
        tick = self.begin()
        while bench.brake(tick.now_s, now.setpoint) or not bench.stands(tick.now_s, now.feedback):
            tick = self.tick()

    def _move_to(self, target: np.record, tick: Tick) -> bool:
        """Do one move from where the axes stand; return False where a hold cut it short."""
        bench, now, mode = self.loop.bench, self.loop.now, self.modes.mode
        wanted = new(AXES)
        move = Move(bench.params, now.feedback, target)
        start_s = tick.now_s
        cycle = 0
        while True:
            moved_s = tick.now_s - start_s
            ended = move.duration_s - moved_s < _NO_MOVE_S
            if ended and self._is_at(target) and bench.stands(tick.now_s, now.feedback):
                return True
            if moved_s > move.duration_s + _SETTLE_S:
                raise SafetyTrip("bench", _PLACE_NAMES[mode], "not reached", f"{_SETTLE_S:g} s after the move")
            move.at(moved_s + self._step_s, wanted)
            bench.command(wanted, tick.now_s, now.setpoint)
            tick = self.tick()
            if self.hold_requested(mode):
                return False
            cycle += 1
            if cycle % WATCH_CYCLES == 0 and move.duration_s > 0.0:
                self._on_progress(mode, min(1.0, moved_s / move.duration_s))

    def _is_at(self, target: np.record) -> bool:
        feedback = self.loop.now.feedback
        return bool(
            np.abs(feedback.rail_m - target.rail_m).max() < _SETTLED_M
            and np.abs(feedback.gimbal_rad - target.gimbal_rad).max() < _SETTLED_RAD
        )

    def hold_requested(self, mode: Mode) -> bool:
        """Return whether a hold is ordered or asked for; raises StopCommanded."""
        reason = self.safety.hold_reason
        if reason and not self._operator.can_resume:
            raise SafetyTrip("bench", "hold", f"({reason})", "in an attended run alone")
        if reason:
            return True
        return self._poll_command(mode) is OperatorCommand.HOLD

    def hold(self, tick: Tick) -> Tick:
        """Brake all axes to a stand and keep them there until RESUME; return the tick of the resumption.

        tick: one at which no setpoint has been sent yet. The references are seeded anew from the
        encoders at the end. Poses that come meanwhile are dropped. A GNC that is not ready is waited for.
        """
        bench, now = self.loop.bench, self.loop.now
        back = self.modes.mode
        self.modes.go(Mode.HOLD)
        resume = False
        while True:
            moving = bench.brake(tick.now_s, now.setpoint)
            order = self._poll_command(Mode.HOLD)
            resume = order is OperatorCommand.RESUME or (resume and order is not OperatorCommand.HOLD)
            if resume and not (moving or self.loop.gnc.not_ready) and bench.stands(tick.now_s, now.feedback):
                break
            tick = self.tick()
            if back is Mode.RUNNING:
                self.loop.vision.discard_pending(tick.now_s)
            if self.ticks % WATCH_CYCLES == 0:
                self._on_progress(Mode.HOLD, 0.0)
        bench.seed_for_run(tick.now_s, now.feedback)
        self.loop.vision.not_before_s = tick.now_s
        self.safety.hold_reason = ""
        self.modes.go(back)
        return tick

    def jog(self) -> None:
        """Jog the axis that the operator's key asks for, until the key is let go and the axis stands."""
        wish = self._operator.jog_request()
        if wish is None:
            return
        bench, now = self.loop.bench, self.loop.now
        tick = self.begin()
        jog = self._begin_jog(wish, tick)
        if jog is None:
            self._operator.end_jog()
            return
        try:
            moving = True
            while moving or not bench.stands(tick.now_s, now.feedback):
                moving = self._jog_step(jog, tick)
                tick = self.tick()
        finally:
            self._operator.end_jog()
            bench.set_jogging(False)
            self.safety.restore_travel()
        self.modes.go(Mode.STANDBY)

    def _begin_jog(self, wish: JogRequest, tick: Tick) -> Jog | None:
        """Seed the references and go to JOGGING; None, with an answer, where this axis cannot be jogged."""
        bench = self.loop.bench
        axis = bench.axis_names.index(wish.axis) if wish.axis in bench.axis_names else -1
        if axis < 0 or wish.direction not in (-1, 1):
            self._operator.rejections.append(f"bench: cannot jog {wish.axis} by {wish.direction}")
            return None
        homing = (*bench.seen[0].homing, *bench.seen[1].homing)
        bench.seed(tick.now_s, self.loop.now.feedback)
        jog = Jog(bench.params, axis, wish.direction, homing[axis] is Homing.DONE, bench.motion.position)
        if not bench.set_jogging(True):
            refusal = self.safety.interlock_motion(tick.now_s, *bench.seen, self.loop.now.feedback)
            if refusal is not None:  # these devices take setpoints on the bench alone
                self._operator.rejections.append(refusal.text)
                return None
        jog.key.refresh(tick.now_s)
        self.safety.widen_travel(jog.params.low, jog.params.high)
        self.modes.go(Mode.JOGGING)
        return jog

    def _jog_step(self, jog: Jog, tick: Tick) -> bool:
        """Send the next setpoint of a jog; return whether it goes on."""
        bench, now = self.loop.bench, self.loop.now
        self._poll_command(Mode.JOGGING)
        wish = self._operator.jog_request()
        if wish == JogRequest(bench.axis_names[jog.axis], jog.direction):
            jog.key.refresh(tick.now_s)
        switch = (*bench.seen[0].limit, *bench.seen[1].limit)[jog.axis]
        if not jog.may_move(tick.now_s, switch):
            return bench.brake(tick.now_s, now.setpoint, jog.params) or jog.key.pressed(tick.now_s)
        wanted = new(AXES)
        jog.aim(bench.motion, wanted)
        bench.command(wanted, tick.now_s, now.setpoint, jog.params)
        return True

    def _poll_command(self, mode: Mode) -> OperatorCommand | None:
        """Return the next order for ``mode``, if one waits; raises StopCommanded for STOP."""
        if not self._operator.pending:
            return None
        order = self._operator.pop(mode)
        if order is OperatorCommand.STOP:
            raise StopCommanded
        return order
