"""Dialogue of commissioning with the technician or one who answers by himself, and the error of a failed step."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol


class OperatorPrompt(Protocol):
    """Technician at the bench, who reads lines and answers questions."""

    def show(self, text: str) -> None:
        """Show a line."""

    def ask(self, question: str) -> bool:
        """Wait for yes or no. Called from a separate thread: the axes stay under command meanwhile."""


class ScriptedPrompt:
    """Prompt that answers by ``answer`` (default: always yes), and stores the lines and questions."""

    def __init__(
        self, answer: Callable[[str], bool] = lambda _: True, show: Callable[[str], None] | None = None
    ) -> None:
        self.lines: list[str] = []
        self.questions: list[str] = []
        self._answer = answer
        self._show = show or (lambda _: None)

    def show(self, text: str) -> None:
        """Store the line."""
        self.lines.append(text)
        self._show(text)

    def ask(self, question: str) -> bool:
        """Answer at once."""
        self.questions.append(question)
        answer = self._answer(question)
        self._show(f"{question} {'yes' if answer else 'no'}")
        return answer


class KeptPrompt:
    """Prompt that passes everything to ``prompt`` and stores the lines that it showed."""

    def __init__(self, prompt: OperatorPrompt) -> None:
        self.lines: list[str] = []
        self._prompt = prompt

    def show(self, text: str) -> None:
        """Show and store the line."""
        self.lines.append(text)
        self._prompt.show(text)

    def ask(self, question: str) -> bool:
        """Ask, and store question and answer."""
        answer = self._prompt.ask(question)
        self.lines.append(f"{question} {'yes' if answer else 'no'}")
        return answer


def ask_meanwhile(prompt: OperatorPrompt, question: str, meanwhile: Callable[[], None]) -> bool:
    """Ask in a separate thread and repeat ``meanwhile`` until the answer arrives.

    The caller's thread still receives Ctrl-C.
    """
    answers: list[bool] = []
    thread = threading.Thread(target=lambda: answers.append(prompt.ask(question)), name="question", daemon=True)
    thread.start()
    while thread.is_alive():
        meanwhile()
    return answers == [True]


class StepFailed(Exception):
    """Failed step of commissioning; nothing is signed off.

    what: axis or device, and the step. expected, observed: with units. advice: the remedy.
    """

    def __init__(self, what: str, expected: str, observed: str, advice: str) -> None:
        self.what = what
        self.expected = expected
        self.observed = observed
        self.advice = advice
        super().__init__(f"{what}: expected {expected}, found {observed}; {advice}")
