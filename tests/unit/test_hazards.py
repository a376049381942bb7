"""The table of hazards is whole: each row has tests that exist and run by default, and each alarm names one."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from docs import generate
from hil.core import alarm_table
from hil.core.alarm_table import ALARMS
from hil.core.alarms import AlarmKind

ROOT = Path(__file__).resolve().parents[2]
ROWS: list[dict[str, Any]] = tomllib.loads((ROOT / "docs" / "hazards.toml").read_text())["hazards"]


def slow_marks(decorators: list[ast.expr]) -> bool:
    return any("mark.slow" in ast.unparse(each) for each in decorators)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["id"])
def test_each_row_is_complete_and_its_tests_exist_and_run_by_default(row: dict[str, Any]) -> None:
    assert set(row) == set(generate.HAZARD_KEYS)
    assert all(row.values())
    for name in row["tests"]:
        path, _, function = name.partition("::")
        tree = ast.parse((ROOT / path).read_text())
        found = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == function]
        assert found, f"{name}: no such test"
        assert not slow_marks(found[0].decorator_list), f"{name}: not part of the normal run"
        marks = [node.value for node in tree.body if isinstance(node, ast.Assign) and "pytestmark" in ast.unparse(node)]
        assert not slow_marks(marks), f"{name}: its file is not part of the normal run"


def test_each_alarm_names_a_hazard_and_is_raised() -> None:
    assert {kind.hazard for kind in ALARMS.values()} <= {row["id"] for row in ROWS}
    names = {name for name, each in vars(alarm_table).items() if isinstance(each, AlarmKind)}
    codes = [getattr(alarm_table, name).code for name in names]
    assert [code for code in codes if codes.count(code) > 1] == [], (
        "alarms of the same quantity need a code of their own"
    )
    texts = {str(path.relative_to(ROOT / "hil")): path.read_text() for path in (ROOT / "hil").rglob("*.py")}
    of_errors = re.findall(r"\b[A-Z_]+\b", texts["core/alarm_table.py"].partition("_OF_ERRORS")[2])
    raised = {name for text in texts.values() for name in re.findall(r"\btable\.([A-Z_]+)\b", text)}
    assert names - raised - set(of_errors) == set()


def test_alarms_are_made_by_their_kinds_alone() -> None:
    makers = {
        str(path.relative_to(ROOT / "hil"))
        for path in (ROOT / "hil").rglob("*.py")
        if re.search(r"\b(?:Alarm|SafetyTrip)\((?!BenchError|alarm: )", path.read_text())
    }
    assert makers == {"core/alarms.py", "api/recordings.py"}  # the last reads recordings


def test_rows_are_numbered_and_the_page_has_all_of_them() -> None:
    assert [row["id"] for row in ROWS] == [f"H-{number:02d}" for number in range(1, len(ROWS) + 1)]
    page = generate.hazards()
    for row in ROWS:
        assert f"## {row['id']} " in page
        assert all(name.rpartition("::")[2] in page for name in row["tests"])
