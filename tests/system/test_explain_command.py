"""``hil explain`` and the page of a campaign: from a folder or a recording to the cause."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from hil.cli.main import execute
from tests.support.planted_causes import CAUSES, explained, is_named, without_cause

pytestmark = pytest.mark.xdist_group("campaign")

SEEDS = 10
NAMED_LEAST, NOTHING_LEAST = 47, 9


@pytest.fixture(scope="module")
def biased(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a campaign whose cases fail by a two-sided bias of the vision unit."""
    folder = tmp_path_factory.mktemp("biased") / "c"
    explained(CAUSES["two-sided bias"][0], 0, folder, 60, 1)
    return folder


def run(arguments: list[str], path: Path) -> dict[str, Any]:
    """Return the JSON of ``hil explain``."""
    assert execute(["explain", *arguments, "--json", str(path)]) == 0
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def test_cause_of_a_campaign_is_named_with_its_driver(biased: Path, tmp_path: Path, capsys: Any) -> None:
    found = run([str(biased)], tmp_path / "why.json")
    assert is_named(found, *CAUSES["two-sided bias"][1:])
    assert not found["nothing_found"]
    cut = found["causes"][0]["threshold"]
    assert (cut["kind"], cut["side"], cut["passes"]) == ("size", "above", 0)
    assert "driven by vmu.errors.bias_m[1]: size above" in capsys.readouterr().out


def test_every_failing_case_has_a_first_violated_limit_and_no_accepted_one(biased: Path) -> None:
    table = pq.read_table(biased / "cases.parquet")
    for accepted, name, at_s in zip(
        *(table.column(c).to_pylist() for c in ("accepted", "first_violated", "first_violated_s")), strict=True
    ):
        assert bool(name) != accepted
        assert (at_s is None) == accepted  # fmt: skip


def test_case_has_its_margins_and_the_nearest_case_that_passes(biased: Path, tmp_path: Path) -> None:
    table = pq.read_table(biased / "cases.parquet")
    case = table.column("accepted").to_pylist().index(False)
    found = run([str(biased), "--case", str(case)], tmp_path / "case.json")
    assert found["text"].startswith("the deviation across the docking axis (z) is ")
    assert found["limits"][0]["limit"] == "deviation_z"
    assert found["first_violated"]["_value"] > found["first_violated"]["_limit"] == 0.012
    assert table.column("accepted").to_pylist()[found["nearest"]["case"]]
    assert found["command"].endswith(f"--case {case}")


def test_page_is_written_again_and_refers_to_nothing_else(biased: Path) -> None:
    assert execute(["report", str(biased)]) == 0
    page = (biased / "report.html").read_text()
    assert "driven by vmu.errors.bias_m[1]" in page
    assert 'src="http' not in page
    assert "href=" not in page


def test_recorded_run_names_its_cause(tmp_path: Path) -> None:
    settings = (
        "requirements.radial_distance_m=0.001", 'requirements.required_parts=["control_precision"]',
        "initial.position_m=[0.42,0.0,0.0]", "initial.attitude_deg=[0.0,0.0,0.0]",
    )  # fmt: skip
    path = tmp_path / "run.json"
    options = ["--duration", "60", "--record", str(tmp_path), "--json", str(path)]
    assert execute(["run", "scheme-1", *(part for text in settings for part in ("--set", text)), *options]) == 1
    summary = json.loads(path.read_text())
    assert summary["first_violated"].startswith("deviation_")
    assert summary["first_violated_value"] > summary["first_violated_limit"] == 0.001
    found = run([str(next(tmp_path.glob("*.mcap")))], tmp_path / "why.json")
    assert found["first_violated"][""] == summary["first_violated"]
    assert found["text"].startswith("the deviation across the docking axis")


def test_folder_without_a_campaign_is_bad_input(tmp_path: Path, capsys: Any) -> None:
    for command in ("explain", "report"):
        assert execute([command, str(tmp_path)]) == 2
    assert execute(["explain", str(tmp_path / "none")]) == 2
    assert "holds no campaign" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_planted_causes_are_named_first(tmp_path: Path) -> None:
    named = {
        name: sum(
            is_named(explained(settings, seed, tmp_path / f"{name}-{seed}"), limit, numbers) for seed in range(SEEDS)
        )
        for name, (settings, limit, numbers) in CAUSES.items()
    }
    assert sum(named.values()) >= NAMED_LEAST, named


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_nothing_is_found_in_campaigns_without_a_cause(tmp_path: Path) -> None:
    assert sum(without_cause(seed, tmp_path / str(seed))["nothing_found"] for seed in range(SEEDS)) >= NOTHING_LEAST
