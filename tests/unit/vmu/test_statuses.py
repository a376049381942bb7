"""The table of statuses has each that a frame of the vision unit can have."""

from __future__ import annotations

import re
from pathlib import Path

import hil.vmu
from docs.vmu_statuses import STATUSES
from hil.vmu import identify, unit

SOURCES = Path(hil.vmu.__file__).parent.rglob("*.py")


def test_each_status_of_the_unit_is_explained_and_no_other() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in SOURCES if path.name != "statuses.py")
    refused = set(re.findall(r'"(rejected_\w+)"', text))
    assert refused == {name for name in STATUSES if name.startswith("rejected_")}
    assert {identify.OK, identify.AMBIGUOUS, identify.TOO_FEW, unit.PREDICTED, unit.SUSPECT} <= set(STATUSES)
