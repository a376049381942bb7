"""The chain from the bench's axes to pixels, and its slopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.bench.kinematics import BENCH_PARAMS, pose_of_axes
from hil.config.rig import Rig
from hil.maths import quat
from hil.sensors.mounting import MOUNTING, camera_pose
from hil.vmu.calibration.model import Setup, TurntableModel, project_view
from hil.vmu.geometry import camera_pair
from hil.vmu.kernels import chain
from hil.vmu.kernels.lens import project
from tests.support.calibration_sets import as_made, on_paper

AXES = np.array([2.4, 0.1, -0.2, 0.2, -0.1, 0.15])


@pytest.fixture
def made(mock_rig: Rig) -> Setup:
    """Return a setup off its paper, its small rotations not folded away."""
    setup = as_made(on_paper(mock_rig, True), np.random.default_rng(5), True)
    theta = setup.theta.copy()
    theta[chain.CAMERA_ROTATION : chain.CAMERA_ROTATION + 3] = (0.1, -0.2, 0.3)
    theta[chain.TARGET_ROTATION : chain.TARGET_ROTATION + 3] = (-0.2, 0.1, 0.05)
    theta[chain.SCALE] = 1.02
    return replace(setup, theta=theta)


def test_pixels_agree_with_bench_kinematics_and_mounting(mock_rig: Rig) -> None:
    paper = on_paper(mock_rig, True)
    turntable = TurntableModel.of(mock_rig.bench)
    params, mounting = np.zeros(1, BENCH_PARAMS)[0], np.zeros(1, MOUNTING)[0]
    params["lever_arm"], params["order"] = turntable.lever_arm, turntable.order
    mounting["camera_position"], mounting["led_ring_position"] = (
        mock_rig.bench.camera_position_m,
        mock_rig.bench.led_ring_position_m,
    )
    mounting["q_vc"] = quat.from_matrix(np.array(mock_rig.bench.camera_axes))
    mounting["q_th"] = quat.from_matrix(np.array(mock_rig.bench.led_ring_axes))
    r_CT_H, q_CH, t_v, q_vt = np.empty(3), np.empty(4), np.empty(3), np.empty(4)
    pose_of_axes(params, AXES[:3], AXES[3:], r_CT_H, q_CH)
    camera_pose(mounting, r_CT_H, q_CH, t_v, q_vt)
    from hil.vmu.geometry import geometry_of_rig

    pair = camera_pair(geometry_of_rig(mock_rig))
    seen = project_view(paper, turntable, AXES).pixels
    for camera in range(2):
        for k, led in enumerate(paper.points):
            p = pair.rotation[camera] @ (quat.transform(q_vt, led) + t_v) + pair.translation[camera]
            assert seen[camera, k] == pytest.approx(project(pair.lens[camera], *p), abs=1e-8)


def test_slopes_are_those_of_differences(made: Setup, mock_rig: Rig) -> None:
    turntable = TurntableModel.of(mock_rig.bench)
    slopes, step = project_view(made, turntable, AXES), 1e-6

    def compare(low: Setup, high: Setup, axes: tuple[np.ndarray, np.ndarray], slope: np.ndarray) -> None:
        by_steps = (project_view(high, turntable, axes[1]).pixels - project_view(low, turntable, axes[0]).pixels) / (
            2.0 * step
        )
        assert slope == pytest.approx(by_steps, rel=1e-5, abs=1e-3)

    for k in range(chain.COMMON):
        change = step * np.eye(chain.COMMON)[k]
        low, high = replace(made, theta=made.theta - change), replace(made, theta=made.theta + change)
        compare(low, high, (AXES, AXES), slopes.by_common[..., k])
    for k in range(6):
        change = step * np.eye(6)[k]
        compare(made, made, (AXES - change, AXES + change), slopes.by_axes[..., k])
    for k in range(3):
        change = step * np.eye(3)[k]
        low, high = replace(made, points=made.points - change), replace(made, points=made.points + change)
        compare(low, high, (AXES, AXES), slopes.by_point[..., k])


def test_folding_rotations_into_the_axes_changes_no_pixel(made: Setup, mock_rig: Rig) -> None:
    turntable = TurntableModel.of(mock_rig.bench)
    folded = made.folded()
    assert not folded.theta[chain.CAMERA_ROTATION : chain.CAMERA_ROTATION + 3].any()
    assert project_view(folded, turntable, AXES).pixels == pytest.approx(
        project_view(made, turntable, AXES).pixels, abs=1e-9
    )


def test_a_point_behind_a_camera_has_no_pixel(mock_rig: Rig) -> None:
    paper = on_paper(mock_rig, True)
    behind = AXES * np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    slopes = project_view(paper, TurntableModel.of(mock_rig.bench), behind)
    assert np.isnan(slopes.pixels).all()
    assert not slopes.by_common.any()
