"""One session at the bench, in a process of its own (``hil.parts.console.console_session``).

It exchanges messages with the console over a socket pair (``hil.parts.console.remote_operator``). It sends, in this
order, ``{"word": ...}`` for each step of the start, ``{"hello": ...}`` with the descriptors of the shared memory once
the bench is ready, the messages of ``RemoteOperator``, and at last ``{"ended": ...}``, or ``{"refused": [...]}`` if
it cannot start.

A commissioning adds questions of its steps: {"question": {"number": 3, "text": "Has the carriage moved ..."}} to the
console, null once it is answered, and {"reply": true, "question": 3, "by": "ann", "id": 7} to the loop.
"""

from __future__ import annotations

import json
import os
import queue
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from hil.checks.compatibility import check_plan
from hil.config.load import load_rig, load_scenario
from hil.config.tables.model import ConfigModel
from hil.core.operator_commands import OperatorCommand, StopCommanded
from hil.errors import BadInput, BenchError
from hil.frmn.mailbox import MailboxBlock
from hil.loop.outcome import Outcome
from hil.loop.runner import Runner
from hil.loop.session_parts import PartResult
from hil.parts.console.bench import ConsoleBench, opened
from hil.parts.console.remote_operator import OutgoingMessages, RemoteOperator
from hil.parts.console.status import CELLS
from hil.parts.wires.wired import WiredBench
from hil.recording.audit import Actor
from hil.recording.session import RunRecorder, recording
from hil.report.results import RunResults
from hil.report.summary import summarise
from hil.report.tally import Tallied
from hil.session import build
from hil.session.warm_up import compile_kernels


class CommissioningOperator(RemoteOperator):
    """Prompt of a commissioning (``hil.parts.commissioning.prompt``) at the page of the operator who opened it.

    STOP ends the commissioning in every mode. HOLD stops it while an axis moves; no other command is executed. While a
    question waits the axes stand at their setpoints, and the page may be silent: the screen of a phone goes dark.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._asked = (0, "")
        self._announced = 0
        self._answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._waiting = False

    def show(self, text: str) -> None:
        """Send a line; called in the loop's thread."""
        self._messages.send(word=text.removeprefix("-- "))

    def ask(self, question: str) -> bool:
        """Wait for the answer; called from a separate thread while the loop polls."""
        self._waiting, self._asked = True, (self._asked[0] + 1, question)
        return self._answers.get()

    def poll(self, now_s: float) -> None:
        """As in ``RemoteOperator``; announces a new question. Raises StopCommanded for STOP, SafetyTrip."""
        number, text = self._asked
        if number != self._announced:
            self._announced = number
            self._messages.send(question={"number": number, "text": text})
        super().poll(now_s)
        if OperatorCommand.STOP in self.pending:
            raise StopCommanded

    def jog(self, axis: str, direction: int) -> None:
        """No axis is jogged during a commissioning."""

    def _handle(self, message: dict[str, Any]) -> None:
        if "reply" not in message:
            super()._handle(message)
            return
        is_open = self._waiting and message["question"] == self._announced
        if is_open:
            self._waiting = False
            self._messages.send(question=None)
            self._answers.put(message["reply"] is True)
        self._messages.send(answer=message["id"], text="" if is_open else "this question is answered already")

    def _order(self, message: dict[str, Any], operator: Actor) -> dict[str, Any]:
        command = OperatorCommand(message["order"])
        if command not in (OperatorCommand.STOP, OperatorCommand.HOLD):
            return {"text": f"bench: cannot {command.value} during a commissioning: answer its questions, or STOP"}
        self.submit(command)
        return {"text": ""}

    def _check_presence(self, wall_s: float) -> None:
        if not self._waiting or self._disconnected:
            super()._check_presence(wall_s)


_FLUSH_WALL_S: Final = 2.0


class SignedBy(ConfigModel):
    """Who signs a rig off: name, and the id of the operator's key, "" for a self-given name."""

    name: str
    key: str = ""


class Choice(ConfigModel):
    """Scenario, rig and options chosen by the operator."""

    scenario: str
    rig: str
    seed: int = 0
    duration_s: float | None = None
    speed: float = 1.0
    settings: tuple[str, ...] = ()
    record: str | None = None
    """Folder of the recordings; None: no recording."""
    operators: str | None = None
    """File of the operators' keys; None without keys."""
    signed_by: SignedBy | None = None
    """Technician of a commissioning, who opens the session for it; None: the session flies the scenario."""

    def job(self) -> build.Job:
        """Return the job; a mock rig runs in real time, so that it can be watched. Raises BadInput."""
        scenario = load_scenario(self.scenario, self.settings)
        rig = load_rig(self.rig, self.settings)
        duration_s = scenario.value.duration_s if self.duration_s is None else self.duration_s
        return build.Job(scenario, rig, self.seed, duration_s, self.speed, paced=rig.value.kind == "mock")


Commission = Callable[[Choice, build.Job, WiredBench, Runner, CommissioningOperator], dict[str, Any]]
"""Commissions a rig, and returns the result for the console."""


def run_session(choice: Choice, channel: socket.socket, commission: Commission) -> None:
    """Open the bench, execute the operator's commands, and send the result.

    commission: called instead of a flight if the choice asks for it.
    """
    messages = OutgoingMessages(channel)
    status = MailboxBlock.create(CELLS, "console")
    try:
        job = choice.job()
        _check_and_compile(job, messages, choice.signed_by is not None)
        rig = job.rig.value
        console = rig.console
        kind = RemoteOperator if choice.signed_by is None else CommissioningOperator
        operator = kind(
            messages, status["status"], console.on_loss, console.lease_s, second_person=console.second_person
        )

        def announce(text: str) -> None:
            messages.send(word=text)

        with _recorded(choice, job, announce) as taken:
            with opened(job, operator, announce, taken.sinks if taken else None) as bench:
                adjustable = job.scenario.value.console.adjustable
                search = bench.runner.parts.controls.get("search")
                operator.attach(bench.runner, bench.event_recorder, adjustable, search)
                _send_hello(channel, bench, status, taken)
                if isinstance(operator, CommissioningOperator):
                    assert bench.wired is not None
                    messages.send(ended=commission(choice, job, bench.wired, bench.runner, operator))
                    return
                outcome = bench.runner.run()
                operator.publish(bench.runner.now_s())
                messages.send(word="the loop has ended: evaluating the run and closing its files", closing=True)
                results = bench.runner.parts.results_of(outcome)
            messages.send(ended=_result(choice, job, outcome, results, taken, bench.numbers(outcome)))
    except BadInput as error:
        messages.send(refused=[str(problem) for problem in error.problems])
    except BenchError as error:
        messages.send(refused=[str(error)])
    except KeyboardInterrupt:
        messages.send(refused=["stopped by the operator while the bench was being opened"])
    finally:
        channel.settimeout(_FLUSH_WALL_S)  # after the loop, blocking is allowed
        messages.flush()
        status.close()


def _check_and_compile(job: build.Job, messages: OutgoingMessages, is_commissioning: bool) -> None:
    """Check that rig and scenario are compatible, and compile the kernels before any motion."""
    messages.send(word="checking that the rig can realise the scenario")
    if is_commissioning:
        build.check_rig(job)
        if problems := check_plan(job.scenario, job.rig):
            raise BadInput(problems)
    else:
        build.check(job)
    compile_kernels(job, lambda text: messages.send(word=text))


@contextmanager
def _recorded(choice: Choice, job: build.Job, announce: Callable[[str], None]) -> Iterator[RunRecorder | None]:
    """Yield the recording of ``job``, None without one."""
    if choice.record is None or choice.signed_by is not None:
        yield None
        return
    with recording(job, choice.rig, Path(choice.record), announce) as taken:
        yield taken


def _send_hello(channel: socket.socket, bench: ConsoleBench, status: MailboxBlock, taken: RunRecorder | None) -> None:
    """Report the bench as ready to the console, with the descriptors of the shared memory in the order of names."""
    rings = {"telemetry": bench.telemetry, **bench.rings}
    shared = {
        "status": status.descriptor,
        "run_time": bench.run_time.descriptor,
        **{name: ring.descriptor for name, ring in rings.items()},
    }
    if taken is not None and taken.state is not None:
        shared["recording"] = taken.state.descriptor
    hello = {
        "pid": os.getpid(),
        "addresses": bench.addresses,
        "clock": [bench.clock.epoch_ns, bench.clock.speed],
        "slots": {name: ring.slots for name, ring in rings.items()},
        "file": str(taken.path) if taken else None,
        "shared": list(shared),
    }
    socket.send_fds(channel, [json.dumps({"hello": hello}).encode()], list(shared.values()))


def _result(
    choice: Choice,
    job: build.Job,
    outcome: Outcome,
    results: Sequence[PartResult],
    taken: RunRecorder | None,
    numbers: Tallied | None,
) -> dict[str, Any]:
    """Return the result for the console, and close the recording. results: of parts. numbers: of a long run."""
    rate_hz = 1.0 / job.scenario.value.step_s
    ended: dict[str, Any] = {"stop": outcome.stop, "faults": outcome.faults, "mode": outcome.mode.value}
    ended |= {"accepted": None, "passed": None}
    summary: dict[str, Any] = {}
    if len(outcome.history):
        summary, _ = summarise(outcome, job.scenario.value, job.rig.value, choice.rig, job.seed, rate_hz, numbers)
        summary |= {result.table: result.numbers for result in results}
        ended |= {
            "accepted": summary["accepted"],
            "passed": summary["passed"],
            "ready_time_s": summary["ready_time_s"],
            "parts": {name: part.passed for name, part in RunResults.of(summary).parts().items()},
            "required_parts": summary["required_parts"],
            "cycles": summary["timing"]["cycles"],
            "timing": summary["timing"],
        }
    if taken is not None:
        stats = taken.finish(summary) if summary else taken.break_off(outcome.stop)
        ended["recording"] = {"file": str(taken.path), "dropped": stats.dropped, "problem": stats.problem}
        ended["recording"]["audit"] = taken.sinks.audit.summary._asdict()
    return ended
