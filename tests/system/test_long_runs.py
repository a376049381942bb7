"""Runs longer than the memory of their rows: the same numbers, events and recordings, in memory that does not grow."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.api import recordings, runs
from hil.core.clock import SimulatedClock
from hil.core.modes import Mode
from hil.errors import BadInput
from hil.frmn.ring import NoTelemetry
from hil.loop.rate_keeper import SimulatedRate
from hil.recording import parts, read
from hil.recording.read import load
from hil.recording.replay import replay
from hil.session import assembly
from hil.session.build import in_memory
from hil.session.warm_up import warm_up
from tests.support.run_settings import make_job

pytestmark = pytest.mark.xdist_group("campaign")

LENGTH_S = 60.0
SIGMAS = ("sigma_r_m", "sigma_v_mps", "sigma_attitude_rad")
EXACT = (
    "verdict", "thrusters", "stop", "accepted", "passed", "ready_time_s", "ready_phase", "events", "navigation",
    "bench", "latency", "integrity", "orbit",
)  # fmt: skip


def summary_of(folder: Path | None, *settings: str, compiled: bool = True) -> dict[str, Any]:
    job = replace(make_job(LENGTH_S, settings, seed=2), compiled=compiled)
    return runs.run_job(runs.RunRequest(job, "mock", folder)).summary


@pytest.mark.parametrize("settings", [(), ("gnc.abort.at_s=35.0",)], ids=["approach", "abort in the middle"])
def test_numbers_of_a_long_run_are_those_of_its_rows(
    monkeypatch: pytest.MonkeyPatch, settings: tuple[str, ...]
) -> None:
    expected = summary_of(None, *settings)
    monkeypatch.setattr(assembly, "ROWS_MAX", 350)
    found = summary_of(None, *settings)
    for name in EXACT:
        assert found[name] == expected[name], name
    assert found["timing"]["cycles"] == expected["timing"]["cycles"] == LENGTH_S * 50 + 1


def test_recording_in_parts_replays_as_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(assembly, "ROWS_MAX", 350)
    monkeypatch.setattr(parts, "PART_CYCLES", 1000)
    summary_of(tmp_path, "imu.rate_hz=100.0")
    files = sorted(path.name for path in tmp_path.glob("*.mcap"))
    assert len(files) == 4
    assert sum(".part" in name for name in files) == 3
    recorded = load(next(tmp_path / name for name in files if ".part" not in name))
    assert len(recorded.cycles) == LENGTH_S * 50 + 1
    assert recorded.intact
    assert recorded.summary is not None
    assert replay(recorded, recorded.scenario).identical
    monkeypatch.setattr(read, "_AHEAD_ROWS", 300)
    batches = list(read.row_batches(recorded.path, 700))
    assert max(len(batch.cycles) for batch in batches) == 700
    assert np.concatenate([batch.cycles for batch in batches]).tobytes() == recorded.cycles.tobytes()
    for name in ("arrivals", "imu_samples"):
        both = np.concatenate([getattr(batch, name) for batch in batches]), getattr(recorded, name)
        used = [rows[(rows["cycle"] >= 0) & (rows["cycle"] < len(recorded.cycles))] for rows in both]
        assert used[0].tobytes() == used[1].tobytes()


def test_replay_in_batches_is_the_replay_of_all_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    summary_of(tmp_path, "imu.rate_hz=100.0")
    (path,) = tmp_path.glob("*.mcap")
    recorded = load(path)
    monkeypatch.setattr(read, "_AHEAD_ROWS", 300)
    for setting in ((), ("gnc.pkf.accelerometer_noise_mps2=0.002",)):
        whole = recordings._replayed(recorded, None, setting, None)
        parted = recordings._replayed(read.load_without_rows(path), None, setting, read.row_batches(path, 700))
        assert parted[2] == whole[2]
        assert whole[2].identical == (not setting)
        assert parted[3] == whole[3]


def test_later_part_alone_is_rejected(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(parts, "PART_CYCLES", 2000)
    summary_of(tmp_path)
    (later,) = tmp_path.glob("*.part2.mcap")
    with pytest.raises(BadInput, match="part 2 of a recording: open its first part"):
        load(later)


@pytest.mark.parametrize("compiled", [True, False])
def test_ctrl_c_ends_a_run_until_stopped_normally(compiled: bool) -> None:
    calls = [0]

    def press(mode: Mode, _: float) -> None:
        calls[0] += mode is Mode.RUNNING
        if calls[0] == 3:
            raise KeyboardInterrupt

    job = replace(make_job(1.0), until_stopped=True, compiled=compiled)
    found = runs.run_job(runs.RunRequest(job, "mock", on_progress=press))
    assert found.summary["stop"] == "completed"
    assert found.summary["faults"] == []
    assert found.summary["timing"]["cycles"] > 100
    assert np.all(np.diff(found.history["t_s"]) > 0.0)


def test_ctrl_c_ends_a_run_between_two_cycles_so_that_each_recorded_one_counts() -> None:
    job = replace(make_job(1.0), until_stopped=True, compiled=False)
    runner = in_memory(job, SimulatedRate(SimulatedClock(), job.scenario.value.step_s))
    recorded: list[int] = []

    class PressedInTheCycle(NoTelemetry):
        def put(self, row: np.ndarray) -> None:
            recorded.append(len(recorded))
            if len(recorded) == 51:
                signal.raise_signal(signal.SIGINT)

    runner.loop.telemetry = PressedInTheCycle()
    assert runner.run().stop == "completed"
    assert runner.loop.done == len(recorded) == 51


def test_parts_of_a_run_in_real_time_are_evaluated_in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assembly, "ROWS_MAX", 300)
    job = replace(make_job(20.0, speed=2.5), paced=True)  # the computer may pause for a fifth of a second
    warm_up(job)
    found = runs.run_job(runs.RunRequest(job, "mock")).summary
    assert found["stop"] == "completed"
    assert found["timing"]["cycles"] == 1001
    assert sum(entry["cycles"] for entry in found["timing"]["lateness_histogram"]) == 1001
    assert found["verdict"]["security"]["passed"]


AS_MODELLED = ("truth.gravity_degree=0", "gnc.ephemeris.rate_sigma_degps=[0,0,0]")
"""The truth as the filters model it: in hours the rate of H that the GNC lacks exceeds the bound of the attitude."""


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_filters_stay_consistent_for_24_hours() -> None:  # pytest -m slow -k 24_hours, 130 s of processor time
    first = runs.run_job(runs.RunRequest(make_job(600.0, AS_MODELLED, seed=3), "mock"))
    day = runs.run_job(runs.RunRequest(make_job(86_400.0, AS_MODELLED, seed=3), "mock"))
    found = day.summary
    print(f"{found['timing']['cycles']} cycles: {found['navigation']}")  # noqa: T201
    assert (found["stop"], found["faults"], found["alarms"]) == ("completed", [], [])
    assert not [event for event in found["events"] if event["source"] in ("pkf", "akf", "shadow")]
    assert found["navigation"]["nees_pkf"] == pytest.approx(9.0, rel=0.15)
    assert 3.0 < found["navigation"]["nees_akf"] < 12.0  # one run: errors of the gyro's bias last for hours
    for error, bound in (("position_rmse_m", "position_bound_m"), ("attitude_rmse_deg", "attitude_bound_deg")):
        assert np.all(np.array(found["navigation"][error]) < 1.4 * np.array(found["navigation"][bound]))
    sigmas = [[run.history["navigation"][name][-5000:].mean(axis=0) for run in (first, day)] for name in SIGMAS]
    assert sigmas[0][1] == pytest.approx(sigmas[0][0], rel=0.02)
    assert sigmas[1][1] == pytest.approx(sigmas[1][0], rel=0.02)
    assert np.all((sigmas[2][1] > 0.0) & (sigmas[2][1] <= sigmas[2][0]))  # the bias is estimated ever better
