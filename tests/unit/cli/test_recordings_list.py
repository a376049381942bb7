"""The list of recorded runs as people read it."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.cli.recordings import _print

ENTRY = {
    "started_utc": "2026-11-01T14:30:00Z",
    "scenario": "scheme-1",
    "rig": "mock",
    "seed": 1,
    "accepted": True,
    "passed": True,
    "ready_time_s": 161.0,
    "propellant_kg": 0.116,
    "position_rmse_mm": None,
    "file": "a.mcap",
}


@pytest.mark.parametrize(("number", "words"), [(0, "0 runs in "), (1, "1 run in "), (2, "2 runs in ")])
def test_list_begins_with_how_many_there_are(number: int, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    _print([ENTRY] * number, Path("recordings/runs.sqlite"))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{words}recordings/runs.sqlite"
    assert len(lines) == (1 if number == 0 else number + 2)
