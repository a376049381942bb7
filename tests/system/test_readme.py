"""The verdict that the README shows is the one that ``hil run scheme-1`` prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hil.cli.main import execute

README = Path(__file__).resolve().parents[2] / "README.md"


def lines_of(text: str) -> list[str]:
    """Return the lines of ``text`` without what a table's head and a terminal's width change."""
    return [line.replace("┃", "│").rstrip() for line in text.splitlines()]


def test_verdict_in_the_readme_is_printed_by_the_run(capsys: pytest.CaptureFixture[str]) -> None:
    block = re.search(r"The verdict of `make demo`:\n\n```\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert block is not None
    shown = [line for line in lines_of(block[1]) if line.strip() != "..."]
    assert execute(["run", "scheme-1"]) == 0
    printed = lines_of(capsys.readouterr().out)
    assert [line for line in printed if line in shown] == shown
