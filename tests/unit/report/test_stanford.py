"""Stanford diagram of a run and of a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE
from hil.loop.compiled.run_stats import counted
from hil.parts.campaigns.figure import draw_integrity, stanford_figure
from hil.report.figures import figures
from hil.report.verdict import verdict_of

TITLE = "Integrity: error against protection level (Stanford diagram)"


def history(level_m: float) -> np.ndarray:
    made = np.zeros(200, CYCLE)
    made["t_s"] = 0.02 * np.arange(200)
    made["truth"]["r_CT_H"] = (1.0, 0.0, 0.0)
    made["truth"]["q_CH"] = made["navigation"]["q_CH"] = (0.0, 0.0, 0.0, 1.0)
    made["truth"]["q_HI"] = (0.0, 0.0, 0.0, 1.0)
    made["navigation"]["r_CT_H"] = (1.01, 0.0, 0.0)
    made["navigation"]["valid"] = 1
    made["navigation"]["protection_level_m"] = level_m
    return made


@pytest.mark.parametrize(("level_m", "expected"), [(0.02, True), (np.nan, False)])
def test_report_has_the_diagram_if_protection_levels_are_reported(
    level_m: float, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.report.figures.svg_address", lambda _: "")
    scenario, rig, rows = load_scenario("scheme-1").value, load_rig("mock").value, history(level_m)
    verdict = verdict_of(counted(rows, scenario).ready, scenario.requirements)
    assert (TITLE in [title for title, _ in figures(rows, scenario, rig, verdict)]) == expected


def test_campaign_draws_each_case_relative_to_its_alert_limit(tmp_path: Path) -> None:
    columns: dict[str, Any] = {
        "worst_error_m": [0.02, 0.03, 0.5], "alert_limit_m": [0.1, 0.1, 0.0], "protection_level_m": [0.05, None, 0.2],
    }  # fmt: skip
    (plot,) = stanford_figure(columns.__getitem__).axes
    assert plot.lines[0].get_xydata().tolist() == [[pytest.approx(0.2), pytest.approx(0.5)]]

    class NoLevels:
        def column(self, _: str) -> list[None]:
            return [None, None]

    draw_integrity(NoLevels(), tmp_path / "none.png")  # type: ignore[arg-type]
    assert not (tmp_path / "none.png").exists()
