"""The scripts in ``examples/scripts`` are short and work."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.xdist_group("campaign")

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "scripts"
SCRIPTS = sorted(FOLDER.glob("*.py"))
LINES_MOST = 10
LIBRARIES = {"to_pandas": "pandas", "to_polars": "polars", "to_xarray": "xarray", "on_dask": "distributed"}


@pytest.mark.parametrize("script", [pytest.param(path, id=path.stem) for path in SCRIPTS])
def test_script_is_short_and_works(script: Path, tmp_path: Path) -> None:
    if script.stem in LIBRARIES:
        pytest.importorskip(LIBRARIES[script.stem])
    text = script.read_text()
    comment = ast.get_docstring(ast.parse(text), clean=False) or ""
    code = [line for line in text.replace(f'"""{comment}"""', "").splitlines() if line.strip()]
    assert len(code) <= LINES_MOST
    environment = os.environ | {"MPLBACKEND": "agg"}
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout or list(tmp_path.iterdir())
