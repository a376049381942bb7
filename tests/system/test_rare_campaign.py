"""``hil campaign --rare``: the same estimate from any workers, interrupted or not, and each case flown again."""

from __future__ import annotations

import json
import math
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.stats import norm

import hil
from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.maths.random_streams import noise_source
from hil.parts.campaigns.batch import Batch, Case, Rows, Spec
from hil.parts.campaigns.campaign import CampaignJob
from hil.parts.campaigns.outcome import failed_row
from hil.parts.campaigns.rare_campaign import POINT_COLUMNS, RareCampaign, RareSettings, verdict_line
from hil.parts.campaigns.rare_events import RareEvent
from hil.parts.campaigns.statistics import wilson
from hil.parts.campaigns.stored_campaign import StoredCampaign

pytestmark = pytest.mark.xdist_group("campaign")

SHORT = ("--duration", "1.0")
EVENT = RareEvent("nearest_m", ">", float(norm.isf(1e-3)))


class Interrupted(Exception):
    """End of a campaign in its middle."""


class AnalyticEngine:
    """Engine whose outcome is one normal of a case's noise; yields the batches in reverse order."""

    workers = 1

    def __init__(self, batches: float = math.inf) -> None:
        self.left = batches

    def run(self, spec: Spec, batches: Iterable[Batch]) -> Generator[tuple[int, Rows], None, None]:
        spec = pickle.loads(pickle.dumps(spec))
        for first, count in reversed(list(batches)):
            if self.left <= 0:
                raise Interrupted
            self.left -= 1
            yield first, [self.row(spec, case) for case in range(first, first + count)]

    @staticmethod
    def row(spec: Spec, case: int) -> dict[str, Any]:
        """Return the row of a case."""
        drawn = dict.fromkeys(JOB.design.names, 0.0)
        outcome = float(noise_source(spec.mixed[case], "initial").standard_normal((6,))[0])
        return {"case": case, "seed": int(spec.mixed[case]), **drawn, **failed_row(""), "nearest_m": outcome}

    def close(self) -> None:
        """Do nothing."""


JOB = CampaignJob(load_scenario("scheme-1"), load_rig("mock"), 5, 1.0)


def run(folder: Path, engine: AnalyticEngine) -> dict[str, Any]:
    """Run the campaign of EVENT in ``folder``; return its summary."""
    settings = RareSettings(EVENT, 500)
    with JOB.store(folder, more=settings.identity(), columns=POINT_COLUMNS) as store:
        return RareCampaign(JOB, settings, store, engine).run(lambda _: None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a campaign that was not interrupted."""
    found = tmp_path_factory.mktemp("rare") / "c"
    run(found, AnalyticEngine())
    return found


def test_interrupted_campaign_is_resumed_to_the_same_result(folder: Path, tmp_path: Path) -> None:
    whole = json.loads((folder / "summary.json").read_text())
    assert whole["rare"]["low"] < 1e-3 < whole["rare"]["high"]
    assert whole["rare"]["cases"] == 500 + 450 * (len(whole["rare"]["levels"]) - 1)
    assert whole["rare"]["failing_cases"] >= 20
    for batches in (4, 15):
        with pytest.raises(Interrupted):
            run(tmp_path / "parts", AnalyticEngine(batches))
    assert run(tmp_path / "parts", AnalyticEngine()) == whole
    assert (tmp_path / "parts" / "cases.parquet").read_bytes() == (folder / "cases.parquet").read_bytes()
    assert run(tmp_path / "parts", AnalyticEngine(0)) == whole  # nothing is left to run
    assert "probability" in verdict_line(whole["rare"])


def test_noise_of_a_case_is_made_from_the_folder_alone(folder: Path) -> None:
    stored = StoredCampaign(folder)
    for row in pq.read_table(folder / "cases.parquet").to_pylist()[::97]:
        mixed = stored.mixed_seed(row["case"])
        assert mixed is not None
        assert int(mixed) == row["seed"]
        assert float(noise_source(mixed, "initial").standard_normal((6,))[0]) == row["nearest_m"]


def test_case_flown_in_full_detail_has_the_bits_of_the_campaign(folder: Path, tmp_path: Path) -> None:
    case = json.loads((folder / "summary.json").read_text())["rare"]["failing"][0]["case"]
    mixed = StoredCampaign(folder).mixed_seed(case)
    assert mixed is not None
    assert len(mixed.seeds) > 2
    row = Case(Spec(JOB.spec.scenario, JOB.spec.rig, JOB.seed, 1.0, {case: mixed})).row(case)
    path = tmp_path / "case.json"
    options = ["--campaign", str(folder), "--case", str(case), "--json", str(path)]
    assert execute(["run", "scheme-1", *options]) == 1
    found = json.loads(path.read_text())
    assert (found["seed"], found["case"], found["campaign_seed"]) == (row["seed"], case, 5)
    assert found["thrusters"]["propellant_kg"] == row["propellant_kg"]
    assert found["verdict"]["security"]["corridor_margin_m"] == row["corridor_margin_m"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--rare", "position_x > 1"), ("--rare", "position_x", "no such outcome")),
        (("--rare", "position_m_x"), ("--rare", "must be an outcome")),
        (("--rare", "nearest_m > 1", "--runs", "100"), ("--runs", "100", "too few", "500")),
        (("--rare", "nearest_m > 1", "--sweep", "a=1:2:3"), ("--rare", "not together")),
        (("--rare", "nearest_m > 1", "--method", "importance"), ("--method", "importance", "position_m_x")),
        (("--rare", "position_m_x < 1", "--method", "importance"), ("--method", "importance", ">")),
        (("--rare", "position_m_x > 1", "--method", "importance", "--runs", "9"), ("--runs", "9", "at least 200")),
        (("--rare", "nearest_m > 1", "--method", "guess"), ("--method", "guess", "subset or importance")),
        ((), ("--runs", "must be given")),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    options: tuple[str, ...], words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["campaign", "scheme-1", "--out", str(tmp_path / "c"), *SHORT, *options]) == 2
    printed = capsys.readouterr().err.strip()
    assert len(printed.splitlines()) == 1
    assert all(word in printed for word in words), printed
    assert not (tmp_path / "c").exists()


def test_folder_of_another_event_and_case_without_campaign_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    same, there = ["--out", str(folder), "--seed", "5", *SHORT], str(folder)
    refused = (
        (["campaign", "scheme-1", "--rare", "nearest_m > 9", "--runs", "500", *same], "holds another campaign"),
        (["run", "scheme-1", "--campaign", there], "needs --case"),
        (["run", "scheme-1", "--campaign", there, "--case", "99999"], "99999: not in"),
        (["run", "scheme-1", "--campaign", str(tmp_path), "--case", "1"], "holds no campaign"),
        (["run", "scheme-1", "--campaign", there, "--case", "1", "--seed", "3"], "omit --seed"),
    )
    for command, words in refused:
        assert execute(command) == 2
        printed = capsys.readouterr().err.strip().splitlines()
        assert words in printed[-1]


@pytest.mark.slow
def test_workers_and_a_kill_in_the_middle_change_nothing(tmp_path: Path) -> None:
    event = ["--rare", "propellant_kg > 0.037", "--runs", "500", "--duration", "5"]
    command = ["campaign", "scheme-1", *event]
    for workers in ("1", "2"):
        assert execute([*command, "--out", str(tmp_path / workers), "--workers", workers]) == 0
    killed = tmp_path / "killed"
    child = subprocess.Popen(
        [sys.executable, "-m", "hil", *command, "--out", str(killed), "--workers", "2"],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )
    while len(list(killed.glob("parts/*.parquet"))) < 15 and child.poll() is None:
        time.sleep(0.01)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    assert not (killed / "cases.parquet").exists()
    assert execute([*command, "--out", str(killed), "--workers", "2"]) == 0
    for name in ("cases.parquet", "summary.json"):
        assert (killed / name).read_bytes() == (tmp_path / "1" / name).read_bytes()
        assert (tmp_path / "2" / name).read_bytes() == (tmp_path / "1" / name).read_bytes()


NEAR = {
    "initial.position_m": [0.7, 0.0, 0.0],
    "rig.rails.x.park_m": 0.6,
    "duration_s": 60.0,
    "dispersions.sampling": "random",
}
"""Overrides for a run that is soon ready."""


@pytest.mark.slow
def test_importance_sampling_agrees_with_plain_cases_and_its_cases_fly_again(tmp_path: Path) -> None:
    event, threshold = "position_m_y > 0.006", 0.006
    found = hil.rare_event("scheme-1", event, tmp_path / "two", "importance", 1200, overrides=NEAR, workers=2)
    rare = found.summary["rare"]
    plain = hil.campaign("scheme-1", 2000, overrides=NEAR)
    interval = wilson(int(np.count_nonzero(plain.column("position_m_y") > threshold)), 2000)
    assert rare["low"] < interval["high"]
    assert rare["high"] > interval["low"]
    assert rare["cov"] < 0.25
    failing = rare["failing"][0]
    worst = found.run_case(failing["case"]).verdict.worst
    assert worst is not None
    assert worst["position_m"][1] == failing["value"]
    again = hil.rare_event("scheme-1", event, tmp_path / "one", "importance", 1200, overrides=NEAR, workers=1)
    assert again.summary == found.summary
    assert (tmp_path / "one" / "cases.parquet").read_bytes() == (tmp_path / "two" / "cases.parquet").read_bytes()


@pytest.mark.slow
def test_dask_cluster_gives_the_same_estimate(tmp_path: Path) -> None:
    from distributed import LocalCluster

    command = ["campaign", "scheme-1", "--rare", "propellant_kg > 0.018", "--runs", "500", "--duration", "2"]
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        assert execute([*command, "--out", str(tmp_path / "dask"), "--scheduler", cluster.scheduler_address]) == 0
    assert execute([*command, "--out", str(tmp_path / "here"), "--workers", "1"]) == 0
    for name in ("cases.parquet", "summary.json"):
        assert (tmp_path / "dask" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


@pytest.mark.slow
def test_script_without_main_guard_runs_a_campaign_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text('import hil\nprint(hil.campaign("scheme-1", runs=20, duration_s=0.5, workers=2))\n')
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.count("<Campaign scheme-1") == 1
