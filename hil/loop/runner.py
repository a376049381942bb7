"""Runner of a session: opens the bench, executes the operator's commands, closes the loop, stops the bench first."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from typing import Any, Final

from hil.core import alarm_table as table
from hil.core.alarm_table import alarm_from_error
from hil.core.clock import pause_text
from hil.core.messages import Event
from hil.core.modes import Mode
from hil.core.observable import ObservableList
from hil.core.operator_commands import STOP_SIGNALS, TOO_LATE, Operator, OperatorCommand, StopCommanded
from hil.core.realtime import DefaultScheduling, no_garbage_collection
from hil.drivers.base import PoseSource
from hil.errors import BenchError, DeviceError, LinkLost, LinkTimeout, SafetyTrip, one_line
from hil.loop.controlled_stop import BRAKE_CONFIRMED_S, ControlledStop, RootCause
from hil.loop.cycle import Cycles, CyclesOf, Loop, PythonCycles
from hil.loop.loop_watch import LoopWatch
from hil.loop.motion_sequences import PROGRESS_CYCLES, MotionSequencer
from hil.loop.outcome import Outcome
from hil.loop.overrun_monitor import OverrunMonitor
from hil.loop.rate_keeper import Rate
from hil.loop.run_plan import RunPlan
from hil.loop.session_parts import SessionParts

COMPLETED = "completed"
STOPPED_BY_OPERATOR = "stopped by the operator"
_LONG_PAUSE_S: Final = 0.03
_STEP_S: Final = 2.0  # wall time for a step of a plug-in in real time, in which the bench has long been stopped
_CAUSED_BY_PAUSES: Final = tuple(
    kind.code for kind in (table.SAFETY_CHAIN, table.AGE_OF_SETPOINT, table.AGE_OF_FEEDBACK, table.FOLLOWING_ERROR)
)


class Runner:
    """One session at the bench, with one run.

    overrun_monitor: judges lost periods, from the first motion. parts: whose ``on_progress`` is called every
    ``PROGRESS_CYCLES`` cycles; without an operator the run starts automatically, and a fault ends it. cycles: makes
    what runs the cycles of the closed loop; None: one at a time in Python.
    """

    def __init__(
        self,
        loop: Loop,
        rate: Rate,
        overrun_monitor: OverrunMonitor,
        plan: RunPlan,
        parts: SessionParts,
        cycles: CyclesOf | None = None,
    ) -> None:
        self.loop = loop
        self.rate = rate
        self.operator = parts.operator or Operator()
        self.safety = loop.bench.safety
        self.overrun_monitor = overrun_monitor
        self._scheduling = parts.scheduling or DefaultScheduling()
        self._plan = plan
        self._on_progress = parts.on_progress
        self._modes = self.safety.modes
        self._sequencer = MotionSequencer(loop, rate, overrun_monitor, plan, self.operator, parts.on_progress)
        self._faults: list[str] = []
        self.events: ObservableList[Event] = ObservableList()
        """Events of the bench: holds, changed settings."""
        self.meters = parts.meters
        self.parts = parts
        python = PythonCycles(loop, lambda: self.overrun_monitor.wait(rate), plan.step_s)
        self.cycles: Cycles = cycles(loop, python) if cycles else python
        self._parked = False
        self._powered = False
        self._missing_frames = 0
        """Frames of the vision unit that ARM still waits for."""
        self._compared: dict[int, BenchError | None] = {}
        """Why the bench must not move, by what each part has last compared of it since it stands."""
        core = loop.memory.state
        self._watch = LoopWatch(lambda: (int(core.cycle), self._sequencer.ticks), self._step_timeout_s)

    def _step_timeout_s(self) -> float:
        """Return the time, s by the wall clock, after which a step of a plug-in is interrupted."""
        runs = self.rate.paced and self._modes.mode is Mode.RUNNING
        return _STEP_S if runs else self._plan.step_timeout_s

    @property
    def source(self) -> PoseSource:
        return self.loop.vision.source

    def now_s(self) -> float:
        """Return bench time; callable from any thread."""
        return self.rate.now_s()

    def all_events(self) -> list[Event]:
        """Return all events so far, ordered by the run's time; only for the loop's thread."""
        return sorted([*self.loop.gnc.events(), *self.events], key=lambda event: event.t_s)

    def run(self) -> Outcome:
        """Run to the end, to a fault, or to Ctrl-C; in each case the bench is stopped."""
        with no_garbage_collection(freeze=self.rate.paced), self._watch:
            stop = self._run()
        end = Mode.SAFE_STOP if self._faults else Mode.STANDBY
        if self._modes.mode is not end:
            self._modes.go(end)
        return self.outcome(stop)

    def outcome(self, stop: str) -> Outcome:
        """Return the results so far; stop: why the run ends or is held. Only while the loop's thread does not run."""
        sensors = self.loop.sensors
        return Outcome(
            history=self.loop.rows(),
            stop=stop,
            faults=list(self._faults),
            mode=self._modes.mode,
            overruns=self.rate.overruns,
            skipped_periods=self.rate.skipped_periods,
            privileges=list(self._scheduling.grants),
            limited_cycles=self.loop.bench.limited_cycles,
            vision_counters=self.source.counters(),
            events=self.all_events(),
            alarms=list(self.safety.alarms.all()),
            measured={table: meter() for table, meter in self.meters.items()} | {"limits": self._margins()},
            **({} if sensors is None else {"sensor_arrivals": sensors.kept()}),
        )

    def _margins(self) -> dict[str, Any]:
        """Return the margins of loop and links, which no row has: value and limit, with the times that are known."""
        lost_periods = self.overrun_monitor.margin() if self.rate.paced else None
        return self.safety.link_margins() | ({"lost_periods_of_loop": lost_periods} if lost_periods else {})

    @contextmanager
    def axes_only(self) -> Iterator[MotionSequencer]:
        """Open the axes without the vision unit and yield their sequencer; stop the axes first on exit."""
        with no_garbage_collection(freeze=self.rate.paced):
            try:
                self.loop.safety_io.open(self.rate)
                self._power_axes()
                self.safety.restart()
                self._modes.go(Mode.STANDBY)
                with self._scheduling.realtime_priority():  # after the drivers have started their threads
                    yield self._sequencer
            finally:
                self._shut_down()

    def _run(self) -> str:
        try:
            while self._session():
                pass
        except (KeyboardInterrupt, StopCommanded):
            if self._plan.until_stopped and self._modes.mode is Mode.RUNNING:
                self._finish()
            else:
                self._faults.append(STOPPED_BY_OPERATOR)
        finally:
            self._shut_down()
        return self._faults[-1] if self._faults else COMPLETED

    def _session(self) -> bool:
        """Open the devices and execute commands to the end of the run; after a fault return whether to restart."""
        try:
            for check in self.parts.before_open:
                check()
            self._open()
            with self._scheduling.realtime_priority():  # after the drivers have started their threads
                while (command := self._next_command()) is not None:
                    self._execute(command)
                if self._plan.park_after_run and self.loop.done == self._plan.cycles:
                    self._sequencer.brake()
                    self._modes.go(Mode.STANDBY)
                    self._park()
        except BenchError as fault:
            signalled = self._safe_stop(fault)
            return self.operator.attended and not signalled and self._wait_for_reset()
        return False

    def _open(self) -> None:
        self.loop.gnc.open(self.rate.now_s())
        self.source.open(self.rate.now_s())  # before any drive has power: cameras may take seconds, or be missing
        self.loop.safety_io.open(self.rate)
        self._power_axes()
        self.safety.restart()
        self._modes.go(Mode.STANDBY)

    def _power_axes(self) -> None:
        """Enable the drives, which hold the axes, and release the holding brakes."""
        self._powered = True
        self._compared.clear()
        self._sequencer.warning_s = self._plan.warning_s
        try:
            self.loop.bench.open(self.rate.now_s())
        except DeviceError:
            self.loop.safety_io.check(self.rate.now_s())  # an open chain is the cause: no drive has torque then
            raise
        self.loop.target.open(self.rate.now_s())
        self._missing_frames = 0
        released_s = self.rate.now_s()
        self.loop.safety_io.release_brakes(True, released_s)
        open_s, now_s = self._plan.brakes.open_s, released_s
        while now_s - released_s < open_s or self.loop.safety_io.brakes_closed(now_s):
            if now_s - released_s > open_s + BRAKE_CONFIRMED_S:
                raise table.HOLDING_BRAKES.trip("io", "closed", f"open {open_s:g} s after their release")
            now_s = self.rate.wait().now_s
            self._sequencer.check(now_s)

    def _next_command(self) -> OperatorCommand | None:
        """Return the next command; None if the run is over, the bench is parked, or no operator can issue one."""
        while not (self.loop.done or self._parked):
            waits = self._missing_frames > 0
            if not waits or OperatorCommand.DISARM in self.operator.pending:
                command = self.operator.next_command(self._modes.mode)
                if command is not None or not (self.operator.attended or waits):
                    return command
            self._stand_by()
        return None

    def _stand_by(self) -> None:
        """Run one monitored cycle without motion."""
        self._watch.check()
        tick = self._sequencer.tick()
        frames = self.loop.discard_frames(tick.now_s)
        self._missing_frames = max(0, self._missing_frames - frames)
        if self._sequencer.ticks % self._sequencer.progress_ticks == 0:
            self._on_progress(self._modes.mode, 0.0)
        for number, check in enumerate(self.parts.before_motion if self._modes.mode is Mode.STANDBY else ()):
            try:
                if check(self.rate.now_s(), self.loop.now.feedback):
                    self._compared[number] = None
            except BenchError as reason:
                self._compared[number] = reason

    def _execute(self, command: OperatorCommand) -> None:
        if command.moves and (alarm := self.safety.interlock_power(self.rate.now_s())):
            if not self.operator.attended:
                raise alarm.trip()
            self.operator.rejections.append(alarm.text)
            self.operator.end_jog()
            return
        if command is OperatorCommand.ARM and not self._has_been_compared():
            return
        if command.moves:
            self._compared.clear()
        match command:
            case OperatorCommand.HOME:
                self._sequencer.home()
            case OperatorCommand.JOG:
                self._sequencer.jog()
            case OperatorCommand.ARM:
                self._sequencer.place()
                self._modes.go(Mode.ARMED)
                self._missing_frames = self._plan.frames_to_arm
            case OperatorCommand.START if self._missing_frames:
                self.operator.rejections.append("bench: cannot start: no frames of the vision unit yet")
            case OperatorCommand.START:
                self._close_the_loop()
            case OperatorCommand.DISARM:
                self._missing_frames = 0
                self._modes.go(Mode.STANDBY)
            case OperatorCommand.PARK:
                self._park()
            case OperatorCommand.STOP:
                raise StopCommanded

    def _park(self) -> None:
        """Move to the rig's park position; the session ends there."""
        if self._plan.park_position is not None:
            self._sequencer.park(self._plan.park_position)
        self._parked = True

    def _has_been_compared(self) -> bool:
        """Wait for parts that compare the standing bench; return False when ARM has become too late meanwhile.

        Raises BenchError if the bench must not move.
        """
        while len(self._compared) < len(self.parts.before_motion):
            self._stand_by()
            if self.operator.is_late(OperatorCommand.ARM):
                self.operator.rejections.append(f"bench: arm {TOO_LATE} (the bench was compared before its motion)")
                return False
        for reason in filter(None, self._compared.values()):
            raise reason
        return True

    def _close_the_loop(self) -> None:
        self._sequencer.seed_for_run()
        self._modes.go(Mode.RUNNING)
        self.rate.restart()
        self.overrun_monitor.restart()
        step_s, cycles = self._plan.step_s, self._plan.cycles
        held_s = 0.0
        # a signal is the regular end of such a run: between two cycles, so that each recorded one is counted
        regular_end = self._plan.until_stopped and not self.operator.attended
        with _signals_counted() if regular_end else nullcontext(list[int]()) as signals:
            while (first := self.loop.done) < cycles:
                if signals:
                    raise StopCommanded
                tick = self.cycles.advance(held_s)
                self._watch.check()
                last = self.loop.done - 1
                if _has_multiple(first, last, PROGRESS_CYCLES):
                    self._on_progress(Mode.RUNNING, last / cycles)
                if _has_multiple(first, last, self._sequencer.link_check_cycles):
                    self._sequencer.check_links(tick.now_s)
                self.operator.poll(tick.now_s)
                if self.operator.pending or self.safety.hold_reason:
                    held_s += self._execute_while_running(last * step_s)
        self._finish()
        self._on_progress(Mode.RUNNING, 1.0)

    def _finish(self) -> None:
        """Let the GNC decide on docking at the end of the run."""
        self.loop.gnc.finish((self.loop.done - 1) * self._plan.step_s, self.loop.now.supervision)

    def _execute_while_running(self, t_s: float) -> float:
        """Execute a command between two cycles; return the duration of a hold, s, in which the run's time stops."""
        command = None if self.safety.hold_reason else self.operator.pop(Mode.RUNNING)
        if command is OperatorCommand.STOP:
            raise StopCommanded
        if command is OperatorCommand.GO:
            self.loop.gnc.order_go()
        if command is OperatorCommand.ABORT:
            self.loop.gnc.order_abort()
        if not (self.safety.hold_reason or command is OperatorCommand.HOLD):
            return 0.0
        return self._hold(t_s)

    def _hold(self, t_s: float) -> float:
        reason = self.safety.hold_reason or "commanded by the operator"
        if not self.loop.bench.can_hold:
            raise table.HOLD.trip("bench", f"({reason})", "none: the vehicle floats")
        self._sequencer.require_resumable_hold()
        self.events.append(Event(t_s, "bench", f"hold: {reason}"))
        previous = self._sequencer.ticks
        self._sequencer.hold(self._sequencer.tick())
        held_s = (self._sequencer.ticks - previous) * self._plan.tick_s
        self.events.append(Event(t_s, "bench", f"resumed after {held_s:.2f} s"))
        return held_s

    def _safe_stop(self, fault: BenchError) -> bool:
        """Stop the bench, latch the alarms, cancel the automatic commands, and switch the torque off.

        Return whether a signal that ends the program has been received meanwhile.
        """
        with _signals_counted() as signals:
            begun_s = self.rate.now_s()
            stop = self._controlled_stop(signals)
            search = RootCause(fault, self.loop, self.rate, self._powered)

            def report_cause(now_s: float) -> None:
                if self._modes.mode is Mode.SAFE_STOP or (cause := search.poll(now_s, stop.cut)) is None:
                    return
                if (found := self.parts.process_failures(cause)) is None:
                    return
                pause = found or self._host_pause(cause)
                alarm = alarm_from_error(cause, begun_s)
                self.safety.alarms.latch(replace(alarm, text=alarm.text + pause))
                if cause is not fault:
                    self.safety.alarms.latch(alarm_from_error(fault, begun_s))
                self._faults.append(one_line(f"{cause}{pause}"))
                self._modes.go(Mode.SAFE_STOP)
                self.operator.cancel_auto_sequence()

            if self._powered:
                stop.brake(report_cause)
            while self._modes.mode is not Mode.SAFE_STOP:
                report_cause(self.rate.now_s() if stop.cut or not self._powered else stop.watch())
                self.rate.pause()
            if self._powered:
                stop.remove_torque()
            self._powered = False
            return bool(signals)

    def _host_pause(self, cause: BenchError) -> str:
        """Return the longest recent pause of loop, I/O or watchdog process, as an addition to the text of a fault.

        "" without one, or if it cannot be the cause: other faults than a lost link take a long pause.
        """
        is_link = isinstance(cause, LinkLost | LinkTimeout)
        if not (is_link or (isinstance(cause, SafetyTrip) and cause.alarm.code in _CAUSED_BY_PAUSES)):
            return ""
        pauses = {"the loop": self.rate.pause_s, **self.parts.process_pauses()}
        longest = max(pauses, key=pauses.__getitem__)
        if pauses[longest] < (0.0 if is_link else _LONG_PAUSE_S) or "(the host paused" in str(cause):
            return ""
        return pause_text(longest, pauses[longest])

    def _controlled_stop(self, signals: list[int]) -> ControlledStop:
        """Return a stop of the bench; a later signal, or STOP, ends the watch over axes that no brake holds.

        STOP stays pending: it ends the session as well. RESET is rejected until the stop is over.
        """

        def ended(now_s: float) -> bool:
            self.operator.poll(now_s)
            command = self.operator.pop(Mode.SAFE_STOP)
            if command is OperatorCommand.STOP:
                self.operator.submit(command)
            elif command is not None:
                self.operator.rejections.append(f"bench: cannot {command.value} before the stop is over")
            return bool(signals) or command is OperatorCommand.STOP

        return ControlledStop(self.loop, self.rate, self._plan.brakes, ended)

    def _wait_for_reset(self) -> bool:
        """Wait for a reset with the cause removed, then close all devices; return False if a run has started.

        The devices are reopened afterwards, disarmed, in standby.
        """
        if self.loop.done:
            return False
        while True:
            tick = self.rate.wait()
            with suppress(DeviceError):  # counts as pressed
                self.loop.bench.poll_safety_inputs(tick.now_s)
            self.operator.poll(tick.now_s)
            command = self.operator.pop(Mode.SAFE_STOP)
            if command is OperatorCommand.STOP:
                raise StopCommanded
            if command is OperatorCommand.RESET:
                alarm = self.safety.reset(tick.now_s)
                if alarm is None:
                    break
                self.operator.rejections.append(alarm.text)
            if not self.rate.paced:
                self.rate.pause()  # simulated time runs without waiting: leave the CPU to other threads
        self._shut_down()
        self._faults.clear()
        self._modes.go(Mode.OFF)
        return True

    def _shut_down(self) -> None:
        """Stop the bench first, then close all devices."""
        with _signals_counted() as signals:
            if self._powered:
                stop = self._controlled_stop(signals)
                stop.brake()
                stop.remove_torque()
                self._powered = False
                self._faults[:0] = map(str, stop.failures)
            self.source.close()
            if self.loop.sensors is not None:
                self.loop.sensors.close()
            self.loop.dss.close()
            self.loop.bench.close()
            self.loop.target.close()
            self.loop.safety_io.stop(self.rate.now_s())
            self.loop.safety_io.close()
            self.loop.gnc.close()


def _has_multiple(first: int, last: int, n: int) -> bool:
    """Return whether one of the numbers ``first`` to ``last`` is a multiple of ``n``."""
    return last // n > (first - 1) // n


@contextmanager
def _signals_counted() -> Iterator[list[int]]:
    """Defer the signals that end the program while the bench is being stopped; yield those received."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    handlers = {number: signal.signal(number, lambda n, _: received.append(n)) for number in STOP_SIGNALS}
    try:
        yield received
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
