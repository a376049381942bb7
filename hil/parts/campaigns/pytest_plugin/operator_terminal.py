"""Operator at a hardware rig, who confirms at a terminal that the bench may move."""

from __future__ import annotations

import os
import select
import time
from typing import Final

from hil.core.operator_commands import FreshDigits, confirmed
from hil.errors import BadInput, BenchError

_ANSWER_WALL_S: Final = 600.0
_LONGEST: Final = 256


class OperatorTerminal:
    """The terminal at ``path``, which need not be that of pytest: of a pipeline's job it is one at the bench.

    wait_s: time for an answer. Raises BadInput if the terminal cannot be opened.
    """

    def __init__(self, path: str, rig: str, wait_s: float = _ANSWER_WALL_S) -> None:
        self._path, self._wait_s = path, wait_s
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
            is_terminal = os.isatty(self._descriptor)
            reason = "is no terminal"
        except OSError as error:
            is_terminal, reason = False, f"cannot be opened: {error.strerror}"
        if not is_terminal:
            text = f"{path}: {reason}; {rig} is hardware, whose operator must confirm at a terminal"
            raise BadInput.single("--operator-terminal", "", text)

    def show(self, text: str) -> None:
        """Write a line."""
        os.write(self._descriptor, f"{text}\r\n".encode())

    def ask(self, question: str) -> bool:
        """Ask until the answer is yes or no, see ``confirmed``; a closed terminal answers no.

        Raises BenchError without an answer.
        """
        return confirmed(question, self.line, self.show, FreshDigits())

    def line(self, prompt: str) -> str | None:
        """Return the next line that is typed, None at the end of input. Raises BenchError without one in time.

        What was typed before the question is no answer to it.
        """
        while select.select([self._descriptor], [], [], 0.0)[0] and os.read(self._descriptor, _LONGEST):
            pass
        os.write(self._descriptor, prompt.encode())
        text, end_s = b"", time.monotonic() + self._wait_s
        while b"\n" not in text and b"\r" not in text:
            left_s = max(0.0, end_s - time.monotonic())
            if not select.select([self._descriptor], [], [], left_s)[0]:
                raise BenchError(f"operator: no answer at {self._path} within {self._wait_s:g} s")
            typed = os.read(self._descriptor, _LONGEST)
            if not typed:
                return None
            text += typed
        return text.decode(errors="replace").strip()
