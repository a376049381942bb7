"""Runs a scenario on a bench as its operator orders: opens, places, closes the loop, stops the bench first."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hil.core.messages import Event
from hil.core.modes import Mode
from hil.core.observable import ObservableList
from hil.core.operator_commands import Operator, OperatorCommand, OrderedToStop
from hil.core.realtime import Grant, SchedulingPolicy, no_garbage_collection
from hil.drivers.base import PoseSource
from hil.errors import BenchError, DeviceError, SafetyTrip
from hil.loop.cycle import Loop, run_cycle
from hil.loop.motion_sequences import WATCH_CYCLES, MotionSequencer, Watch
from hil.loop.overrun_monitor import LateCycles
from hil.loop.rate_keeper import Rate
from hil.loop.root_cause import root_cause
from hil.safety.alarms import Alarm, alarm_of

COMPLETED = "completed"
STOPPED_BY_OPERATOR = "stopped by the operator"
_PAUSE_S: Final = 0.001


@dataclass(slots=True)
class Outcome:
    """What a run left: ``history`` (n,) of CYCLE, why it ended, and what was counted."""

    history: np.ndarray
    stop: str
    faults: list[str] = field(default_factory=list)
    mode: Mode = Mode.OFF
    overruns: int = 0
    skipped_periods: int = 0
    privileges: list[Grant] = field(default_factory=list)
    limited_cycles: int = 0
    vision_counters: dict[str, int] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    alarms: list[Alarm] = field(default_factory=list)


class Runner:
    """One session at the bench, with one run of ``cycles`` cycles.

    frames_to_arm: poses that must have come before the loop is closed. ``watch`` is called every
    ``WATCH_CYCLES`` cycles. ``late_cycles`` judges lost periods, from the first motion on. operator: gives
    the orders; without one the run goes through by itself and a fault ends it. parking: AXES, where the bench
    is left when a session ends with PARK, or after each whole run (``park_after_run``).
    """

    WATCH_CYCLES = WATCH_CYCLES

    def __init__(
        self,
        loop: Loop,
        rate: Rate,
        precedence: SchedulingPolicy,
        late_cycles: LateCycles,
        step_s: float,
        cycles: int,
        frames_to_arm: int,
        watch: Watch,
        operator: Operator | None = None,
        parking: np.record | None = None,
        park_after_run: bool = False,
    ) -> None:
        self.loop = loop
        self.operator = operator or Operator()
        self.supervisor = loop.bench.supervisor
        self.late_cycles = late_cycles
        self._precedence = precedence
        self._rate = rate
        self._step_s = step_s
        self._cycles = cycles
        self._frames_to_arm = frames_to_arm
        self._watch = watch
        self._modes = self.supervisor.modes
        self._handling = MotionSequencer(loop, rate, late_cycles, step_s, self.operator, watch)
        self._faults: list[str] = []
        self.events: ObservableList[Event] = ObservableList()
        """What the bench did beside the approach: holds."""
        self._done = 0
        self._parking = parking
        self._park_after_run = park_after_run
        self._parked = False

    @property
    def source(self) -> PoseSource:
        return self.loop.vision.source

    @property
    def rate(self) -> Rate:
        return self._rate

    def now_s(self) -> float:
        """Return bench time; for any thread."""
        return self._rate.now_s()

    def all_events(self) -> list[Event]:
        """Return what happened so far, in the order of the run's time; for the loop's thread."""
        return sorted([*self.loop.gnc.events(), *self.events], key=lambda event: event.t_s)

    def run(self) -> Outcome:
        """Run to the end, to a fault, or to Ctrl-C; the bench stands still whatever happened."""
        with no_garbage_collection(freeze=self._rate.on_the_wall):
            stop = self._run()
        end = Mode.SAFE_STOP if self._faults else Mode.STANDBY
        if self._modes.mode is not end:
            self._modes.go(end)
        return Outcome(
            history=self.loop.history[: self._done],
            stop=stop,
            faults=self._faults,
            mode=self._modes.mode,
            overruns=self._rate.overruns,
            skipped_periods=self._rate.skipped_periods,
            privileges=list(self._precedence.grants),
            limited_cycles=self.loop.bench.limited_cycles,
            vision_counters=self.source.counters(),
            events=self.all_events(),
            alarms=list(self.supervisor.alarms.all()),
        )

    @contextmanager
    def axes_alone(self) -> Iterator[MotionSequencer]:
        """Open the axes without the vision unit, give what moves them; at the end they are stopped first."""
        with no_garbage_collection(freeze=self._rate.on_the_wall):
            try:
                self.loop.lines.open(self._rate)
                self.loop.bench.open(self._rate.now_s())
                self.supervisor.opened()
                self._modes.go(Mode.STANDBY)
                with self._precedence.realtime_priority():  # after the drivers have started their threads
                    yield self._handling
            finally:
                self._shut_down()

    def _run(self) -> str:
        try:
            while self._session():
                pass
        except (KeyboardInterrupt, OrderedToStop):
            self._faults.append(STOPPED_BY_OPERATOR)
        finally:
            self._shut_down()
        return self._faults[-1] if self._faults else COMPLETED

    def _session(self) -> bool:
        """Go from opening the devices to the end of the run; after a fault return whether to begin anew."""
        try:
            self._open()
            with self._precedence.realtime_priority():  # after the drivers have started their threads
                while (order := self._next_order()) is not None:
                    self._obey(order)
                if self._park_after_run and self._done == self._cycles:
                    self._handling.brake()
                    self._modes.go(Mode.STANDBY)
                    self._park()
        except BenchError as fault:
            self._safe_stop(fault)
            return self.operator.attended and self._wait_for_reset()
        return False

    def _open(self) -> None:
        self.loop.gnc.open(self._rate.now_s())
        self.loop.lines.open(self._rate)
        self.loop.bench.open(self._rate.now_s())
        self.loop.target.open(self._rate.now_s())
        self.source.open(self._rate.now_s())
        self.supervisor.opened()
        self._modes.go(Mode.STANDBY)

    def _next_order(self) -> OperatorCommand | None:
        """Return the next order; None when the run is over or the bench parked, or when nobody is there to give one."""
        while not (self._done or self._parked):
            order = self.operator.next(self._modes.mode)
            if order is not None or not self.operator.attended:
                return order
            self._stand_by()
        return None

    def _stand_by(self) -> None:
        """Let one supervised cycle pass in which nothing moves."""
        tick = self._handling.tick()
        self.loop.vision.discard_pending(tick.now_s)
        if self._handling.ticks % self.WATCH_CYCLES == 0:
            self._watch(self._modes.mode, 0.0)

    def _obey(self, order: OperatorCommand) -> None:
        match order:
            case OperatorCommand.HOME:
                self._handling.home()
            case OperatorCommand.JOG:
                self._handling.jog()
            case OperatorCommand.ARM:
                self.loop.target.place(self._rate, self._handling.look)
                self._handling.place()
                self._arm()
            case OperatorCommand.START:
                self._close_the_loop()
            case OperatorCommand.DISARM:
                self._modes.go(Mode.STANDBY)
            case OperatorCommand.PARK:
                self._park()
            case OperatorCommand.STOP:
                raise OrderedToStop

    def _park(self) -> None:
        """Leave the bench where its rig says; the session ends there."""
        if self._parking is not None:
            self._handling.park(self._parking)
        self._parked = True

    def _arm(self) -> None:
        """Wait until the vision unit has delivered."""
        self._modes.go(Mode.ARMED)
        frames = 0
        while frames < self._frames_to_arm:
            tick = self._handling.tick()
            self.loop.target.look(tick.now_s)
            frames += self.loop.vision.discard_pending(tick.now_s)
            self._watch(Mode.ARMED, 0.0)

    def _close_the_loop(self) -> None:
        self._handling.seed_for_run()
        self._modes.go(Mode.RUNNING)
        self._rate.restart()
        held_s = 0.0
        for k in range(self._cycles):
            tick = self.late_cycles.wait(self._rate)
            run_cycle(self.loop, k, k * self._step_s, tick.now_s, tick.run_zero_s + held_s, tick.lateness_s)
            self._done = k + 1
            if k % self.WATCH_CYCLES == 0:
                self._watch(Mode.RUNNING, k / self._cycles)
            if k % self._handling.links_each == 0:
                self._handling.look_at_links(tick.now_s)
            self.operator.listen(tick.now_s)
            if self.operator.waiting or self.supervisor.hold_reason:
                held_s += self._obey_while_running(k * self._step_s)
        self.loop.gnc.finish((self._cycles - 1) * self._step_s, self.loop.now.supervision)
        self._watch(Mode.RUNNING, 1.0)

    def _obey_while_running(self, t_s: float) -> float:
        """Do what is ordered between two cycles; return for how long, s, the run's time stood."""
        order = None if self.supervisor.hold_reason else self.operator.take(Mode.RUNNING)
        if order is OperatorCommand.STOP:
            raise OrderedToStop
        if order is OperatorCommand.GO:
            self.loop.gnc.order_go()
        if order is OperatorCommand.ABORT:
            self.loop.gnc.order_abort()
        if not (self.supervisor.hold_reason or order is OperatorCommand.HOLD):
            return 0.0
        return self._hold(t_s)

    def _hold(self, t_s: float) -> float:
        reason = self.supervisor.hold_reason or "ordered by the operator"
        if not self.operator.grants_holds and self.supervisor.hold_reason:
            raise SafetyTrip("bench", "hold", f"({reason})", "in an attended run alone")
        self.events.append(Event(t_s, "bench", f"hold: {reason}"))
        before = self._handling.ticks
        self._handling.hold(self._handling.tick())
        held_s = (self._handling.ticks - before) * self._step_s
        self.events.append(Event(t_s, "bench", f"resumed after {held_s:.2f} s"))
        return held_s

    def _safe_stop(self, fault: BenchError) -> None:
        """Stop the bench, remember why, and give no order by itself any more."""
        with _ctrl_c_held_back():
            now_s = self._rate.now_s()
            self.loop.bench.stop(now_s)
            cause = root_cause(fault, self.loop, self._rate)
            self.supervisor.alarms.enter(alarm_of(cause, now_s))
            if cause is not fault:
                self.supervisor.alarms.enter(alarm_of(fault, now_s))
            self._faults.append(str(cause))
            self._modes.go(Mode.SAFE_STOP)
            self.operator.cancel_auto_sequence()

    def _wait_for_reset(self) -> bool:
        """Wait until the operator resets with the cause gone, then close everything; False once a run has begun.

        The devices are opened anew afterwards: they come back disarmed, in standby.
        """
        if self._done:
            return False
        while True:
            tick = self._rate.wait()
            with suppress(DeviceError):  # counts as pressed
                self.loop.bench.look_at_emergency_input(tick.now_s)
            self.operator.listen(tick.now_s)
            order = self.operator.take(Mode.SAFE_STOP)
            if order is OperatorCommand.STOP:
                raise OrderedToStop
            if order is OperatorCommand.RESET:
                refusal = self.supervisor.reset(tick.now_s)
                if refusal is None:
                    break
                self.operator.answers.append(refusal.text)
            if not self._rate.on_the_wall:
                time.sleep(_PAUSE_S)  # simulated time does not wait for anybody
        self._shut_down()
        self._faults.clear()
        self._modes.go(Mode.OFF)
        return True

    def _shut_down(self) -> None:
        """Stop the bench first, then let go of everything."""
        with _ctrl_c_held_back():
            self.loop.bench.stop(self._rate.now_s())
            self.loop.target.stop(self._rate.now_s())
            self.source.close()
            self.loop.bench.close()
            self.loop.target.close()
            self.loop.lines.stop(self._rate.now_s())
            self.loop.lines.close()
            self.loop.gnc.close()


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Let nobody interrupt the stopping of the bench."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
