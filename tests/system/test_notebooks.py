"""The notebooks of ``examples/`` run from top to bottom and are kept without their outputs."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

mpl.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def code_cells(notebook: Path) -> list[str]:
    return ["".join(c["source"]) for c in json.loads(notebook.read_text())["cells"] if c["cell_type"] == "code"]


def displayed(source: str, names: dict[str, Any]) -> Any:
    """Execute a cell; return the value of its last expression, as a notebook displays it."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)


@pytest.mark.parametrize(
    "notebook",
    [
        pytest.param(path, marks=() if path.stem == "first_flight" else pytest.mark.slow, id=path.stem)
        for path in NOTEBOOKS
    ],
)
def test_notebook_runs(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    names: dict[str, Any] = {"__name__": "__main__"}
    results = [displayed(cell, names) for cell in code_cells(notebook)]
    for found in results:
        for form in ("_repr_html_", "_repr_png_"):
            shown = getattr(found, form)() if hasattr(found, form) else None
            assert shown is None or len(shown) > 1000
    plt.close("all")
    if notebook.stem == "first_flight":
        assert results[0] is True
        assert results[-1] is True
    if notebook.stem == "tune_a_filter":
        assert results[0] is True


def test_three_notebooks_are_kept_without_outputs() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["campaign", "first_flight", "tune_a_filter"]
    for path in NOTEBOOKS:
        cells = json.loads(path.read_text())["cells"]
        assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells if "outputs" in cell)
