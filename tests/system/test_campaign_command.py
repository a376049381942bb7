"""``hil campaign`` from its command line: the same results from every engine, and nothing lost."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.errors import CampaignStopped
from hil.parts.campaigns import batch, engines
from hil.parts.campaigns.campaign import CampaignJob
from hil.parts.campaigns.engines import LocalEngine
from hil.parts.campaigns.store import Store
from tests.support.run_settings import without_figures

pytestmark = pytest.mark.xdist_group("campaign")

SHORT = ("--duration", "1.0")


def fly(folder: Path, *options: str, runs: int = 120, duration: tuple[str, str] = SHORT, figures: bool = False) -> None:
    """Run a short campaign into ``folder``. figures: draw those of its cases, which takes longer than the flights."""
    with nullcontext() if figures else without_figures():
        assert execute(["campaign", "scheme-1", "--runs", str(runs), "--out", str(folder), *duration, *options]) == 0


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a campaign that one process flew."""
    folder = tmp_path_factory.mktemp("alone") / "c"
    fly(folder, "--workers", "1", figures=True)
    return folder


def assert_same(one: Path, other: Path) -> None:
    """Compare the cases of two campaigns."""
    assert pq.read_table(one / "cases.parquet").equals(pq.read_table(other / "cases.parquet"))
    assert (one / "cases.parquet").read_bytes() == (other / "cases.parquet").read_bytes()


def test_campaign_writes_cases_summary_and_figure(alone: Path) -> None:
    table = pq.read_table(alone / "cases.parquet")
    assert table.column("case").to_pylist() == list(range(120))
    assert len(set(table.column("initial.position_m[0]").to_pylist())) == 120
    summary = json.loads((alone / "summary.json").read_text())
    assert summary["runs"] == 120
    assert summary["pass_rate"]["passed"]["low"] == 0.0  # one second is too short to be ready
    assert summary["percentiles"]["propellant_kg"]["n"] == 120
    assert summary["why"]["failed"] == 120
    assert (alone / "report.html").stat().st_size < 1_000_000
    assert (alone / "percentiles.png").stat().st_size > 10_000
    assert not list((alone / "parts").iterdir())


def test_result_does_not_depend_on_the_number_of_workers(alone: Path, tmp_path: Path) -> None:
    fly(tmp_path / "two", "--workers", "2")
    assert_same(alone, tmp_path / "two")


def test_campaign_of_one_run_is_the_first_case_of_a_long_one(alone: Path, tmp_path: Path) -> None:
    fly(tmp_path / "one", "--workers", "1", runs=1)
    one, many = (pq.read_table(folder / "cases.parquet").slice(0, 1) for folder in (tmp_path / "one", alone))
    assert one.equals(many)


class Deadly(LocalEngine):
    """Kills one of its workers, or the process that starts them, with -9 after the first batch."""

    starter = False

    def run(self, spec: batch.Spec, batches: list[batch.Batch]) -> Iterator[tuple[int, batch.Rows]]:  # type: ignore[override]
        for number, done in enumerate(super().run(spec, batches)):
            if number == 0:
                children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
                workers = {w: int(child) for child in children for w in _children(int(child))}
                os.kill(min(workers.values()) if self.starter else min(workers), signal.SIGKILL)
            yield done


def _children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.parametrize("starter", [False, True])
def test_worker_killed_in_the_middle_changes_nothing(alone: Path, tmp_path: Path, starter: bool) -> None:
    campaign = CampaignJob(load_scenario("scheme-1"), load_rig("mock"), 0, 1.0)
    store, engine = campaign.store(tmp_path / "c"), Deadly(2)
    engine.starter = starter
    campaign.run(store, 120, engine, lambda _: None)
    assert_same(alone, tmp_path / "c")


@pytest.mark.slow
def test_case_that_kills_its_worker_is_recorded_and_the_rest_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "run_batch", _deadly_batch)
    scenario = load_scenario("scheme-1").value
    spec = batch.Spec.of(scenario, load_rig("mock").value, 0, 0.1)
    rows = dict(LocalEngine(2).run(spec, [(0, 1), (1, 2)]))
    found = [row for first in sorted(rows) for row in rows[first]]
    assert [row["case"] for row in found] == [0, 1, 2]
    died = [row["case"] for row in found if row["stop"].startswith("not flown: its worker process ended")]
    assert died == [2]


def _deadly_batch(spec: batch.Spec, first: int, count: int) -> batch.Rows:
    if first <= 2 < first + count:
        os.kill(os.getpid(), signal.SIGKILL)
    return batch.run_batch(spec, first, count)


@pytest.mark.slow
def test_campaign_whose_workers_all_die_stops_with_the_last_case(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "run_batch", _deadly_from_two_on)
    spec = batch.Spec.of(load_scenario("scheme-1").value, load_rig("mock").value, 0, 0.1)
    run = LocalEngine(2).run(spec, [(0, 2), (2, 1), (3, 1), (4, 1), (5, 40)])
    found = [next(run)[0]]
    with pytest.raises(CampaignStopped, match="3 cases in a row, the last of them 4, ended 3 times"):
        list(run)
    assert found == [0]


def _deadly_from_two_on(spec: batch.Spec, first: int, count: int) -> batch.Rows:
    if first >= 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return batch.run_batch(spec, first, count)


def test_killed_campaign_resumes_where_it_was_and_locks_its_folder(
    alone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "c"
    command = [sys.executable, "-m", "hil", "campaign", "scheme-1", "--runs", "120", "--out", str(folder), *SHORT]
    with subprocess.Popen([*command, "--workers", "1"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as child:
        until = time.monotonic() + 120.0
        while not list(folder.glob("parts/*.parquet")) and child.poll() is None and time.monotonic() < until:
            time.sleep(0.002)
        child.send_signal(signal.SIGSTOP)
        options = ["--runs", "120", "--out", str(folder), *SHORT]
        assert execute(["campaign", "scheme-1", *options, "--workers", "1"]) == 2
        said = capsys.readouterr().err.strip()
        assert said.splitlines()[-1].endswith("another campaign is running in it, give another folder or wait")
        child.kill()
    fly(folder, "--workers", "1")
    assert_same(alone, folder)


def test_start_farther_out_than_planned_is_caught_up_with_below_the_closing_limit(tmp_path: Path) -> None:
    start = "dispersions.initial.position_m={kind='uniform', low=[5.12, -0.31, 0.29], high=[5.18, -0.29, 0.31]}"
    for name, rate in (("slowly", ()), ("quickly", ("--set", "gnc.control.correction_rate_mps=0.05"))):
        options = ("--workers", "1", "--set", start, *rate)
        fly(tmp_path / name, *options, runs=12, duration=("--duration", "10"))
    slowly, quickly = (pq.read_table(tmp_path / name / "cases.parquet") for name in ("slowly", "quickly"))
    assert set(slowly.column("abort").to_pylist()) == {""}
    assert min(slowly.column("closing_margin_mps").to_pylist()) > -0.003
    assert set(quickly.column("abort").to_pylist()) == {"the closing rate was too high"}


def test_case_that_cannot_be_flown_is_recorded_with_its_reason(tmp_path: Path) -> None:
    mass = "dispersions.chaser.mass_kg={kind='uniform', low=-500.0, high=1500.0}"
    fly(tmp_path / "c", "--workers", "1", "--set", mass, runs=20)
    table = pq.read_table(tmp_path / "c" / "cases.parquet")
    for kilograms, stop in zip(table["chaser.mass_kg"].to_pylist(), table["stop"].to_pylist(), strict=True):
        assert ("chaser.mass_kg" in stop) == (kilograms <= 0.0), stop
    assert table["stop"].to_pylist().count("completed") > 5


def test_one_case_in_full_detail_is_that_of_the_campaign(alone: Path, tmp_path: Path) -> None:
    path = tmp_path / "case.json"
    assert execute(["run", "scheme-1", "--case", "17", *SHORT, "--json", str(path)]) == 1
    summary = json.loads(path.read_text())
    row = pq.read_table(alone / "cases.parquet").slice(17, 1).to_pylist()[0]
    assert summary["seed"] == row["seed"]
    assert summary["case"] == 17
    assert summary["thrusters"]["propellant_kg"] == row["propellant_kg"]
    assert summary["verdict"]["security"]["corridor_margin_m"] == row["corridor_margin_m"]
    assert summary["verdict"]["security"]["nearest_m"] == pytest.approx(row["nearest_m"], rel=1e-14)


def test_case_of_a_planar_campaign_begins_in_the_plane_in_full_detail_too(tmp_path: Path) -> None:
    planar = ("planar", "--rig", "mock-planar", "--seed", "5", "--duration", "30")
    with without_figures():
        execute(["campaign", *planar, "--runs", "1", "--out", str(tmp_path / "c")])
    execute(["run", *planar, "--case", "0", "--json", str(tmp_path / "case.json")])
    row = pq.read_table(tmp_path / "c" / "cases.parquet").to_pylist()[0]
    assert json.loads((tmp_path / "case.json").read_text())["thrusters"]["propellant_kg"] == row["propellant_kg"]


def test_case_of_a_campaign_with_another_dispersion_set_needs_its_name(tmp_path: Path) -> None:
    stress = ("--dispersions", "stress", "--set", "dispersions.truth.centre_of_mass_offset_m.sigma=0.003")
    fly(tmp_path / "c", "--workers", "1", *stress, runs=3)
    found = json.loads((tmp_path / "c" / "summary.json").read_text())
    assert found["dispersions"] == "stress"
    row = pq.read_table(tmp_path / "c" / "cases.parquet").slice(2, 1).to_pylist()[0]
    assert abs(row["truth.centre_of_mass_offset_m[0]"] - 0.003) < 5 * 0.003
    assert row["truth.misalignment_sigma_deg"] == 1.0
    path = tmp_path / "case.json"
    execute(["run", "scheme-1", "--case", "2", *stress, *SHORT, "--json", str(path)])
    summary = json.loads(path.read_text())
    assert summary["seed"] == row["seed"]
    assert summary["thrusters"]["propellant_kg"] == row["propellant_kg"]


def test_pairs_of_two_scenarios_share_their_chance(tmp_path: Path) -> None:
    fly(tmp_path / "c", "--workers", "1", "--against", "scheme-1-printed", runs=5)
    tables = [pq.read_table(tmp_path / "c" / name / "cases.parquet") for name in ("first", "second")]
    assert tables[0]["seed"].equals(tables[1]["seed"])
    assert tables[0]["initial.position_m[0]"].equals(tables[1]["initial.position_m[0]"])
    found = json.loads((tmp_path / "c" / "comparison.json").read_text())
    assert (found["first"], found["second"]) == ("scheme-1", "scheme-1-printed")
    assert found["difference"]["propellant_kg"]["n"] == 5


def test_sweep_flies_the_same_cases_for_each_value(tmp_path: Path) -> None:
    fly(tmp_path / "c", "--workers", "1", "--sweep", "gnc.control.deadband_m=0.0002:0.02:3", runs=4)
    found = json.loads((tmp_path / "c" / "sweep.json").read_text())
    assert found["key"] == "gnc.control.deadband_m"
    assert [point["value"] for point in found["points"]] == pytest.approx([0.0002, 0.0101, 0.02])
    assert (tmp_path / "c" / "sweep.png").stat().st_size > 5_000


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--set", "dispersions.initial.position_m.sigma=-1.0"), ("initial.position_m", "-1", "must not be negative")),
        (("--set", "dispersions.initial.place.sigma=1.0"), ("dispersions.initial.place", "unknown key", "position_m")),
        (("--runs", "0"), ("--runs", "0", "at least 1")),
        (("--sweep", "gnc.control.deadband_m=0.02:0.002:10"), ("--sweep", "low must be below high")),
        (("--sweep", "gnc.control.deadband=0.002:0.02:10"), ("--sweep", "gnc.control.deadband", "unknown key")),
        (("--sweep", "x=1:2:3", "--against", "scheme-2"), ("--against", "not together with --sweep")),
        (("--against", "scheme-9"), ("scheme-9", "unknown scenario")),
        (("--dispersions", "strss"), ("strss", "unknown dispersion set", "data-sheet, shipped, stress")),
        (("--dispersions", "nowhere.toml"), ("nowhere.toml", "no such file")),
        (("--dispersions", ""), ("dispersion set",)),
        (("--scheduler", "tcp://127.0.0.1:9"), ("--scheduler", "tcp://127.0.0.1:9", "cannot be reached")),
        (("--set", "rig.rails.x.encoder=incremental"), ("rails.x.encoder", "incremental")),
        (("--set", "vmu.source=rendered"), ("--set: vmu.source", "rendered", 'allowed "model"')),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    options: tuple[str, ...],
    words: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(engines, "_CONNECT_S", 0.5)
    runs = () if "--runs" in options else ("--runs", "3")
    assert execute(["campaign", "scheme-1", *runs, "--out", str(tmp_path / "c"), *SHORT, *options]) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    for word in words:
        assert word in said
    assert not (tmp_path / "c" / "cases.parquet").exists()


def test_folder_of_another_scenario_is_refused(alone: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (alone / "cases.parquet").read_bytes()
    assert execute(["campaign", "scheme-2", "--runs", "3", "--out", str(alone), *SHORT]) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert '"scheme-1"' in said
    assert '"scheme-2"' in said
    assert (alone / "cases.parquet").read_bytes() == before


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_cluster_gives_the_same_cases_also_when_its_worker_is_lost_at_half(
    alone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another worker takes over, whenever it comes."""
    port, put = free_port(), Store.put
    with cluster_of_processes(port) as (_, worker):

        def put_and_strike(store: Store, first: int, rows: list[dict[str, Any]]) -> None:
            put(store, first, rows)
            if worker.poll() is None:
                worker.kill()
                worker.wait()
                others.enter_context(member(worker_of(port)))

        with ExitStack() as others:
            monkeypatch.setattr(Store, "put", put_and_strike)
            fly(tmp_path / "lost", "--scheduler", f"tcp://127.0.0.1:{port}")
    assert worker.poll() == -signal.SIGKILL
    assert_same(alone, tmp_path / "lost")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def worker_of(port: int) -> list[str]:
    return ["worker", f"tcp://127.0.0.1:{port}", "--nthreads", "1", "--no-nanny", "--no-dashboard"]


@contextmanager
def member(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Yield a process of a cluster, which ends with the block."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, "-m", "dask", *command], **quiet) as process:  # type: ignore[call-overload]
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def cluster_of_processes(port: int) -> Iterator[tuple[subprocess.Popen[bytes], subprocess.Popen[bytes]]]:
    """Yield scheduler and worker of a cluster; both end with the block."""
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    with member(scheduler) as first, member(worker_of(port)) as second:
        yield first, second


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "words"), [(signal.SIGKILL, "connection lost"), (signal.SIGSTOP, "no answer for 2 s")], ids=["dead", "hung"]
)
def test_lost_scheduler_is_one_line_and_the_campaign_continues_with_another(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    how: signal.Signals,
    words: str,
) -> None:
    monkeypatch.setattr(engines, "_SILENT_S", 2.0)
    monkeypatch.setattr(engines, "_ASK_EVERY_S", 0.5)
    fly(tmp_path / "calm", runs=300)
    port = free_port()
    command = ["campaign", "scheme-1", "--runs", "300", *SHORT, "--scheduler", f"tcp://127.0.0.1:{port}"]
    command += ["--out", str(tmp_path / "lost")]
    with cluster_of_processes(port) as (scheduler, _):
        put, parts = Store.put, []

        def put_and_strike(store: Store, first: int, rows: list[dict[str, Any]]) -> None:
            put(store, first, rows)
            parts.append(first)
            scheduler.send_signal(how)

        monkeypatch.setattr(Store, "put", put_and_strike)
        capsys.readouterr()
        assert execute(command) == 3
        monkeypatch.setattr(Store, "put", put)
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith(f"scheduler tcp://127.0.0.1:{port}: {words}: completed cases are kept")
    assert len(list((tmp_path / "lost" / "parts").glob("*.parquet"))) == len(parts) < 6
    with cluster_of_processes(port):
        assert execute(command) == 0
    assert_same(tmp_path / "calm", tmp_path / "lost")
