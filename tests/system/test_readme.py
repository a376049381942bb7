"""The verdicts that README and first tutorial show are those that their commands print."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hil.cli.main import execute

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = {"README.md": ["run", "scheme-1"], "docs/tutorials/first-flight.md": ["run", "scheme-1", "--seed", "7"]}
"""Page -> command whose verdict it shows."""


def lines_of(text: str) -> list[str]:
    """Return the lines of ``text`` without what a table's head and a terminal's width change."""
    return [line.replace("┃", "│").rstrip() for line in text.splitlines()]


@pytest.mark.parametrize("page", SAMPLES)
def test_verdict_of_a_page_is_printed_by_its_command(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    block = re.search(r"```\n(Ready phase: largest.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
    assert block is not None
    shown = [line for line in lines_of(block[1]) if line.strip() != "..."]
    assert execute(SAMPLES[page]) == 0
    printed = lines_of(capsys.readouterr().out)
    assert [line for line in printed if line in shown] == shown
