"""The recipes of CONTRIBUTING, each executed on a copy of the tree: its lines are added, its commands pass."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Recipes\n")[2].partition("\n## ")[0]
RECIPES = dict(re.findall(r"^### ([^\n]+)\n(.*?)(?=^### |\Z)", TEXT, re.DOTALL | re.MULTILINE))
IN_EACH_TEST = ("A plot",)
"""Recipes whose commands are part of the normal run; those of the others are slow."""
COPIED = ("hil", "tests", "docs", "configs", "examples", "benchmarks", "sims", "plugins")
STEP = re.compile(
    r"[Ii]n\s+`(?P<file>[^`]+)`, (?P<where>below|above)\s+`(?P<text>[^\n]+?)`:\n\n```\w*\n(?P<lines>.*?)```"
    r"|[Ii]n\s+`(?P<changed>[^`]+)`, `(?P<old>[^\n]+?)` becomes `(?P<new>[^\n]+?)`(?=[,:.\s])"
    r"|New file `(?P<added>[^`]+)`:\n\n```\w*\n(?P<content>.*?)```",
    re.DOTALL,
)
SHELL = """
set -e
hil() { "$PYTHON" -m hil "$@"; }
python() { "$PYTHON" "$@"; }
pytest() { "$PYTHON" -m pytest -q -n 0 -p no:cacheprovider "$@"; }
pip() {
  test "$1" = uninstall ||
    "$PYTHON" -m pip install --quiet --no-deps --no-build-isolation --no-index --target "$SITE" "${@: -1}"
}
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a copy of the tree."""
    copy = tmp_path / "hil-bench"
    ignored = shutil.ignore_patterns("__pycache__", "node_modules", "kernels.zip", "pictures")
    for name in COPIED:
        shutil.copytree(ROOT / name, copy / name, ignore=ignored, symlinks=True)
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, copy / path.name)
    return copy


def apply(step: re.Match[str], tree: Path) -> None:
    """Make the change of one step."""
    if step["added"]:
        (tree / step["added"]).write_text(step["content"], encoding="utf-8")
        return
    path = tree / (step["file"] or step["changed"])
    text = path.read_text(encoding="utf-8")
    if step["changed"]:
        stands = text.count(step["old"])
        assert stands == 1, (
            f"CONTRIBUTING.md: {step['old']!r} is {stands} times in {path.relative_to(tree)}: mend the recipe"
        )
        path.write_text(text.replace(step["old"], step["new"]), encoding="utf-8")
        return
    lines = text.splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if step["text"] in line) + (step["where"] == "below")
    path.write_text("".join([*lines[:at], step["lines"], *lines[at:]]), encoding="utf-8")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in IN_EACH_TEST else (pytest.mark.slow,)) for name in RECIPES]
)
def test_recipe_is_complete(name: str, tree: Path, tmp_path: Path) -> None:
    for step in STEP.finditer(RECIPES[name]):
        apply(step, tree)
    (commands,) = re.findall(r"^```sh\n(.*?)^```", RECIPES[name], re.DOTALL | re.MULTILINE)
    site = tmp_path / "site"
    environment = {**os.environ, "PYTHON": sys.executable, "SITE": str(site)}
    environment["PYTHONPATH"] = os.pathsep.join((str(tree), str(site)))
    command = ["bash", "-c", SHELL + commands]
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


@pytest.mark.parametrize("name", RECIPES)
def test_steps_of_a_recipe_apply_to_the_present_files(name: str, tmp_path: Path) -> None:
    for step in STEP.finditer(RECIPES[name]):
        path = tmp_path / (step["file"] or step["changed"] or step["added"])
        path.parent.mkdir(parents=True, exist_ok=True)
        if not (step["added"] or path.exists()):
            shutil.copy(ROOT / path.relative_to(tmp_path), path)
        apply(step, tmp_path)
    for path in tmp_path.rglob("*.py"):
        ast.parse(path.read_text(encoding="utf-8"))


def test_there_are_ten_recipes_and_each_is_executed() -> None:
    assert len(RECIPES) == 10
    assert all("```sh\n" in text for text in RECIPES.values())
