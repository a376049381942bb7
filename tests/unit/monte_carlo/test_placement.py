"""Recorded runs among the cases of a campaign."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.cli.main import execute
from hil.errors import BadInput
from hil.parts.campaigns.cli import campaign_recordings
from hil.parts.campaigns.placement import outcomes_of, place, place_run

SUMMARY: dict[str, Any] = {
    "scenario": "scheme-1",
    "ready_time_s": None,
    "ready_phase": {"position_m": [0.5, 0.1, 2.0]},
    "navigation": {"nees_pkf": 6.0},
    "thrusters": {"propellant_kg": 0.1, "thruster_firings": [1, 2]},
}


def folder_of(path: Path, **identity: Any) -> Path:
    """Return a folder with a campaign of 999 cases."""
    table = {f"position_m_{axis}": np.linspace(0.0, 1.0, 999) for axis in "xyz"} | {"nees_pkf": np.full(999, np.nan)}
    pq.write_table(pa.table(table | {"first_violated": np.full(999, "")}), path / "cases.parquet")
    known = {"scenario": "scheme-1", "digest": "", "seed": 0, "duration_s": 400.0}
    (path / "campaign.json").write_text(json.dumps(known | identity))
    return path


def test_value_has_percentile_probability_and_distance() -> None:
    cases = np.append(np.linspace(0.0, 1.0, 999), np.nan)
    inside, outside = place(0.25, cases), place(1.9, cases)
    assert inside["percentile"] == pytest.approx(25.0, abs=0.1)
    assert inside["p_value"] == pytest.approx(0.5, abs=0.01)
    assert (inside["outside"], inside["cases"]) == (0.0, 999)
    assert (outside["percentile"], outside["p_value"]) == (100.0, pytest.approx(2.0 / 1000.0))
    assert outside["outside"] == pytest.approx(1.0)
    assert place(-0.9, cases)["outside"] == pytest.approx(1.0)
    assert place(1.0, np.full(9, np.nan))["percentile"] is None


def test_probability_is_that_of_a_case_of_the_campaign() -> None:
    generator = np.random.default_rng(2)
    found = [place(float(generator.random()), generator.random(99))["p_value"] for _ in range(4000)]
    for level in (0.02, 0.1, 0.5):
        assert np.mean(np.array(found) <= level) == pytest.approx(level, abs=4.0 * np.sqrt(level / 4000.0))


def test_outcomes_of_a_run_have_the_names_of_the_columns() -> None:
    assert outcomes_of(SUMMARY) == {
        "propellant_kg": 0.1, "nees_pkf": 6.0, "firings": 3.0,
        "position_m_x": 0.5, "position_m_y": 0.1, "position_m_z": 2.0,
    }  # fmt: skip
    assert outcomes_of({}) == {}


def test_run_is_placed_and_one_outside_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = place_run(SUMMARY, folder_of(tmp_path))
    assert set(found) == {"position_m_x", "position_m_y", "position_m_z", "nees_pkf"}
    assert found["position_m_z"]["outside"] == pytest.approx(1.11, abs=0.01)

    class Opened:
        summary = SUMMARY

    monkeypatch.setattr("hil.api.recordings.open_recording", lambda _: Opened)
    assert campaign_recordings.place_recordings(["run.mcap"], campaign=str(tmp_path)) == 1
    assert "1 of 4 outcomes outside 999 cases" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("identity", "words"),
    [({"scenario": "scheme-2"}, "scheme-2"), ({"rare": {}}, "no sample"), ({"sobol": True}, "no sample")],
)
def test_campaign_of_something_else_is_refused(identity: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=words):
        place_run(SUMMARY, folder_of(tmp_path, **identity))


def test_folder_without_campaign_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["recordings", "place", str(tmp_path / "no.mcap"), "--campaign", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
