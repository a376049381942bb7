"""Bugs planted in plug-ins: each ends a run in lock-step with its device, file and line, or its signal."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.planted_bugs import BUGS, run

QUICK = ("driver.read none", "emulator.run segfault", "gnc.step hang")
"""A wrong return, a dead process, a hang; the others are ``slow``."""
STOPPED, BROKEN, CRASHED = 3, 1, -11
ENDS = {"procedure.body raise": BROKEN, "procedure.body thread": BROKEN, "gnc.step segfault": CRASHED}
"""Exit codes other than that of a safe stop: of a program of the user's own, and of its crash."""


@pytest.mark.parametrize("bug", [pytest.param(bug, marks=() if bug in QUICK else pytest.mark.slow) for bug in BUGS])
def test_a_bug_is_named_and_the_bench_stopped(tmp_path: Path, bug: str) -> None:
    told = run(tmp_path, bug)
    assert told.names, told.log
    assert told.code == ENDS.get(bug, STOPPED), told.log
