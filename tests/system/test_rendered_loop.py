"""Loop closed through images: rendered from the axis positions, solved by the vision unit's own software."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.core.messages import PoseFrame
from hil.maths import quat
from hil.params import bench as bench_params
from hil.sensors.mounting import camera_pose
from hil.sensors.vision_unit import parameters as vmu_params
from hil.session import build
from hil.session.assembly import start_axes
from hil.session.pose_model import make_pose_sensor
from hil.vmu.geometry import geometry_of_rig
from tests.support.run_settings import make_job

pytestmark = pytest.mark.xdist_group("vision unit")

RENDERED = "vmu.source=rendered"
HALF_WAY = ("initial.position_m=[2.0,-0.1,0.1]", "initial.attitude_deg=[2.0,1.0,-2.0]")


def seen(*settings: str, shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[list[PoseFrame], Any, Any]:
    """Return 20 poses of axes that stand half-way, and the pose t -> v that is true without ``shift_m``."""
    scenario, rig = load_scenario("scheme-1", (RENDERED, *HALF_WAY, *settings)).value, load_rig("mock", settings).value
    sensor = make_pose_sensor(scenario, rig, seed=3)
    axes = start_axes(scenario, rig)
    rails = axes.rail_m + np.array(shift_m)
    poses = [sensor.measure(rails, axes.gimbal_rad, 0.16 * k) for k in range(20)]
    found = [pose for pose in poses if pose is not None]
    t_v, q_vt = np.empty(3), np.empty(4)
    from hil.bench.kinematics import pose_of_axes

    r, q = np.empty(3), np.empty(4)
    pose_of_axes(bench_params.bench(rig, scenario.step_s), axes.rail_m, axes.gimbal_rad, r, q)
    camera_pose(vmu_params.mounting(rig), r, q, t_v, q_vt)
    return found, t_v, q_vt


def test_errors_of_poses_from_images_match_their_covariance() -> None:
    poses, t_v, q_vt = seen()
    assert len(poses) == 20
    squares = []
    for pose in poses:
        turn = -quat.to_rotation_vector(quat.multiply(pose.q_vt, quat.conjugate(q_vt)))
        error = np.concatenate([pose.t_v - t_v, turn])
        squares.append(error @ np.linalg.solve(pose.covariance, error))
        assert math.sqrt(pose.covariance[2, 2]) < 1e-3  # range, at 2.6 m
    assert 3.0 < np.mean(squares) < 10.0  # of 6 degrees of freedom


def test_an_error_of_the_bench_reaches_the_pose() -> None:
    shifted, t_v, _ = seen(shift_m=(0.0, 0.005, 0.0))
    mean = np.mean([pose.t_v for pose in shifted], axis=0) - t_v
    assert mean[0] == pytest.approx(0.005, abs=5e-4)  # the camera stands 5 mm along y_H: the ring that far along -y_c


def believing(path: Path, shift_px: float = 0.0, baseline: float = 1.0) -> str:
    """Write a wrong geometry; return the setting by which the unit uses it."""
    believed = geometry_of_rig(load_rig("mock").value).model_dump(mode="json")
    believed["baseline_m"][0] *= baseline
    for side in ("left", "right"):
        believed[side]["cx"] += shift_px
    path.write_text(json.dumps(believed))
    return f'rig.vmu.geometry_file="{path}"'


def test_a_wrong_calibration_reaches_the_pose(tmp_path: Path) -> None:
    poses, t_v, _ = seen(believing(tmp_path / "believed.json", shift_px=2.0))
    shift_m = np.mean([pose.t_v[0] for pose in poses]) - t_v[0]
    assert shift_m == pytest.approx(-2.0 / 1200.0 * t_v[2], rel=0.1)


def test_a_calibration_that_contradicts_the_led_ring_gives_no_pose(tmp_path: Path) -> None:
    poses, _, _ = seen(believing(tmp_path / "believed.json", baseline=1.01))
    assert poses == []


def test_lights_that_are_no_leds_do_not_mislead() -> None:
    poses, t_v, _ = seen("vmu.images.decoy_lights=5")
    assert len(poses) >= 18
    assert np.abs(np.array([pose.t_v for pose in poses]) - t_v).max() < 5e-3


def test_the_filters_converge_on_poses_from_images() -> None:
    settings = (RENDERED, "initial.position_m=[1.2, -0.05, 0.05]")
    job = make_job(12.0, settings)
    with build.runner(job) as runner:
        history = runner.run().history
    late = history[history["t_s"] > 6.0]
    error = late["navigation"]["r_CT_H"] - late["truth"]["r_CT_H"]
    assert np.sqrt((error**2).mean()) < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["mock", "emulated"])
def test_scheme_1_with_rendered_images_passes_table_iii(rig: str, tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    assert execute(["run", "scheme-1", "--rig", rig, "--set", RENDERED, "--json", str(path)]) == 0
    assert json.loads(path.read_text())["passed"]
