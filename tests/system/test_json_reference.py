"""The reference pages describe the keys of ``hil run --json``: none is missing, none is only described."""

import json
import re
from pathlib import Path

from docs import generate
from hil.cli.main import execute

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "json.md"
ONLY_SOMETIMES = {"monitor", "recording"}
"""Tables of runs with a docking monitor, of recorded runs."""

OF_PARTS = {"bench_truth"}
"""Sections that a part adds, of a rig with a tracker."""


def described(page: str) -> set[str]:
    """Return the keys in the first column of tables, a name with a leading dot after the group of the one before."""
    names: list[str] = []
    for row in re.findall(r"^\| (\W*`[^|]+) \|", page, re.MULTILINE):
        for name in re.findall(r"`([\w.]+)`", row):
            names.append(names[-1].rsplit(".", 1)[0] + name if name.startswith(".") else name)
    return set(names)


def test_pages_describe_the_keys_of_a_run(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    assert execute(["run", "scheme-1", "--duration", "200", "--json", str(path)]) == 0
    names = described(generate.PAGES["run-results"]())
    assert {name for name in names if "." not in name} - ONLY_SOMETIMES == set(json.loads(path.read_text()))
    by_hand = described(PAGE.read_text().split("## hil dss")[0])
    assert {name.split(".")[0] for name in by_hand} - OF_PARTS <= names
