"""The reference page describes the keys of ``hil run --json``: none is missing, none is only described."""

import json
import re
from pathlib import Path
from typing import Any

from hil.cli.main import execute

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "json.md"
BACKENDS = {f"gnc.{part}.{key}" for part in ("navigation", "control") for key in ("backend", "sha256")}
ONLY_SOMETIMES = {"monitor", "recording", "gnc.python", "manipulator", "held_axes", *BACKENDS}
"""Keys and groups of runs with a docking monitor, of recorded runs, of a GNC in Python, with a manipulator or further
axes, with backends of one's own."""


def described() -> set[str]:
    """Return the keys in the first column of the table, a name with a leading dot after the group of the one before."""
    found: list[str] = []
    for row in re.findall(r"^\| (`[^|]+) \|", PAGE.read_text().split("## hil dss")[0], re.MULTILINE):
        for name in re.findall(r"`([\w.]+)`", row):
            found.append(found[-1].rsplit(".", 1)[0] + name if name.startswith(".") else name)
    return set(found)


def keys(summary: dict[str, Any], groups: set[str]) -> set[str]:
    """Return the keys of a summary; those in ``groups`` with their inner keys, without a group that is null."""
    found = set()
    for key, value in summary.items():
        if key not in groups:
            found.add(key)
        elif value is not None:
            found |= {f"{key}.{inner}" for inner in value}
    return found


def test_page_describes_the_keys_of_a_run(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    assert execute(["run", "scheme-1", "--duration", "200", "--json", str(path)]) == 0
    names = described()
    groups = {name.split(".")[0] for name in names if "." in name}
    always = {name for name in names if not {name, name.split(".")[0]} & ONLY_SOMETIMES}
    assert keys(json.loads(path.read_text()), groups) == always
