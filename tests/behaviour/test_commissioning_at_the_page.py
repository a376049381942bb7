"""Commissioning with the technician at the console's page, on a mock bench in simulated time."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from hil.core.modes import Mode
from hil.core.operator_commands import StopCommanded
from hil.drivers.io.mock import MockIo
from hil.errors import SafetyTrip
from hil.frmn.mailbox import MailboxBlock
from hil.loop.safety_io_stage import SafetyIoStage
from hil.parts.commissioning.sign_off import free_file
from hil.parts.commissioning.steps import Commissioning, CommissioningPlan, Findings
from hil.parts.console.remote_operator import OutgoingMessages
from hil.parts.console.session import CommissioningOperator
from hil.parts.console.status import CELLS
from hil.session import build
from tests.behaviour.test_commissioning import STEP_S, Button, X
from tests.support.run_settings import make_job

LEASE_S = 1.0
DARK_S = 5.0
"""Time for which the screen of a phone is dark."""


@dataclass
class Technician:
    """The page's end of the line. received: messages; mode and now_s: of the bench."""

    end: socket.socket
    received: list[dict[str, Any]] = field(default_factory=list)
    mode: Mode = Mode.OFF
    now_s: float = 0.0
    asked_s: float = 0.0
    beats: bool = True

    @property
    def question(self) -> dict[str, Any] | None:
        """Question that waits for an answer."""
        asked = [message["question"] for message in self.received if "question" in message]
        return asked[-1] if asked else None

    def send(self, **message: Any) -> None:
        self.end.send(json.dumps(message).encode())

    def listen(self) -> None:
        with suppress(BlockingIOError):
            while True:
                self.received.append(json.loads(self.end.recv(1 << 18)))
                if self.received[-1].get("question"):
                    self.asked_s = self.now_s

    def answer(self, yes: bool = True) -> None:
        if self.question:
            self.send(reply=yes, question=self.question["number"], by="ann", id=self.question["number"])

    @property
    def moves(self) -> bool:
        """Whether the first axis moves: after the emergency stop, before the question about it."""
        return self.mode is Mode.PLACING and not self.question


def commission_by(script: Callable[[Technician], None]) -> tuple[Findings, Technician]:
    """Commission rails.x; ``script`` is called in each cycle."""
    job = make_job(STEP_S, ())
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    here.setblocking(False)
    block = MailboxBlock.create(CELLS, "console")
    technician = Technician(here)
    operator = CommissioningOperator(
        OutgoingMessages(there), block["status"], "hold", LEASE_S, lambda: technician.now_s
    )
    polled = operator.poll

    def poll(now_s: float) -> None:
        technician.now_s = now_s
        technician.mode = runner.safety.modes.mode
        technician.listen()
        if technician.beats:
            technician.send(present=True)
        script(technician)
        polled(now_s)

    operator.poll = poll  # type: ignore[method-assign]
    try:
        with build.runner(job, operator=operator) as runner:
            operator.attach(runner)
            lines = runner.loop.safety_io
            assert isinstance(lines, SafetyIoStage)
            assert isinstance(lines.io, MockIo)
            steps = Commissioning(runner, job.rig.value, operator, CommissioningPlan((X,)), Button(lines.io))
            findings = steps.run()
            technician.listen()  # reply to the last answer
            return findings, technician
    finally:
        here.close()
        there.close()
        block.close()


def test_steps_and_questions_come_to_the_page_and_each_answer_counts_once() -> None:
    def script(technician: Technician) -> None:
        technician.answer()
        technician.answer()

    findings, technician = commission_by(script)
    assert [axis.name for axis in findings.axes] == ["rails.x"]
    assert "rails.x: sign and scale" in [message.get("word") for message in technician.received]
    answers = [message["text"] for message in technician.received if "answer" in message]
    assert answers.count("") == 4  # one of them after the first small move
    assert set(answers) == {"", "this question is answered already"}


def test_dark_screen_ends_nothing_while_a_question_waits() -> None:
    def script(technician: Technician) -> None:
        waited_s = technician.now_s - technician.asked_s
        technician.beats = not technician.question or waited_s > DARK_S
        if technician.beats:
            technician.answer()

    findings, technician = commission_by(script)
    assert technician.now_s > 3 * DARK_S
    assert findings.axes


def test_lost_page_stops_a_move() -> None:
    def script(technician: Technician) -> None:
        technician.beats = not technician.moves
        technician.answer()

    with pytest.raises(SafetyTrip, match=r"bench: hold .*operator's page silent for .* not during a commissioning"):
        commission_by(script)


def test_hold_stops_a_move() -> None:
    def script(technician: Technician) -> None:
        technician.answer()
        if technician.moves:
            technician.send(order="hold", id=99)

    with pytest.raises(SafetyTrip, match=r"commanded by the operator"):
        commission_by(script)


@pytest.mark.parametrize("when", ["before the drives are enabled", "while an axis moves"])
def test_stop_ends_it_in_any_mode(when: str) -> None:
    def script(technician: Technician) -> None:
        if when == "while an axis moves":
            technician.answer()
        if technician.moves if when == "while an axis moves" else technician.question:
            technician.send(order="stop", id=99)

    with pytest.raises(StopCommanded):
        commission_by(script)


def test_no_other_command_is_executed() -> None:
    def script(technician: Technician) -> None:
        if technician.question:
            technician.send(order="arm", confirmed=True, id=98)
            technician.send(jog=["rails.y", 1])
        technician.answer()

    _, technician = commission_by(script)
    assert "bench: cannot arm during a commissioning: answer its questions, or STOP" in [
        message.get("text") for message in technician.received
    ]


def test_sign_off_never_replaces_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert free_file("emulated") == (tmp_path / "emulated-signed.toml", "emulated")
    (tmp_path / "lab-signed.toml").touch()
    assert free_file(str(tmp_path / "lab.toml")) == (tmp_path / "lab-signed-2.toml", "lab.toml")
