"""How commissioning talks with the technician, and what it tells of a step that failed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol


class OperatorPrompt(Protocol):
    """Somebody who looks at the bench and says what they see."""

    def tell(self, text: str) -> None:
        """Show a line."""

    def ask(self, question: str) -> bool:
        """Wait for yes or no. Called from a thread of its own: the axes are kept under command meanwhile."""


class Scripted:
    """Answers by ``answer``, with yes if there is none; keeps what was told and asked."""

    def __init__(
        self, answer: Callable[[str], bool] = lambda _: True, show: Callable[[str], None] | None = None
    ) -> None:
        self.told: list[str] = []
        self.asked: list[str] = []
        self._answer = answer
        self._show = show

    def tell(self, text: str) -> None:
        """Keep the line."""
        self.told.append(text)
        if self._show is not None:
            self._show(text)

    def ask(self, question: str) -> bool:
        """Answer at once."""
        self.asked.append(question)
        answer = self._answer(question)
        if self._show is not None:
            self._show(f"{question} {'yes' if answer else 'no'}")
        return answer


def ask_meanwhile(dialogue: OperatorPrompt, question: str, meanwhile: Callable[[], None]) -> bool:
    """Ask in a thread of its own and do ``meanwhile`` over and over until the answer is there.

    The caller's thread hears Ctrl-C all the time.
    """
    answers: list[bool] = []

    def wait() -> None:
        answers.append(dialogue.ask(question))

    thread = threading.Thread(target=wait, name="question", daemon=True)
    thread.start()
    while thread.is_alive():
        meanwhile()
    return answers == [True]


class StepFailed(Exception):
    """A step of commissioning that did not find what it must; nothing is signed.

    what: axis or device, and the step. expected, found: with units. advice: what to do about it.
    """

    def __init__(self, what: str, expected: str, found: str, advice: str) -> None:
        self.what = what
        self.expected = expected
        self.found = found
        self.advice = advice
        super().__init__(f"{what}: expected {expected}, found {found}; {advice}")
