"""The catalogue of runs keeps every entry of concurrent writers."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hil.errors import BadInput
from hil.recording.catalogue import BROKEN_OFF, DONE, NAME, RUNNING, Catalogue, RecordingFilter

SUMMARY: dict[str, Any] = {
    "passed": True,
    "passed_all_parts": True,
    "stop": "completed",
    "ready_time_s": 160.0,
    "navigation": {"position_rmse_m": [0.003, 0.004, 0.0], "attitude_rmse_deg": None},
    "thrusters": {"propellant_kg": 0.1},
}

WRITER = """
import sys
from pathlib import Path
from tests_entry import entry
from hil.recording.catalogue import Catalogue, DONE
catalogue = Catalogue(Path(sys.argv[1]))
for i in range(20):
    name = f"{sys.argv[2]}-{i}"
    catalogue.begin(entry(name))
    catalogue.end(name, "2026-03-01T00:00:00.000Z", DONE, i, 0, {})
"""


def entry(run: str, started: str = "2026-03-01T12:00:00.000Z", scenario: str = "scheme-1") -> dict[str, Any]:
    return {
        "run": run,
        "started_utc": started,
        "scenario": scenario,
        "rig": "mock",
        "seed": 0,
        "duration_s": 400.0,
        "file": f"{run}.mcap",
        "hil": "0.1.0",
    }


def names(catalogue: Catalogue, wanted: RecordingFilter) -> list[str]:
    return [found["run"] for found in catalogue.runs(wanted)]


def test_runs_are_found_by_verdict_scenario_and_date(tmp_path: Path) -> None:
    catalogue = Catalogue(tmp_path)
    for run, started, scenario, passed in (
        ("a", "2026-03-01T12:00:00.000Z", "scheme-1", True),
        ("b", "2026-03-02T12:00:00.000Z", "scheme-1", False),
        ("c", "2026-03-03T12:00:00.000Z", "scheme-2", True),
    ):
        catalogue.begin(entry(run, started, scenario))
        catalogue.end(run, started, DONE, 5, 0, SUMMARY | {"accepted": passed})
    catalogue.begin(entry("d", "2026-03-04T12:00:00.000Z"))
    catalogue.end("d", "2026-03-04T12:00:01.000Z", BROKEN_OFF, 5, 0, {})
    catalogue.begin(entry("e", "2026-03-05T12:00:00.000Z"))
    assert names(catalogue, RecordingFilter()) == ["a", "b", "c", "d", "e"]
    assert names(catalogue, RecordingFilter(failed=True)) == ["b", "d"]
    assert names(catalogue, RecordingFilter(passed=True)) == ["a", "c"]
    assert names(catalogue, RecordingFilter(scenario="scheme-2")) == ["c"]
    assert names(catalogue, RecordingFilter(since="2026-03-03T12:00:00.000Z")) == ["c", "d", "e"]
    found = catalogue.runs()[0]
    assert found["file"] == str(tmp_path / "a.mcap")
    assert found["position_rmse_mm"] == pytest.approx(5.0)
    assert found["attitude_rmse_deg"] is None
    assert catalogue.runs()[-1]["state"] == RUNNING


def test_verdict_is_acceptance_and_of_earlier_versions_that_of_all_parts(tmp_path: Path) -> None:
    catalogue = Catalogue(tmp_path)
    for run, of_run in (
        ("a", {"accepted": True, "passed_all_parts": False}),
        ("b", {"accepted": False, "passed": True, "passed_all_parts": False}),
        ("c", {"passed_all_parts": True}),
        ("d", {"passed_all_parts": False}),
    ):
        catalogue.begin(entry(run))
        catalogue.end(run, "2026-03-01T12:10:00.000Z", DONE, 5, 0, SUMMARY | of_run)
    catalogue.begin(entry("e"))
    assert [found["accepted"] for found in catalogue.runs()] == [True, False, True, False, None]
    assert names(catalogue, RecordingFilter(failed=True)) == ["b", "d"]
    assert names(catalogue, RecordingFilter(passed=True)) == ["a", "c"]


def test_a_run_whose_process_is_gone_counts_as_broken_off(tmp_path: Path) -> None:
    catalogue = Catalogue(tmp_path)
    catalogue.begin(entry("gone"))
    with sqlite3.connect(catalogue.path) as connection:
        connection.execute("UPDATE runs SET process = '1 0 another boot'")
    connection.close()
    assert catalogue.runs()[0]["state"] == BROKEN_OFF
    assert names(catalogue, RecordingFilter(failed=True)) == ["gone"]


def test_two_writers_at_once_lose_no_entry(tmp_path: Path) -> None:
    (tmp_path / "tests_entry.py").write_text(
        "def entry(run):\n"
        "    return dict(run=run, started_utc='2026-03-01T12:00:00.000Z', scenario='s', rig='mock', seed=0,\n"
        "                duration_s=1.0, file=run + '.mcap', hil='0')\n"
    )
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n{WRITER}"
    writers = [subprocess.Popen([sys.executable, "-c", code, str(tmp_path), name]) for name in ("one", "two")]
    assert [writer.wait() for writer in writers] == [0, 0]
    found = Catalogue(tmp_path).runs()
    assert len(found) == 40
    assert all(run["state"] == DONE for run in found)


def test_other_file_in_its_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(b"no database at all, but long enough to be looked at" * 40)
    with pytest.raises(BadInput, match="not a catalogue"):
        Catalogue(tmp_path).runs()


def test_a_catalogue_of_another_version_is_refused(tmp_path: Path) -> None:
    catalogue = Catalogue(tmp_path)
    catalogue.begin(entry("a"))
    with sqlite3.connect(catalogue.path) as connection:
        connection.execute("PRAGMA user_version=9")
    connection.close()
    with pytest.raises(BadInput, match="version 9"):
        catalogue.runs()


def test_folder_without_catalogue_is_reported(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="--record"):
        Catalogue(tmp_path).runs()
    assert not (tmp_path / NAME).exists()
