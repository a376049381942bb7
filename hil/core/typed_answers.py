"""Answers at a terminal: a line acts only if it repeats two digits that were shown at most a few seconds before.

The network of a remote terminal, a suspended program or a stuck key may hold a line or repeat it: what moves the bench
must have been typed by an operator who has just read the question.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from typing import Final

ANSWER_S: Final = 5.0
"""Wall-clock time after the digits were shown within which they count."""
_ATTEMPTS_MAX: Final = 20
_YES: Final = ("y", "yes")
_NO: Final = ("n", "no")


class FreshDigits:
    """Two digits that are drawn for each question, and count once and for ``ANSWER_S``; none come twice in 90.

    now_s: wall-clock time, s; draw: returns a random number below its argument.
    """

    def __init__(
        self, now_s: Callable[[], float] = time.monotonic, draw: Callable[[int], int] = secrets.randbelow
    ) -> None:
        self._now_s, self._draw = now_s, draw
        self._unused: list[str] = []
        self._digits, self._shown_s = "", 0.0

    def drawn(self) -> str:
        """Return new digits, to be shown now; those before no longer count."""
        if not self._unused:
            self._unused = [str(number) for number in range(10, 100)]
        self._digits, self._shown_s = self._unused.pop(self._draw(len(self._unused))), self._now_s()
        return self._digits

    def refusal(self, typed: str) -> str:
        """Return why ``typed`` does not count, "" if it does."""
        age_s = self._now_s() - self._shown_s
        if typed != self._digits:
            return "does not have the digits that are shown"
        if age_s > ANSWER_S:
            return f"came {age_s:.0f} s after the digits were shown, allowed {ANSWER_S:g} s"
        self._digits = ""
        return ""


def confirmed(
    question: str, ask: Callable[[str], str | None], show: Callable[[str], None], digits: FreshDigits
) -> bool:
    """Return whether ``question`` was answered with yes and the digits shown with it; no needs none.

    ask: shows a prompt and returns the line typed, None at the end of input, which is no; so is the twentieth answer
    that does not count. show: shows a line.
    """
    for _ in range(_ATTEMPTS_MAX):
        answer = ask(f"{question} [y {digits.drawn()} / n] ")
        if answer is None or answer.strip().lower() in _NO:
            return False
        word, _, typed = answer.strip().lower().partition(" ")
        if word not in _YES:
            continue
        if not (refusal := digits.refusal(typed.strip())):
            return True
        show(f"not taken: the answer {refusal}")
    return False
