"""The scripts in ``examples/scripts`` are short and work."""

from __future__ import annotations

import ast
import os
import runpy
from pathlib import Path

import matplotlib as mpl
import pytest

mpl.use("Agg")
from matplotlib import pyplot as plt

from tests.support.run_settings import without_figures

pytestmark = pytest.mark.xdist_group("campaign")

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "scripts"
SCRIPTS = sorted(FOLDER.glob("*.py"))
LINES_MOST = 10
LIBRARIES = {"to_pandas": "pandas", "to_polars": "polars", "to_xarray": "xarray", "on_dask": "distributed"}


@pytest.mark.parametrize("script", [pytest.param(path, id=path.stem) for path in SCRIPTS])
def test_script_is_short_and_works(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if script.stem in LIBRARIES:
        pytest.importorskip(LIBRARIES[script.stem])
    text = script.read_text()
    comment = ast.get_docstring(ast.parse(text), clean=False) or ""
    code = [line for line in text.replace(f'"""{comment}"""', "").splitlines() if line.strip()]
    assert len(code) <= LINES_MOST
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})  # cases run in this process, with its kernels
    with without_figures():
        runpy.run_path(str(script), run_name="__main__")
    plt.close("all")
    assert capsys.readouterr().out or list(tmp_path.iterdir())
