"""Poses of the tracker of a rig, as the measurement of the geometry takes them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.cli.main import execute
from hil.errors import BadInput, DriveFault, LinkLost
from hil.maths import quat
from hil.parts.geometry.tracked import TrackedPoses
from hil.parts.tracker.frames import BodyPose, TrackedFrame
from hil.parts.tracker.measured import MeasuredBodies
from hil.parts.tracker.table import Tracker
from tests.support.run_settings import HARDWARE_WIRES

MOUNTED = {"position_m": (0.1, -0.2, 0.05), "rotation_deg": (10.0, -20.0, 170.0)}
R, Q = np.array([3.0, -0.2, 0.1]), quat.from_rotation_vector(np.radians([2.0, -3.0, 4.0]))


class Stream:
    """Frames of a tracker at 100 Hz, of a chaser at ``R``, ``Q``."""

    def __init__(self, table: Tracker, seed: int = 1) -> None:
        self.failure, self._bodies, self._number = "", MeasuredBodies(table, seed), 0

    def poll(self, now_s: float) -> list[TrackedFrame]:
        self._number += 1
        t_s = 0.01 * self._number
        return [TrackedFrame(t_s, t_s, self._bodies.at(t_s, R, Q))]

    def close(self) -> None:
        pass


def table(**more: object) -> Tracker:
    bodies = {"chaser": {"body": 1, **MOUNTED}, "target": {"body": 2, **MOUNTED}}
    return Tracker.model_validate(
        {"driver": "natnet", "sigma_m": 1e-4, "sigma_deg": 0.01, **bodies, **more}, strict=False
    )


def test_mean_of_its_poses_is_the_pose_of_the_chaser_within_the_noise() -> None:
    observer = TrackedPoses(table(), Stream(table()))
    samples = [pose for _ in range(500) if (pose := observer.sample(0.0)) is not None]
    assert len(samples) == 401  # the first hundred frames measure the target
    off = np.mean(samples, axis=0) - np.concatenate([R, quat.to_rotation_vector(Q)])
    arm = np.linalg.norm(R) * math.radians(0.01) / math.sqrt(100)  # of the target's attitude, which the fit takes
    assert np.abs(off[:3]).max() < 4.0 * (1e-4 / math.sqrt(100) + arm)
    assert np.abs(off[3:]).max() < 4.0 * math.radians(0.01) * (1 / math.sqrt(100) + 1 / math.sqrt(400))
    np.testing.assert_allclose(np.std(samples, axis=0), observer.sigma, rtol=0.2)


def test_target_that_moves_and_a_lost_stream_end_the_measurement() -> None:
    moved = {"faults": [{"at_s": 2.0, "kind": "moved", "of": "target", "value": (0.003, 0.0, 0.0)}]}
    observer = TrackedPoses(table(), Stream(table(**moved)))
    with pytest.raises(DriveFault, match=r"^tracker: the target has moved by [23]\.\d mm since the first pose"):
        [observer.sample(0.0) for _ in range(300)]
    stream = Stream(table())
    stream.failure = "127.0.0.1:1510: no response"
    with pytest.raises(LinkLost, match=r"^tracker: 127"):
        TrackedPoses(table(), stream).sample(0.0)


def test_points_are_no_poses() -> None:
    point = TrackedFrame(0.0, 0.0, {1: BodyPose(R, None)})
    with pytest.raises(BadInput, match=r"tracker\.chaser: the tracker streams a point: geometry needs poses"):
        TrackedPoses(table(), Stream(table())).pose_of(point)


def test_hardware_needs_a_tracker_on_a_wire_and_a_clear_bench(tmp_path, capsys) -> None:
    lab, plan = tmp_path / "lab.toml", tmp_path / "plan.csv"
    lab.write_text(f'extends = "emulated"\nname = "lab"\nkind = "hardware"\nsign_off.waived = true\n{HARDWARE_WIRES}')
    assert execute(["geometry", "plan", "mock", "-o", str(plan), "--poses", "12"]) == 0
    assert "12 poses, too few to determine anything" in capsys.readouterr().out
    command = ["geometry", "measure", str(plan), "--rig", str(lab), "-o", str(tmp_path / "rows.csv")]
    assert execute(command) == 2
    assert "--yes: lab is hardware and its axes will move: clear the bench" in capsys.readouterr().err
    assert execute([*command, "--yes"]) == 2
    assert "rig.tracker: is missing: poses of hardware come from a tracker on a wire" in capsys.readouterr().err
    assert not (tmp_path / "rows.csv").exists()
