"""The table of hazards is whole: each row has tests that exist and run by default, and no alarm is without a row."""

from __future__ import annotations

import ast
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from docs import generate
from tests.support.raised_alarms import quantities

ROOT = Path(__file__).resolve().parents[2]
ROWS: list[dict[str, Any]] = tomllib.loads((ROOT / "docs" / "hazards.toml").read_text())["hazards"]


def slow_marks(decorators: list[ast.expr]) -> bool:
    return any("mark.slow" in ast.unparse(each) for each in decorators)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["id"])
def test_each_row_is_complete_and_its_tests_exist_and_run_by_default(row: dict[str, Any]) -> None:
    assert set(row) == set(generate.HAZARD_KEYS)
    assert all(row[key] for key in set(row) - {"alarms"})
    for name in row["tests"]:
        path, _, function = name.partition("::")
        tree = ast.parse((ROOT / path).read_text())
        found = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == function]
        assert found, f"{name}: no such test"
        assert not slow_marks(found[0].decorator_list), f"{name}: not part of the normal run"
        marks = [node.value for node in tree.body if isinstance(node, ast.Assign) and "pytestmark" in ast.unparse(node)]
        assert not slow_marks(marks), f"{name}: its file is not part of the normal run"


def test_no_alarm_is_without_a_row_and_no_row_has_an_alarm_that_is_never_raised() -> None:
    rows = Counter(alarm for row in ROWS for alarm in row["alarms"])
    raised = quantities()
    assert {alarm: raised[alarm] for alarm in raised.keys() - rows.keys()} == {}
    assert rows.keys() - raised.keys() == set()
    assert [alarm for alarm, count in rows.items() if count > 1] == []


def test_rows_are_numbered_and_the_page_has_all_of_them() -> None:
    assert [row["id"] for row in ROWS] == [f"H-{number:02d}" for number in range(1, len(ROWS) + 1)]
    page = generate.hazards()
    for row in ROWS:
        assert f"## {row['id']} " in page
        assert all(name.rpartition("::")[2] in page for name in row["tests"])
