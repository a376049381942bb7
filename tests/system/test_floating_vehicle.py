"""A vehicle that floats on a level floor: its measured pose is the truth, and its thruster lines are the outputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.cli.main import execute
from hil.core.clock import SimulatedClock
from hil.drivers.io.mock import MockIo
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.session_parts import SessionParts
from hil.parts.campaigns.outcome import row_of
from hil.parts.campaigns.python_cases import case_runner
from hil.session.assembly import assemble, core_memory, mocks
from tests.support.run_settings import make_job, typed

pytestmark = pytest.mark.xdist_group("campaign")

LOCK_STEP = {"rig.host.time": "lock_step"}
NEAR = {"initial.position_m": [0.7, 0.0, 0.03], "requirements.required_ready_s": 1.0}


def test_floating_vehicle_reaches_the_ready_point() -> None:
    run = hil.run("planar-floating", "mock-floating", 1, 35.0, NEAR)
    assert run.accepted
    truth = run.history["truth"]
    assert not truth["r_CT_H"][:, 1].any()
    assert not truth["q_CH"][:, [0, 2]].any()
    measured = run.summary["truth"]
    assert measured["measured_by"] == "vmu"
    assert 0.0005 <= measured["sigma_m"] < 0.0006
    assert run.summary["bench"]["unseen_m"] is None


def test_truth_is_the_measured_pose() -> None:
    run = hil.run("planar-floating", "mock-floating", 1, 5.0)
    pose, truth = run.history["pose"], run.history["truth"]
    seen = pose["fresh"] > 0
    assert seen.all()
    apart = np.linalg.norm(pose["z_TC_C"], axis=1) - np.linalg.norm(truth["r_CT_H"], axis=1)
    assert np.abs(apart).max() < 1e-5  # but for the y component, which is out of the plane


def test_recording_is_replayed_to_the_bit(tmp_path: Path) -> None:
    hil.run("planar-floating", "mock-floating", 1, 3.0, record=tmp_path)
    (recording,) = tmp_path.glob("*.mcap")
    assert execute(["replay", str(recording)]) == 0


def test_lost_poses_stop_the_bench_with_closed_valves() -> None:
    lost = [{"device": "vmu", "kind": "no_pose", "at_s": 3.0, "until_s": 8.0}]
    run = hil.run("planar-floating", "mock-floating", 1, 10.0, faults=lost)
    assert "vmu: measured pose none for" in run.stop
    assert 3.4 < float(run.history["t_s"][-1]) < 3.6


def test_chaser_that_would_enter_the_keep_out_is_given_an_abort() -> None:
    nearer = [{"device": "vmu", "kind": "offset", "at_s": 24.0, "value": [-0.12, 0.0, 0.0]}]
    run = hil.run("planar-floating", "mock-floating", 1, 30.0, NEAR, faults=nearer)
    assert run.stop == "completed"
    abort = run.summary["verdict"]["security"]["abort"]
    assert (abort["cause"], abort["at_s"]) == ("ordered", pytest.approx(24.0, abs=0.1))
    assert abort["range_at_end_m"] > 0.4
    assert [alarm["code"] for alarm in run.summary["alarms"]][:1] == ["range_to_the_target"]


def test_valves_close_as_soon_as_the_run_ends() -> None:
    job = make_job(1.0, scenario="planar-floating", rig="mock-floating")
    made = mocks(job.truth, job.rig.value, 0, memory := core_memory(job, job.rig.value))
    open_s: list[float] = []
    assert isinstance(made.devices.io, MockIo)
    made.devices.io.fire = lambda on, now_s: open_s.append(now_s) if on.strip(b"\0") else None
    rate = SimulatedRate(SimulatedClock(), job.tick_s)
    assemble(job, job.rig.value, rate, made.devices, SessionParts(), memory).run()
    assert max(open_s) > 0.1
    assert max(open_s) - float(memory.state.zero_s) < 1.0 + 1e-6


def test_campaign_runs_cases() -> None:
    job = make_job(
        30.0, [f"{key}={value}" for key, value in NEAR.items()], scenario="planar-floating", rig="mock-floating"
    )
    runner = case_runner(job.scenario.value, job.rig.value, job.duration_s)
    row = row_of(*runner.run(job.truth, 1), job.scenario.value, job.truth, runner.alarm)
    run = hil.run("planar-floating", "mock-floating", 1, 30.0, NEAR)
    assert row["accepted"]
    assert row["cycles"] == len(run.history)
    assert row["ready_time_s"] == run.summary["ready_time_s"]
    assert row["view_margin_px"] == run.summary["verdict"]["field_of_view"]["margin_px"]


@pytest.mark.parametrize(
    ("scenario", "setting", "text"),
    [
        ("planar", "gnc.navigation.backend='vision_alone'", 'truth.relative_motion: "hill": does not go with the'),
        ("planar-floating", "chaser.planar=false", "chaser.planar: false: does not go with the floating vehicle"),
        ("planar-floating", "gnc.navigation.backend='builtin'", "allowed one without an IMU"),
        ("planar-floating", "rig.bench.geometry_file='bench.toml'", "floating: does not go with bench.errors or"),
        ("planar-floating", "rig.io.thruster_lines=0", "floating: does not go with no thruster lines"),
        ("planar-floating", "rig.bench.gimbal_order='zyx'", 'bench.gimbal_order "zyx", allowed "yxz", "yzx"'),
    ],
)
def test_what_does_not_float_is_refused(
    scenario: str, setting: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["run", scenario, "--rig", "mock-floating", "--duration", "1", *typed(setting)]) == 2
    assert text in " ".join(capsys.readouterr().err.split())


def test_driven_axes_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text('extends = "mock"\nname = "driven"\nbench.gimbal_order = "yxz"\n[floating]\n')
    assert execute(["run", "planar-floating", "--rig", str(rig)]) == 2
    assert "floating: does not go with rails.x, rails.y, rails.z, turntable.roll" in " ".join(
        capsys.readouterr().err.split()
    )


def test_emulated_vehicle_flies_in_lock_step(tmp_path: Path) -> None:
    run = hil.run("planar-floating", "emulated-floating", 1, 2.0, LOCK_STEP, record=tmp_path)
    assert run.stop == "completed"
    assert len(run.history) == 101
    assert run.summary["bench"]["true_pose_error_mm"]["rms"] < 3.0  # the noise of the measured truth
    (recording,) = tmp_path.glob("*.mcap")
    assert execute(["replay", str(recording)]) == 0
