"""Docking monitor of a run: its process sees what a replay of the recording sees, and its end ends nothing else."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario, load_scene
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.camera_images import IMAGE, overlay_shapes
from hil.core.gnc_records import GncHealth
from hil.core.messages import CYCLE
from hil.errors import LinkLost
from hil.frmn.ring import Reader, Ring
from hil.frmn.search_region import SearchRegion
from hil.parts.monitor.report import judge_monitor, monitor_section
from hil.parts.monitor.results import PORTION
from hil.parts.monitor.setup import MonitorOutcome, MonitorProcess, MonitorRings, monitor_recorded
from hil.session import build
from tests.support.run_settings import UNHURRIED, make_job, typed

pytestmark = pytest.mark.xdist_group("docking monitor")

SETTINGS = ("monitor.source=rendered",)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("scheme-1", SETTINGS).value


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("mock").value


@pytest.fixture(scope="module")
def history() -> np.ndarray:
    """Return six seconds of scheme-1 on mocks."""
    job = make_job(6.0)
    with build.runner(job) as runner:
        return runner.run().history


@pytest.fixture(scope="module")
def recorded(scenario: Scenario, rig: Rig, history: np.ndarray) -> MonitorOutcome:
    """Return what the monitor sees in them."""
    return monitor_recorded(scenario, load_scene("atv").value, rig, 0, history)


def test_the_process_sees_what_a_watch_of_the_recording_sees(
    scenario: Scenario, rig: Rig, history: np.ndarray, recorded: MonitorOutcome
) -> None:
    ring, pictures, portions = Ring.create(CYCLE, 2048), Ring.create(IMAGE, 16), Ring.create(PORTION, 16)
    try:
        with MonitorProcess(
            scenario, load_scene("atv").value, rig, 0, MonitorRings(ring, pictures, portions)
        ) as process:
            process.wait_ready()
            for row in history[:, None]:
                ring.put(row)
            live = process.finish()
        shown, told = pictures.reader().read(), portions.reader().read()
    finally:
        for each in (ring, pictures, portions):
            each.close()
    assert [row["number"] for row in shown] == list(range(0, 76, 7))  # 12.5 a second, two wanted
    assert {(row["camera"], row["encoding"], row["status"]) for row in shown} == {(b"monitor", b"jpeg", b"near")}
    assert all(len(overlay_shapes(row)) > 50 for row in shown)
    assert [row["range_m"] for row in told] == [portion.value("range_m") for portion in live.portions]
    assert live.missed_rows == 0
    assert (live.frames, len(live.portions)) == (recorded.frames, len(recorded.portions)) == (76, 8)
    for here, there in zip(live.portions, recorded.portions, strict=True):
        assert (here.t_s, here.frames, here.status) == (there.t_s, there.frames, there.status)
        np.testing.assert_array_equal(here.values, there.values)
        np.testing.assert_array_equal(here.sigmas, there.sigmas)


def test_the_process_searches_the_operators_region_and_shows_it(
    scenario: Scenario, rig: Rig, history: np.ndarray
) -> None:
    ring, pictures, search = Ring.create(CYCLE, 2048), Ring.create(IMAGE, 16), SearchRegion()
    search.set((0, 0, 120, 90))
    try:
        with MonitorProcess(
            scenario, load_scene("atv").value, rig, 0, MonitorRings(ring, pictures), search=search
        ) as process:
            process.wait_ready()
            ring.put(history[:1])
            ring.put(history[50:51])
            reader = pictures.reader()
            first = _next(reader)
            search.set(None)
            for row in history[51:150, None]:
                ring.put(row)
            process.finish()
        later = reader.read()
    finally:
        for each in (ring, pictures, search):
            each.close()
    assert first["status"] == b"no_target"
    frame = [shape["from"] for shape in overlay_shapes(first) if shape["part"] == "search"]
    assert frame == [[0.0, 0.0], [120.0, 0.0], [120.0, 90.0], [0.0, 90.0]]
    assert later["status"][-1] == b"near"
    assert not any(shape["part"] == "search" for shape in overlay_shapes(later[-1]))


def _next(reader: Reader) -> np.void:
    """Return the next row of ``reader``."""
    end_s = time.monotonic() + 60.0
    while True:
        for row in reader.read():
            found: np.void = row
            return found
        assert time.monotonic() < end_s, "no row"
        time.sleep(0.02)


def test_monitor_that_dies_is_reported_by_name(scenario: Scenario, rig: Rig) -> None:
    ring = Ring.create(CYCLE, 64)
    try:
        with MonitorProcess(scenario, load_scene("atv").value, rig, 0, MonitorRings(ring)) as process:
            process.wait_ready()
            process.close()
            with pytest.raises(LinkLost, match=r"^docking monitor: was ended by SIGKILL without a result$"):
                process.finish()
    finally:
        ring.close()


def test_monitor_vision_unit_and_truth_agree_in_their_sigmas(
    scenario: Scenario, rig: Rig, history: np.ndarray, recorded: MonitorOutcome
) -> None:
    found = judge_monitor(recorded, history, scenario, rig)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["status"] == {"near": 8}
    assert found["longest_gap_s"] <= 1.0
    for name, figures in found["quantities"].items():
        if name != "range_rate_mps":
            assert figures["bench"]["most_sigmas"] < 4.5, name
            assert figures["vmu"]["most_sigmas"] < 4.5, name
            assert figures["monitor_minus_vmu"]["most_sigmas"] < 4.5, name
    assert found["quantities"]["range_rate_mps"]["vmu"] is None
    assert found["quantities"]["range_m"]["truth"]["rms"] < 2e-3
    # a thruster that fires within a portion changes the rate by more than its sigma; see docs/how-to/docking-monitor.md
    assert found["quantities"]["range_rate_mps"]["truth"]["rms"] < 2e-3
    assert monitor_section(found).text()[0].startswith("Monitor     atv: 76 frames")


def test_wrong_mounting_shows_as_many_sigmas(
    scenario: Scenario, rig: Rig, history: np.ndarray, recorded: MonitorOutcome
) -> None:
    moved = scenario.monitor.model_copy(update={"camera_position_m": (0.82, 0.0, -0.5)})
    found = judge_monitor(recorded, history, scenario.model_copy(update={"monitor": moved}), rig)
    assert found["quantities"]["range_m"]["truth"]["rms"] == pytest.approx(0.02, rel=0.1)
    assert found["quantities"]["range_m"]["truth"]["share_in_2_sigma"] == 0.0


def test_a_run_that_ended_before_its_first_cycle_has_nothing_to_compare(scenario: Scenario, rig: Rig) -> None:
    found = judge_monitor(MonitorOutcome("atv"), np.zeros(0, CYCLE), scenario, rig)
    assert (found["frames"], found["portions"], found["longest_gap_s"]) == (0, 0, None)
    assert all(each is None for figures in found["quantities"].values() for each in figures.values())
    assert len(monitor_section(found).text()) > 2


def test_run_without_monitor_has_none(rig: Rig) -> None:
    job = make_job(0.1)
    with build.runner(job) as runner:
        assert runner.parts.results_of(runner.run()) == []


WRONG = 'faults=[{device = "monitor", kind = "offset", at_s = 4.0, value = [0.2, 0.0, 0.0]}]'
"""The docking monitor measures a chaser that is displaced."""


def test_rendered_monitor_that_disagrees_holds_the_approach_and_raises_an_alarm() -> None:
    job = make_job(8.0, (*SETTINGS, WRONG))
    with build.runner(job) as runner:
        outcome = runner.run()
        (found,) = runner.parts.results_of(outcome)
    assert found.table == "monitor"
    assert found.numbers["portions"] == len(found.rows["portions"]) == 11
    (held,) = [event for event in outcome.events if "the docking monitor disagrees" in event.text]
    assert held.text == "reaction hold: the docking monitor disagrees"
    assert 4.8 < held.t_s < 6.5  # two portions that were measured after the onset
    (alarm,) = outcome.alarms
    assert (alarm.device, alarm.priority) == ("monitor", "medium")
    assert outcome.history["navigation"]["health"][-1] == GncHealth.MONITOR_DISAGREES


def test_run_command_reports_the_monitor(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    arguments = ["run", "scheme-1", "--duration", "2", "--set", "monitor.source=rendered", "--json", str(path)]
    done = subprocess.run(
        [sys.executable, "-m", "hil", *arguments], capture_output=True, text=True, check=False, timeout=280
    )
    assert done.returncode == 1, done.stderr  # two seconds are not enough to be ready
    assert "Monitor     atv: 26 frames" in done.stdout
    assert json.loads(path.read_text(encoding="utf-8"))["monitor"]["status"] == {"near": 3}


def test_run_command_refuses_a_scene_that_is_not_there() -> None:
    settings = ["--set", "monitor.source=rendered", "--set", "monitor.scene=missing"]
    done = subprocess.run(
        [sys.executable, "-m", "hil", "run", "scheme-1", *settings],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 2
    assert "missing: unknown scene: give atv, bright-cross" in done.stderr


@pytest.mark.wires
@pytest.mark.slow
def test_monitor_of_an_emulated_bench_holds_the_approach(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    arguments = ["run", "scheme-1", "--rig", "emulated", "--duration", "12", "--json", str(path)]
    done = subprocess.run(
        [sys.executable, "-m", "hil", *arguments, *typed("monitor.source=rendered", WRONG, *UNHURRIED)],
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert done.returncode == 1, done.stderr
    (fault,) = json.loads(path.read_text(encoding="utf-8"))["injected"]
    assert (fault["detected_by"], fault["reaction"]) == ("monitor", "hold")


@pytest.mark.wires
@pytest.mark.slow
def test_monitor_of_an_emulated_bench_agrees_with_the_encoders(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    arguments = ["run", "scheme-1", "--rig", "emulated", "--duration", "20", "--json", str(path)]
    done = subprocess.run(
        [sys.executable, "-m", "hil", *arguments, *typed("monitor.source=rendered", *UNHURRIED)],
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert done.returncode == 1, done.stderr
    found = json.loads(path.read_text(encoding="utf-8"))["monitor"]
    assert (found["missed_rows"], found["failure"]) == (0, "")
    assert found["status"]["near"] == sum(found["status"].values()) >= 24
    assert found["longest_gap_s"] <= 1.0
    for name in ("range_m", "phi1_rad", "phi2_rad", "phi3_rad", "d1_m", "d2_m"):
        assert found["quantities"][name]["bench"]["share_in_2_sigma"] >= 0.8, name
