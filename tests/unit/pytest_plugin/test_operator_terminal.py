"""The operator's confirmations at a terminal."""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.errors import BadInput, BenchError
from hil.parts.campaigns.pytest_plugin.operator_terminal import OperatorTerminal


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """Return the operator's side of a terminal, and the path of the other one."""
    ours, theirs = os.openpty()
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def answer(descriptor: int, *lines: str) -> None:
    """Type each of ``lines`` when a question has been shown, with its digits in place of ``#``."""

    def typed() -> None:
        for line in lines:
            shown = ""
            while not (digits := re.search(r"\[y (\d\d) / n\] $", shown)):
                shown += os.read(descriptor, 1000).decode()
            os.write(descriptor, f"{line.replace('#', digits[1])}\n".encode())
            time.sleep(0.05)

    threading.Thread(target=typed, daemon=True).start()


def test_yes_and_no_and_other_words_that_are_no_answer(pty: tuple[int, str]) -> None:
    terminal = OperatorTerminal(pty[1], "lab.toml", wait_s=10.0)
    answer(pty[0], "maybe", "Y #")
    assert terminal.ask("Clear?")
    answer(pty[0], "no")
    assert not terminal.ask("Clear?")


def test_what_was_typed_before_the_question_is_no_answer(pty: tuple[int, str]) -> None:
    terminal = OperatorTerminal(pty[1], "lab.toml", wait_s=0.3)
    os.write(pty[0], b"y\n")
    time.sleep(0.1)
    with pytest.raises(BenchError, match=r"operator: no answer at /dev/pts/\d+ within 0.3 s"):
        terminal.ask("Clear?")


def test_hardware_needs_a_terminal(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path, reason in ((tmp_path / "none", "cannot be opened"), (tmp_path / "file", "is no terminal")):
        with pytest.raises(BadInput, match=rf"--operator-terminal: .*{reason}.*; lab.toml is hardware"):
            OperatorTerminal(str(path), "lab.toml")
