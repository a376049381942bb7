"""The pages on backends: their code is executed as it stands, in the order of the page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.cli.main import execute
from hil.maths import quat
from tests.support.external_gnc import ROOT

pytestmark = pytest.mark.xdist_group("campaign")
PAGES = ROOT / "docs" / "how-to"


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", (PAGES / page).read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", ["fly-a-law.md", "fly-a-filter.md"])
def test_code_of_the_page_flies(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"hil": hil, "np": np, "quat": quat, "Path": Path, "__name__": "__main__"}
    for block in blocks(page, "python"):
        if block.startswith("# law.py"):
            Path("law.py").write_text(block)
        else:
            exec(compile(block, page, "exec"), names)
            assert names["run"].summary["stop"] == "completed"
    if page == "fly-a-filter.md":
        assert abs(names["error"][-1]).max() < 0.02
        assert names["again"].navigation["replayed"]["position_rmse_m"] is not None
    else:
        assert names["recording"].replay().identical


def test_law_of_the_page_passes_scheme_1_by_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("law.py").write_text(blocks("fly-a-law.md", "python")[0])
    assert execute(["run", "scheme-1", "--set", 'gnc.control.backend="law.py:damper"']) == 0


def test_scenario_of_the_page_disperses_a_setting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("law.py").write_text(blocks("fly-a-law.md", "python")[0])
    text = 'extends = "scheme-1"\nname = "own"\n' + blocks("fly-a-law.md", "toml")[0]
    Path("own.toml").write_text(text)
    found = hil.campaign("own.toml", 3, duration_s=2.0, workers=1)
    drawn = found.column("gnc.control.settings.lead_s")
    assert len(set(drawn)) == 3
    assert drawn.min() >= 10.0
    assert drawn.max() <= 20.0
