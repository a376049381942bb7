"""Bench under a test procedure in Python: ``hil.Bench``.

The session runs in a thread of its own; the procedure's commands go through an operator's queue, like commands of the
console do. While a command is executed the procedure waits: its thread must not compete with the loop's.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Final, Literal, Self, cast

import numpy as np

from hil.api import jobs
from hil.api.results import Run
from hil.api.runs import RunRequest, gnc_summary, judged_run, log, run_job
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.alarms import Alarm
from hil.core.fields import record_dtype
from hil.core.messages import GIMBALS_FIELDS, new
from hil.core.modes import AT_REST, Mode
from hil.core.operator_commands import Operator, OperatorCommand
from hil.core.plug_ins import raised_text
from hil.core.public import public
from hil.errors import BadInput, BenchError
from hil.gnc_backends.python_backend import PythonGnc
from hil.loop.outcome import Outcome
from hil.loop.rate_keeper import WallClockRate
from hil.loop.runner import Runner
from hil.parts.campaigns.api.requirements import RunRequirement, write_run_evidence
from hil.parts.campaigns.requirements_page import EvidenceRow
from hil.session import build
from hil.session.warm_up import compile_kernels

Until = Literal["ready", "end"] | float
_ON_HOLD: Final = "on hold"
_POLL_WALL_S: Final = 0.2  # polling period of the procedure's thread, so that Ctrl-C is noticed
_END_WALL_S: Final = 60.0
_OPEN_S: Final = 60.0


@dataclass
class _Step:
    """A command of the procedure. ended: whether it is complete; every_cycle: called while it is not.

    name: in errors. command: submitted at the beginning; None: ``every_cycle`` does it. begun_s: bench time, nan before
    the first cycle. problem: why it could not be completed, "" if it is.
    """

    name: str
    command: OperatorCommand | None
    ended: Callable[[Runner, float], bool]
    timeout_s: float
    every_cycle: Callable[[Runner, float], None] = lambda *_: None
    begun_s: float = float("nan")
    done: bool = False
    problem: str = ""


class ProcedureOperator(Operator):
    """Operator whose commands come from a procedure in another thread, one step after the other.

    On a rig in simulated time, or in lock-step, the time stands between two steps.
    """

    def __init__(self) -> None:
        super().__init__((), attended=True)
        self.runner: Runner | None = None
        self._changed = threading.Condition()
        self._step: _Step | None = None
        self._idle = False
        self._session_ended = False

    def begin_session(self, runner: Runner) -> None:
        """Take the runner before it starts."""
        self.runner = runner

    def end_session(self) -> None:
        """Release the procedure: no further command can be executed."""
        with self._changed:
            self._session_ended = True
            self._changed.notify_all()

    def next_command(self, mode: Mode) -> OperatorCommand | None:
        """Return the next command. The one before it has ended: the loop asks between two commands only."""
        self._idle = True
        command = super().next_command(mode)
        if command is not None:
            self._idle = False
        return command

    def poll(self, now_s: float) -> None:
        """Check whether the present step has ended; unless time is the wall clock's, wait for the next one."""
        runner = self.runner
        assert runner is not None
        with self._changed:
            if self._step is not None and not self._step.done:
                self._check(self._step, runner, now_s)
            while not isinstance(runner.rate, WallClockRate) and self._is_between_steps(runner, now_s):
                self._changed.wait()

    def execute(self, step: _Step) -> bool:
        """Execute a step from the procedure's thread; return False if the session ended first. Raises BenchError."""
        with self._changed:
            if not self._session_ended:
                self._step = step
                self.rejections.clear()
                if step.command is not None:
                    self._idle = False
                    self.submit(step.command)
                self._changed.notify_all()
            while not (step.done or self._session_ended):
                self._changed.wait(_POLL_WALL_S)
        if step.problem:
            raise BenchError(step.problem)
        return step.done

    def wake(self) -> None:
        """Let the loop notice a submitted command also while simulated time stands."""
        with self._changed:
            self._changed.notify_all()

    def is_idle(self, runner: Runner) -> bool:
        """Return whether no command is being executed, or pending, in the bench's mode."""
        return self._idle and not self.pending and runner.safety.modes.mode in AT_REST

    def _check(self, step: _Step, runner: Runner, now_s: float) -> None:
        if step.begun_s != step.begun_s:
            step.begun_s = now_s
        step.every_cycle(runner, now_s)
        if runner.safety.modes.mode is Mode.SAFE_STOP and step.command is not OperatorCommand.RESET:
            step.problem = runner.safety.alarms.latest_trip().text
        elif self.rejections:
            step.problem = self.rejections[-1]
        elif not step.ended(runner, now_s):
            if not step.problem and now_s - step.begun_s > step.timeout_s:
                step.problem = f"bench: {step.name} not done within {step.timeout_s:g} s"
                self.submit(OperatorCommand.HOLD if self.runs else OperatorCommand.STOP)
            if not (step.problem and _is_at_rest(runner, now_s)):
                return
        step.done = True
        self._changed.notify_all()

    @property
    def runs(self) -> bool:
        """Whether the loop is closed."""
        return self.runner is not None and self.runner.safety.modes.mode is Mode.RUNNING

    def _is_between_steps(self, runner: Runner, now_s: float) -> bool:
        return _is_at_rest(runner, now_s) and not self.pending and (self._step is None or self._step.done)


def _is_at_rest(runner: Runner, now_s: float) -> bool:
    """Return whether no axis moves or is about to."""
    mode, bench = runner.safety.modes.mode, runner.loop.bench
    return mode is Mode.SAFE_STOP or (mode in AT_REST and bench.at_rest(now_s))


@public
class Bench:
    """A bench, its devices open, for a test procedure in Python.

        with hil.Bench("lab.toml", "scheme-1") as bench:
            bench.home()
            bench.arm()
            run = bench.start(until="ready", timeout_s=300)

    Each method executes one command and returns when it has ended. A bench that leaves its ``with`` stands still,
    without torque, and its devices are closed. Times are bench time: simulated on the mock rig and in lock-step, where
    time stands between two commands, and wall clock times ``speed`` on all others. Methods raise BenchError if the
    bench rejects the command in its present mode, if a device or the safety monitor stops the bench, and after the
    time-out; the text names the device.
    """

    def __init__(
        self,
        rig: str | Path | Rig,
        scenario: str | Path | Scenario,
        seed: int = 0,
        overrides: jobs.Overrides | None = None,
        gnc: PythonGnc | None = None,
        record: str | Path | None = None,
        speed: float = 1.0,
    ) -> None:
        """Check the arguments: see ``hil.run``. Raises BadInput; nothing moves and nothing is opened.

        overrides: ``{"faults": [...]}`` injects faults. speed: relative to real time, on rigs that run in real time.
        """
        with jobs.named_as_argument():
            self._job = replace(jobs.job_of(scenario, rig, overrides, seed, speed=speed, gnc=gnc), compiled=False)
            build.check(self._job)
        self._operator = ProcedureOperator()
        self._request = RunRequest(
            self._job,
            jobs.rig_name(rig),
            record,
            gnc_summary(gnc),
            announce=log.info,
            operator=self._operator,
            prepare=lambda parts: parts.on_built.append(self._operator.begin_session),
        )
        self._thread = threading.Thread(target=self._session, name="bench", daemon=True)
        self._failure: BaseException | None = None
        self.result: Run | None = None
        """The whole run, once the session has ended; None before, and without a session."""
        self._requirements: list[RunRequirement] = []
        self._latest: Run | None = None
        self._ordered_hold = False

    def __enter__(self) -> Self:
        compile_kernels(self._job, log.warning)
        self._thread.start()
        try:
            self._execute_step(_Step("open", None, lambda runner, _: runner.safety.modes.mode is Mode.STANDBY, _OPEN_S))
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            log.error("bench: stopped, %s", raised_text("its procedure", error))
        self._end()
        if kind is None and self._failure is not None:
            raise self._failure

    @property
    def mode(self) -> Mode:
        """Present mode of the bench."""
        runner = self._operator.runner
        return runner.safety.modes.mode if runner is not None and self._thread.is_alive() else Mode.OFF

    @property
    def alarms(self) -> list[Alarm]:
        """Alarms of the session so far, as in ``Run.alarms``, high priority first; kept after its end."""
        runner = self._operator.runner
        return list(runner.safety.alarms.all()) if runner is not None else []

    def require(self, *requirements: RunRequirement) -> None:
        """Add requirements that the run is to keep in each of its cycles; ``evidence`` has their verdicts."""
        self._requirements += requirements

    @property
    def evidence(self) -> list[EvidenceRow]:
        """Result, margin and status of each requirement, of the run so far, since the last ``start`` or ``resume``.

        Raises BenchError before the first of them has returned.
        """
        run = self._judged_run()
        return [requirement.check(run) for requirement in self._requirements]

    @public
    def write_evidence(self, folder: str | Path) -> None:
        """Write ``requirements.html``, ``.xml`` (JUnit) and ``.json`` with ``evidence`` into ``folder``."""
        write_run_evidence(folder, self._judged_run(), self.evidence)

    def _judged_run(self) -> Run:
        run = self.result or self._latest
        if run is None:
            raise BenchError("bench: no evidence, no run has been started")
        return run

    def feedback(self) -> np.record:
        """Return the newest encoder samples: ``rail_m``, ``rail_mps``, ``gimbal_rad``, ``gimbal_radps``, (3,) each."""
        runner = self._operator.runner
        if runner is None:
            raise self._ended_error("read the encoders")
        feedback: np.record = runner.loop.now.feedback.copy()
        return feedback

    def target_feedback(self) -> np.record:
        """Return the newest encoder samples of the rotary manipulator: ``angle_rad``, ``rate_radps``, (3,) each.

        Raises BenchError without one.
        """
        runner = self._operator.runner
        if runner is None:
            raise self._ended_error("read the encoders")
        manipulator = runner.loop.bench.manipulator
        if manipulator is None or manipulator.params.rails:
            raise BenchError(f"bench: cannot read the target's encoders, {self._request.rig_name} rotates no target")
        feedback = new(record_dtype(GIMBALS_FIELDS))
        feedback.angle_rad, feedback.rate_radps = manipulator.feedback.position, manipulator.feedback.rate
        return feedback

    @public
    def axis_feedback(self, axis: str) -> tuple[float, float]:
        """Return the newest position and rate of one axis, by its encoder: m and m/s, or rad and rad/s.

        axis: as in ``jog``. Raises BadInput.
        """
        runner = self._operator.runner
        if runner is None:
            raise self._ended_error("read the encoders")
        groups = zip((runner.loop.bench.rails, runner.loop.bench.turntable), runner.loop.bench.feedback, strict=True)
        others = ((group.axes, group.feedback) for group in runner.loop.target.groups)
        for device, feedback in (*groups, *others):
            if axis in device.axis_names:
                number = device.axis_names.index(axis)
                return float(feedback.position[number]), float(feedback.rate[number])
        names = ", ".join(self._job.rig.value.axis_names)
        raise BadInput.single("axis_feedback", "", f"{axis!r}: must be one of {names}")

    @public
    def home(self, timeout_s: float = 180.0) -> None:
        """Home the axes that need it."""
        self._command(OperatorCommand.HOME, Mode.STANDBY, timeout_s)

    @public
    def jog(self, axis: str, direction: int, duration_s: float) -> None:
        """Move one axis slowly, as long as an operator would press the key.

        axis: ``rails.x`` to ``turntable.yaw``, ``target.roll`` to ``target.yaw`` of a rotary manipulator, ``light.x``
        of further axes; direction: 1 or -1; duration_s: of the key, s. Raises BadInput.
        """
        axes = self._job.rig.value.axis_names
        if axis not in axes or direction not in (-1, 1) or not jobs.is_positive(duration_s):
            text = f"{axis!r}, {direction!r}, {duration_s!r}: must be one of {', '.join(axes)}; 1 or -1; above 0 s"
            raise BadInput.single("jog", "", text)
        step = _Step("jog", None, lambda *_: False, duration_s + 10.0)

        def press(runner: Runner, now_s: float) -> None:
            if now_s - step.begun_s < duration_s:
                self._operator.jog(axis, direction)

        step.every_cycle = press
        step.ended = lambda runner, now_s: now_s - step.begun_s >= duration_s and self._operator.is_idle(runner)
        self._execute_step(step)

    @public
    def arm(self, timeout_s: float = 300.0) -> None:
        """Move the bench to the start pose and wait for poses of the vision unit."""
        self._command(OperatorCommand.ARM, Mode.ARMED, timeout_s)

    @public
    def disarm(self, timeout_s: float = 10.0) -> None:
        """Return from the start pose to standby; the axes stay where they are."""
        self._command(OperatorCommand.DISARM, Mode.STANDBY, timeout_s)

    @public
    def start(self, until: Until = "end", timeout_s: float = float("inf")) -> Run:
        """Close the loop; return the run so far.

        until: ``end`` of the scenario; ``ready``: the estimate has been healthy and within Table III for the dwell
        time; or a time of the run, s. There the bench is put on hold: its axes at rest, the run's time held, until
        ``resume`` or the end of the ``with``. timeout_s: bench time, after which the bench is put on hold and
        BenchError raised.
        """
        return self._fly(OperatorCommand.START, until, timeout_s)

    @public
    def resume(self, until: Until = "end", timeout_s: float = float("inf")) -> Run:
        """Continue a run that is on hold; ``until``, ``timeout_s`` and result as for ``start``."""
        return self._fly(OperatorCommand.RESUME, until, timeout_s)

    def hold(self) -> None:
        """Brake all axes and hold the run's time; ``start``, which another thread waits in, then returns the run."""
        self._ordered_hold = True
        self._operator.submit(OperatorCommand.HOLD)

    def stop(self) -> None:
        """Stop the bench at once, remove the torque and end the session; from any thread."""
        self._operator.submit(OperatorCommand.STOP)
        self._end()

    @public
    def park(self, timeout_s: float = 300.0) -> None:
        """Move the bench to the park position of the rig; the session ends there."""
        self._execute_step(_Step("park", OperatorCommand.PARK, lambda *_: False, timeout_s))

    @public
    def reset(self, timeout_s: float = 60.0) -> None:
        """After a safe stop before the run whose cause is removed, open the devices again, in standby."""
        self._command(OperatorCommand.RESET, Mode.STANDBY, timeout_s)

    def _command(self, command: OperatorCommand, mode: Mode, timeout_s: float) -> None:
        def ended(runner: Runner, _: float) -> bool:
            return runner.safety.modes.mode is mode and self._operator.is_idle(runner)

        if not self._execute_step(_Step(command.value, command, ended, timeout_s)):
            raise self._ended_error(command.value)

    def _fly(self, command: OperatorCommand, until: Until, timeout_s: float) -> Run:
        if not (until in ("ready", "end") or jobs.is_positive(until)):
            raise BadInput.single(command.value, "until", f'{until!r:.60}: must be "ready", "end" or a time above 0 s')
        reached, outcome = False, cast("Outcome | None", None)
        self._ordered_hold = False

        def hold_when_reached(runner: Runner, _: float) -> None:
            nonlocal reached
            if not reached and self._operator.runs and self._is_reached(runner, until):
                reached = True
                self._operator.submit(OperatorCommand.HOLD)

        def ended(runner: Runner, now_s: float) -> bool:
            nonlocal outcome
            if not ((reached or self._ordered_hold) and runner.safety.modes.mode is Mode.HOLD):
                return False
            if runner.loop.bench.at_rest(now_s):
                outcome = runner.outcome(_ON_HOLD)  # in the loop's thread
            return outcome is not None

        if self._execute_step(_Step(command.value, command, ended, timeout_s, hold_when_reached)):
            assert outcome is not None
            self._latest = judged_run(self._job, self._request.rig_name, outcome)
            return self._latest
        self._thread.join(_END_WALL_S)
        if self.result is None:
            raise self._ended_error(command.value)
        return self.result

    def _is_reached(self, runner: Runner, until: Until) -> bool:
        now, scenario = runner.loop.now, self._job.scenario.value
        t_s = float(now.t_s[0])
        if until == "ready":
            since_s = float(now.supervision.ready_since_s)
            return not now.supervision.aborted and t_s - since_s >= scenario.requirements.dwell_s
        return until != "end" and t_s >= float(until) - 0.5 * scenario.step_s

    def _execute_step(self, step: _Step) -> bool:
        if not self._thread.is_alive():
            raise self._ended_error(step.name)
        completed = self._operator.execute(step)
        if not completed and self._failure is not None:
            raise self._failure
        return completed

    def _ended_error(self, what: str) -> BenchError:
        why = f": {self.result.stop}" if self.result is not None else ""
        return BenchError(f"bench: cannot {what}, the session has ended{why}")

    def _session(self) -> None:
        """Run the session, in its thread: the child processes of a rig live as long as the thread that starts them."""
        try:
            self.result = run_job(self._request)
        except BaseException as error:
            self._failure = error
        finally:
            self._operator.end_session()

    def _end(self) -> None:
        """Stop the bench and wait for the end of the session."""
        while self._thread.is_alive():
            self._operator.submit(OperatorCommand.STOP)
            self._operator.wake()
            self._thread.join(_POLL_WALL_S)
