"""Live viewers of a console: those that parts declare, and one line for others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hil.cli.main import execute
from hil.core import part
from hil.core.part import InstalledPart, Part, Parts
from hil.parts.console.strangers import Access
from hil.parts.console.viewers import ViewerOption, opened_viewers

closed: list[int] = []


def viewer(port: int, code: str | None, log: Any) -> Any:
    """Return a viewer that does nothing."""
    return SimpleNamespace(address=f"ws://{port}", notes=["a note"], close=lambda: closed.append(port))


@pytest.fixture(autouse=True)
def laser(monkeypatch: pytest.MonkeyPatch) -> None:
    declared = Part(name="laser", summary="", viewers={"laser": f"{__name__}:viewer"})
    monkeypatch.setattr(part, "parts", lambda: Parts({"laser": InstalledPart(declared, "1.0", "acme")}, []))


@pytest.mark.parametrize(
    ("access", "line"),
    [
        (Access("token", {}), "laser on ws://7"),
        (Access(None, {}), "laser on ws://7; code to take the command: "),
    ],
)
def test_viewer_is_opened_introduced_and_closed(access: Access, line: str) -> None:
    closed.clear()
    with opened_viewers([ViewerOption("--viewer", "laser", 7)], access, print) as (viewers, lines):
        assert len(viewers) == 1
        assert lines[0].startswith(line)
        assert lines[1] == "a note"
    assert closed == [7]


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (("--foxglove", "0"), "--foxglove: needs package hil-bench-foxglove, which is not installed: pip install hil-"),
        (("--viewer", "rerun=0"), "--viewer: needs package hil-bench-rerun, which is not installed"),
        (("--viewer", "laser"), "--viewer: laser: must look like foxglove=8766"),
    ],
)
def test_viewer_that_no_part_has_is_one_line(
    options: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["console", "--rig", "mock", "--no-record", "--port", "0", *options]) == 2
    (printed,) = capsys.readouterr().err.splitlines()
    assert printed.startswith(line)
