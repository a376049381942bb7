"""Error model of the vision unit: each term alone, in the units of its key."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.load import load_rig, load_scenario
from hil.core.messages import VMU_FRAME, PoseFrame, new
from hil.maths import quat
from hil.sensors.mounting import camera_pose
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.errors import VISION_MEMORY
from hil.sensors.vision_unit.model import measure_frame

RATE_HZ = 6.25
AT = np.array([2.0, 0.1, -0.2])
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def frames(*settings: str, exposures: int = 1, at: np.ndarray = AT, seed: int = 5) -> list[PoseFrame]:
    """Return the frames of a unit without white noise that looks at the ring from ``at``."""
    quiet = ("vmu.sigma_position_m=1e-12", "vmu.sigma_angle_deg=1e-12")
    return noisy_frames(*quiet, *settings, exposures=exposures, at=at, seed=seed)


def noisy_frames(*settings: str, exposures: int, at: np.ndarray = AT, seed: int = 5) -> list[PoseFrame]:
    """Return the frames of a unit at ``at``."""
    scenario, rig = load_scenario("scheme-1", settings).value, load_rig("mock").value
    params, memory, frame = vmu_params.model(scenario, seed), new(VISION_MEMORY), new(VMU_FRAME)
    camera, leds = vmu_params.camera(rig)
    noise = np.random.default_rng(seed).standard_normal((exposures, 6))
    found = []
    for k in range(exposures):
        measure_frame(
            params, camera, leds, vmu_params.mounting(rig), at, LEVEL, noise[k], k / RATE_HZ, memory, frame
        )  # fmt: skip
        found.append(PoseFrame.from_record(frame))
    return found


def true_pose(at: np.ndarray = AT) -> tuple[np.ndarray, np.ndarray]:
    """Return the true pose t -> v as vector and rotation matrix."""
    t_v, q_vt = np.empty(3), np.empty(4)
    camera_pose(vmu_params.mounting(load_rig("mock").value), at, LEVEL, t_v, q_vt)
    return t_v, quat.to_matrix(q_vt)


def test_bias_scale_and_misalignment_distort_the_pose_as_configured() -> None:
    (frame,) = frames(
        "vmu.errors.bias_m=[0.01, -0.02, 0.03]",
        "vmu.errors.scale_error=0.02",
        "vmu.errors.misalignment_deg=[0.5, -1.0, 2.0]",
    )
    t_v, r_vt = true_pose()
    turned = Rotation.from_rotvec(np.radians([0.5, -1.0, 2.0])).as_matrix()
    np.testing.assert_allclose(frame.t_v, 1.02 * turned @ t_v + [0.01, -0.02, 0.03], atol=1e-10)
    np.testing.assert_allclose(quat.to_matrix(frame.q_vt), turned @ r_vt, atol=1e-10)


@pytest.mark.parametrize("fraction", [0.3, 1.0])
def test_correlated_noise_keeps_its_variance_and_decays_with_its_time(fraction: float) -> None:
    n = 20_000
    settings = (f"vmu.errors.correlated_fraction={fraction}", "vmu.errors.correlation_time_s=1.6")
    errors = np.array([frame.t_v for frame in noisy_frames(*settings, exposures=n)]) - true_pose()[0]
    sigma = 0.005 * max(1.0, float(np.linalg.norm(AT)) / 2.0)
    unit = errors / sigma
    assert unit.var(axis=0) == pytest.approx(1.0, abs=0.08)
    for lag in (1, 10):
        found = np.mean(unit[lag:] * unit[:-lag])
        assert found == pytest.approx(fraction * math.exp(-lag / RATE_HZ / 1.6), abs=0.04)


def test_outliers_and_misidentified_rings_have_their_fraction_of_the_poses() -> None:
    n = 4000
    settings = (
        "vmu.errors.outlier_probability=0.1",
        "vmu.errors.outlier_size_m=0.4",
        "vmu.errors.misidentified_probability=0.05",
    )
    found = frames(*settings, exposures=n)
    t_v, r_vt = true_pose()
    off = np.array([np.linalg.norm(frame.t_v - t_v) for frame in found])
    turned = np.array(
        [Rotation.from_matrix(r_vt.T @ quat.to_matrix(frame.q_vt)).magnitude() for frame in found]
    ) / math.radians(60.0)
    assert (off > 1e-6).mean() == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(off[off > 1e-6], 0.4, atol=1e-9)
    assert (turned > 1e-6).mean() == pytest.approx(0.05, abs=0.015)
    np.testing.assert_allclose(turned, np.round(turned), atol=1e-6)


def test_pose_is_lost_when_the_ring_leaves_an_image_and_only_then() -> None:
    beside = np.array([2.0, 1.4, 0.0])
    assert not np.isnan(frames()[0].t_v).any()
    assert frames()[0].leds_left == frames()[0].leds_right == 0x3F
    assert np.isnan(frames(at=beside)[0].t_v).all()
    assert not np.isnan(frames("vmu.errors.needs_view=false", at=beside)[0].t_v).any()
    assert np.isnan(frames(at=np.array([-3.0, 0.0, 0.0]))[0].t_v).all()  # behind the camera


def test_errors_are_those_of_their_seed() -> None:
    setting = "vmu.errors.outlier_probability=0.5"
    first, again, other = (frames(setting, exposures=40, seed=seed) for seed in (1, 1, 2))
    assert all((a.t_v == b.t_v).all() for a, b in zip(first, again, strict=True))
    assert any((a.t_v != b.t_v).any() for a, b in zip(first, other, strict=True))
