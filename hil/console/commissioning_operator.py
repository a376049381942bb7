"""Technician at the console's page during a commissioning: lines and questions of its steps, answers, STOP.

In addition to the messages of ``hil.console.remote_operator``:

to the loop    {"reply": true, "question": 3, "by": "ann", "id": 7}
to the console {"question": {"number": 3, "text": "Has the carriage moved ..."}}, null once it is answered
"""

from __future__ import annotations

import queue
from typing import Any

from hil.console.remote_operator import RemoteOperator
from hil.core.operator_commands import OperatorCommand, StopCommanded
from hil.recording.audit import Actor


class CommissioningOperator(RemoteOperator):
    """Prompt of a commissioning (``hil.commission.prompt``) at the page of the operator who opened it.

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
        """As of ``RemoteOperator``; announces a new question. Raises StopCommanded for STOP, SafetyTrip."""
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
