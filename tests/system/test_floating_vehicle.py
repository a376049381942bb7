"""A vehicle that floats on a level floor: its measured pose is the truth, and its thruster lines are the outputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.cli.main import execute
from tests.support.run_settings import typed

pytestmark = pytest.mark.xdist_group("campaign")

LOCK_STEP = {"rig.host.time": "lock_step"}


def test_floating_vehicle_reaches_the_ready_point() -> None:
    run = hil.run("planar-floating", "mock-floating", 1)
    assert run.accepted
    truth = run.history["truth"]
    assert not truth["r_CT_H"][:, 1].any()
    assert not truth["q_CH"][:, [0, 2]].any()
    measured = run.summary["truth"]
    assert measured["measured_by"] == "vmu"
    assert measured["sigma_m"] == pytest.approx(0.0005, rel=0.2)
    assert run.summary["bench"]["unseen_m"] is None


def test_truth_is_the_measured_pose() -> None:
    run = hil.run("planar-floating", "mock-floating", 1, 20.0)
    pose, truth = run.history["pose"], run.history["truth"]
    seen = pose["fresh"] > 0
    behind = np.abs(np.linalg.norm(pose["z_TC_C"][seen], axis=1) - np.linalg.norm(truth["r_CT_H"][seen], axis=1))
    assert behind.max() < 0.003  # a pose is one period old, and its y component is out of the plane


def test_recording_is_replayed_to_the_bit(tmp_path: Path) -> None:
    hil.run("planar-floating", "mock-floating", 1, 10.0, record=tmp_path)
    (recording,) = tmp_path.glob("*.mcap")
    assert execute(["replay", str(recording)]) == 0


def test_lost_poses_stop_the_bench_with_closed_valves() -> None:
    lost = [{"device": "vmu", "kind": "no_pose", "at_s": 3.0, "until_s": 8.0}]
    run = hil.run("planar-floating", "mock-floating", 1, 10.0, faults=lost)
    assert "vmu: measured pose none for" in run.stop
    assert 3.4 < float(run.history["t_s"][-1]) < 3.6


@pytest.mark.parametrize(
    ("scenario", "setting", "text"),
    [
        ("planar", "name='p'", 'truth.relative_motion: "hill": does not go with the floating vehicle'),
        ("planar-floating", "chaser.planar=false", "chaser.planar: false: does not go with the floating vehicle"),
        ("planar-floating", "gnc.navigation.backend='builtin'", "allowed one without an IMU"),
        ("planar-floating", "rig.rails.driver='mock'", ""),
    ],
)
def test_what_does_not_float_is_refused(
    scenario: str, setting: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = execute(["run", scenario, "--rig", "mock-floating", "--duration", "1", *typed(setting)])
    assert (code == 2) == bool(text)
    assert text in " ".join(capsys.readouterr().err.split())


def test_driven_axes_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text('extends = "mock"\nname = "driven"\nbench.gimbal_order = "yxz"\n[floating]\n')
    assert execute(["run", "planar-floating", "--rig", str(rig)]) == 2
    assert "floating: does not go with rails.x, rails.y, rails.z, turntable.roll" in " ".join(
        capsys.readouterr().err.split()
    )


def test_emulated_vehicle_flies_in_lock_step() -> None:
    run = hil.run("planar-floating", "emulated-floating", 1, 2.0, LOCK_STEP)
    assert run.stop == "completed"
    assert len(run.history) == 101
    assert run.summary["bench"]["true_pose_error_mm"]["max"] < 5.0
