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
from hil.core.operator_commands import Operator, OperatorCommand, StopCommanded
from hil.core.realtime import Grant, SchedulingPolicy, no_garbage_collection
from hil.drivers.base import PoseSource
from hil.errors import BenchError, DeviceError, SafetyTrip
from hil.loop.cycle import Loop, run_cycle
from hil.loop.motion_sequences import WATCH_CYCLES, MotionSequencer, ProgressCallback
from hil.loop.overrun_monitor import OverrunMonitor
from hil.loop.rate_keeper import Rate
from hil.loop.root_cause import root_cause
from hil.safety.alarms import Alarm, alarm_from_error

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

    frames_to_arm: poses that must have come before the loop is closed. ``on_progress`` is called every
    ``WATCH_CYCLES`` cycles. ``overrun_monitor`` judges lost periods, from the first motion on. operator: gives
    the orders; without one the run goes through by itself and a fault ends it. parking: AXES, where the bench
    is left when a session ends with PARK, or after each whole run (``park_after_run``).
    """

    WATCH_CYCLES = WATCH_CYCLES

    def __init__(
        self,
        loop: Loop,
        rate: Rate,
        precedence: SchedulingPolicy,
        overrun_monitor: OverrunMonitor,
        step_s: float,
        cycles: int,
        frames_to_arm: int,
        on_progress: ProgressCallback,
        operator: Operator | None = None,
        parking: np.record | None = None,
        park_after_run: bool = False,
    ) -> None:
        self.loop = loop
        self.operator = operator or Operator()
        self.safety = loop.bench.safety
        self.overrun_monitor = overrun_monitor
        self._precedence = precedence
        self._rate = rate
        self._step_s = step_s
        self._cycles = cycles
        self._frames_to_arm = frames_to_arm
        self._on_progress = on_progress
        self._modes = self.safety.modes
        self._sequencer = MotionSequencer(loop, rate, overrun_monitor, step_s, self.operator, on_progress)
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
            alarms=list(self.safety.alarms.all()),
        )

    @contextmanager
    def axes_only(self) -> Iterator[MotionSequencer]:
        """Open the axes without the vision unit, give what moves them; at the end they are stopped first."""
        with no_garbage_collection(freeze=self._rate.on_the_wall):
            try:
                self.loop.safety_io.open(self._rate)
                self.loop.bench.open(self._rate.now_s())
                self.safety.opened()
                self._modes.go(Mode.STANDBY)
                with self._precedence.realtime_priority():  # after the drivers have started their threads
                    yield self._sequencer
            finally:
                self._shut_down()

    def _run(self) -> str:
        try:
            while self._session():
                pass
        except (KeyboardInterrupt, StopCommanded):
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
                    self._sequencer.brake()
                    self._modes.go(Mode.STANDBY)
                    self._park()
        except BenchError as fault:
            self._safe_stop(fault)
            return self.operator.attended and self._wait_for_reset()
        return False

    def _open(self) -> None:
        self.loop.gnc.open(self._rate.now_s())
        self.loop.safety_io.open(self._rate)
        self.loop.bench.open(self._rate.now_s())
        self.loop.target.open(self._rate.now_s())
        self.source.open(self._rate.now_s())
        self.safety.opened()
        self._modes.go(Mode.STANDBY)

    def _next_order(self) -> OperatorCommand | None:
        """Return the next order; None when the run is over or the bench parked, or when nobody is there to give one."""
        while not (self._done or self._parked):
            order = self.operator.next_command(self._modes.mode)
            if order is not None or not self.operator.attended:
                return order
            self._stand_by()
        return None

    def _stand_by(self) -> None:
        """Let one supervised cycle pass in which nothing moves."""
        tick = self._sequencer.tick()
        self.loop.vision.discard_pending(tick.now_s)
        if self._sequencer.ticks % self.WATCH_CYCLES == 0:
            self._on_progress(self._modes.mode, 0.0)

    def _obey(self, order: OperatorCommand) -> None:
        match order:
            case OperatorCommand.HOME:
                self._sequencer.home()
            case OperatorCommand.JOG:
                self._sequencer.jog()
            case OperatorCommand.ARM:
                self.loop.target.place(self._rate, self._sequencer.check)
                self._sequencer.place()
                self._arm()
            case OperatorCommand.START:
                self._close_the_loop()
            case OperatorCommand.DISARM:
                self._modes.go(Mode.STANDBY)
            case OperatorCommand.PARK:
                self._park()
            case OperatorCommand.STOP:
                raise StopCommanded

    def _park(self) -> None:
        """Leave the bench where its rig says; the session ends there."""
        if self._parking is not None:
            self._sequencer.park(self._parking)
        self._parked = True

    def _arm(self) -> None:
        """Wait until the vision unit has delivered."""
        self._modes.go(Mode.ARMED)
        frames = 0
        while frames < self._frames_to_arm:
            tick = self._sequencer.tick()
            self.loop.target.check(tick.now_s)
            frames += self.loop.vision.discard_pending(tick.now_s)
            self._on_progress(Mode.ARMED, 0.0)

    def _close_the_loop(self) -> None:
        self._sequencer.seed_for_run()
        self._modes.go(Mode.RUNNING)
        self._rate.restart()
        held_s = 0.0
        for k in range(self._cycles):
            tick = self.overrun_monitor.wait(self._rate)
            run_cycle(self.loop, k, k * self._step_s, tick.now_s, tick.run_zero_s + held_s, tick.lateness_s)
            self._done = k + 1
            if k % self.WATCH_CYCLES == 0:
                self._on_progress(Mode.RUNNING, k / self._cycles)
            if k % self._sequencer.link_check_cycles == 0:
                self._sequencer.check_links(tick.now_s)
            self.operator.poll(tick.now_s)
            if self.operator.pending or self.safety.hold_reason:
                held_s += self._obey_while_running(k * self._step_s)
        self.loop.gnc.finish((self._cycles - 1) * self._step_s, self.loop.now.supervision)
        self._on_progress(Mode.RUNNING, 1.0)

    def _obey_while_running(self, t_s: float) -> float:
        """Do what is ordered between two cycles; return for how long, s, the run's time stood."""
        order = None if self.safety.hold_reason else self.operator.pop(Mode.RUNNING)
        if order is OperatorCommand.STOP:
            raise StopCommanded
        if order is OperatorCommand.GO:
            self.loop.gnc.order_go()
        if order is OperatorCommand.ABORT:
            self.loop.gnc.order_abort()
        if not (self.safety.hold_reason or order is OperatorCommand.HOLD):
            return 0.0
        return self._hold(t_s)

    def _hold(self, t_s: float) -> float:
        reason = self.safety.hold_reason or "ordered by the operator"
        if not self.operator.can_resume and self.safety.hold_reason:
            raise SafetyTrip("bench", "hold", f"({reason})", "in an attended run alone")
        self.events.append(Event(t_s, "bench", f"hold: {reason}"))
        before = self._sequencer.ticks
        self._sequencer.hold(self._sequencer.tick())
        held_s = (self._sequencer.ticks - before) * self._step_s
        self.events.append(Event(t_s, "bench", f"resumed after {held_s:.2f} s"))
        return held_s

    def _safe_stop(self, fault: BenchError) -> None:
        """Stop the bench, remember why, and give no order by itself any more."""
        with _ctrl_c_held_back():
            now_s = self._rate.now_s()
            self.loop.bench.stop(now_s)
            cause = root_cause(fault, self.loop, self._rate)
            self.safety.alarms.latch(alarm_from_error(cause, now_s))
            if cause is not fault:
                self.safety.alarms.latch(alarm_from_error(fault, now_s))
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
                self.loop.bench.poll_emergency_input(tick.now_s)
            self.operator.poll(tick.now_s)
            order = self.operator.pop(Mode.SAFE_STOP)
            if order is OperatorCommand.STOP:
                raise StopCommanded
            if order is OperatorCommand.RESET:
                refusal = self.safety.reset(tick.now_s)
                if refusal is None:
                    break
                self.operator.rejections.append(refusal.text)
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
            self.loop.safety_io.stop(self._rate.now_s())
            self.loop.safety_io.close()
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
