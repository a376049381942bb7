"""The verdict that README and first tutorial show is the one that ``hil run scheme-1`` prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hil.cli.main import execute

ROOT = Path(__file__).resolve().parents[2]
PAGES = {"README.md": "The verdict of `make demo`", "docs/tutorials/first-flight.md": "The last lines are the verdict"}


def lines_of(text: str) -> list[str]:
    """Return the lines of ``text`` without what a table's head and a terminal's width change."""
    return [line.replace("┃", "│").rstrip() for line in text.splitlines()]


def test_verdict_in_the_pages_is_printed_by_the_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "scheme-1"]) == 0
    printed = lines_of(capsys.readouterr().out)
    for page, head in PAGES.items():
        block = re.search(rf"{head}:\n\n```\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
        assert block is not None
        shown = [line for line in lines_of(block[1]) if line.strip() != "..."]
        assert [line for line in printed if line in shown] == shown
