"""Between the chaser's pose and what its camera sees."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.rig import Rig
from hil.core.messages import POSE, new
from hil.maths import quat
from hil.sensors.mounting import MOUNTING, camera_pose, chaser_pose
from hil.sensors.vision_unit import parameters as vmu_params

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture
def odd_mounting(rng: np.random.Generator) -> np.record:
    """Return mounting that leave nothing at zero."""
    mounting = new(MOUNTING)
    mounting.camera_position = [0.6, -0.1, 0.2]
    mounting.led_ring_position = [-0.3, 0.2, 0.15]
    mounting.q_vc, mounting.q_th = Rotation.random(2, rng=rng).as_quat()
    return mounting


def see(mounting: np.record, r_CT_H: np.ndarray, q_CH: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    t_v, q_vt = np.empty(3), np.empty(4)
    camera_pose(mounting, r_CT_H, q_CH, t_v, q_vt)
    return t_v, q_vt


def chaser(mounting: np.record, t_v: np.ndarray, q_vt: np.ndarray, covariance: np.ndarray) -> np.record:
    pose = new(POSE)
    chaser_pose(mounting, t_v, q_vt, covariance, pose)
    return pose


def joint(pose: np.record) -> np.ndarray:
    """Return the covariance of position and attitude together, (6, 6)."""
    return np.block(
        [[pose.covariance_position, pose.covariance_cross], [pose.covariance_cross.T, pose.covariance_attitude]]
    )


def turned(q: np.ndarray, e: np.ndarray) -> np.ndarray:
    """Return the quaternion of ``exp([e]x) A(q)``."""
    return quat.multiply(quat.from_rotation_vector(-e), q)


def rotation_between(q: np.ndarray, q_new: np.ndarray) -> np.ndarray:
    """Return the rotation vector e of ``A(q_new) = exp([e]x) A(q)``."""
    return -quat.to_rotation_vector(quat.multiply(q_new, quat.conjugate(q)))


def test_head_on_chaser_sees_the_ring_straight_ahead_and_aligned(mock_rig: Rig) -> None:
    mounting = vmu_params.mounting(mock_rig)
    t_v, q_vt = see(mounting, np.array([5.0, 0.0, 0.0]), IDENTITY)
    np.testing.assert_allclose(t_v, [0.0, 0.0, 5.0 + 0.6], atol=1e-12)
    np.testing.assert_allclose(quat.to_matrix(q_vt), np.eye(3), atol=1e-12)


def test_target_below_and_to_the_left_shows_below_and_to_the_left(mock_rig: Rig) -> None:
    mounting = vmu_params.mounting(mock_rig)
    # the camera looks along -x_c: x_v = -y_c is to its right, y_v = z_c is down
    t_v, _ = see(mounting, np.array([5.0, -0.3, -0.2]), IDENTITY)
    np.testing.assert_allclose(t_v, [-0.3, 0.2, 5.6], atol=1e-12)


def test_camera_pose_maps_points_of_the_ring_to_the_camera(odd_mounting: np.record, rng: np.random.Generator) -> None:
    q_CH, r_CT_H, p_t = Rotation.random(rng=rng).as_quat(), rng.standard_normal(3), rng.standard_normal(3)
    t_v, q_vt = see(odd_mounting, r_CT_H, q_CH)
    in_h = odd_mounting.led_ring_position + quat.to_matrix(odd_mounting.q_th).T @ p_t
    in_c = quat.to_matrix(q_CH) @ (in_h - r_CT_H)
    in_v = quat.to_matrix(odd_mounting.q_vc) @ (in_c - odd_mounting.camera_position)
    np.testing.assert_allclose(quat.to_matrix(q_vt) @ p_t + t_v, in_v, atol=1e-13)


def test_camera_pose_and_chaser_pose_are_inverse(odd_mounting: np.record, rng: np.random.Generator) -> None:
    for _ in range(20):
        q_CH, r_CT_H = Rotation.random(rng=rng).as_quat(), 5.0 * rng.standard_normal(3)
        pose = chaser(odd_mounting, *see(odd_mounting, r_CT_H, q_CH), np.eye(6))
        np.testing.assert_allclose(quat.to_matrix(pose.q_CH), quat.to_matrix(q_CH), atol=1e-13)
        np.testing.assert_allclose(-quat.to_matrix(q_CH).T @ pose.z_TC_C, r_CT_H, atol=1e-12)
        assert np.linalg.norm(pose.q_CH) == pytest.approx(1.0, abs=1e-15)


def test_covariance_propagates_by_the_derivative_of_the_pose(odd_mounting: np.record, rng: np.random.Generator) -> None:
    t_v, q_vt = see(odd_mounting, np.array([3.0, 0.4, -0.5]), Rotation.random(rng=rng).as_quat())
    root = rng.standard_normal((6, 6))
    covariance = 1e-4 * root @ root.T
    pose = chaser(odd_mounting, t_v, q_vt, covariance)
    h = 1e-6
    position, attitude = np.empty((3, 6)), np.empty((3, 6))
    for column in range(6):
        ends = []
        for step in (h, -h):
            d = np.zeros(6)
            d[column] = step
            ends.append(chaser(odd_mounting, t_v + d[:3], turned(q_vt, d[3:]), covariance))
        position[:, column] = (ends[0].z_TC_C - ends[1].z_TC_C) / (2.0 * h)
        attitude[:, column] = rotation_between(ends[1].q_CH, ends[0].q_CH) / (2.0 * h)
    jacobian = np.vstack((position, attitude))
    np.testing.assert_allclose(joint(pose), jacobian @ covariance @ jacobian.T, rtol=1e-7, atol=1e-12)


def test_scatter_of_noisy_poses_matches_their_covariance(odd_mounting: np.record, rng: np.random.Generator) -> None:
    t_v, q_vt = see(odd_mounting, np.array([3.0, 0.4, -0.5]), Rotation.random(rng=rng).as_quat())
    root = rng.standard_normal((6, 6))
    covariance = 1e-6 * root @ root.T
    true = chaser(odd_mounting, t_v, q_vt, covariance)
    noise = rng.standard_normal((4000, 6)) @ np.linalg.cholesky(covariance).T
    seen = [chaser(odd_mounting, t_v + n[:3], turned(q_vt, n[3:]), covariance) for n in noise]
    position = np.array([pose.z_TC_C - true.z_TC_C for pose in seen])
    rotation = np.array([rotation_between(true.q_CH, pose.q_CH) for pose in seen])
    whitened = np.linalg.solve(np.linalg.cholesky(joint(true)), np.hstack((position, rotation)).T)
    np.testing.assert_allclose(whitened @ whitened.T / len(noise), np.eye(6), atol=0.1)


def test_bench_variance_is_added_to_the_reported_covariance(odd_mounting: np.record) -> None:
    t_v, q_vt = see(odd_mounting, np.array([3.0, 0.4, -0.5]), IDENTITY)
    reported = chaser(odd_mounting, t_v, q_vt, 1e-8 * np.eye(6))
    odd_mounting.position_variance, odd_mounting.attitude_variance = 4e-6, 9e-8
    pose = chaser(odd_mounting, t_v, q_vt, 1e-8 * np.eye(6))
    np.testing.assert_allclose(pose.covariance_position - reported.covariance_position, 4e-6 * np.eye(3), atol=1e-18)
    np.testing.assert_allclose(pose.covariance_attitude - reported.covariance_attitude, 9e-8 * np.eye(3), atol=1e-20)
    np.testing.assert_array_equal(pose.covariance_cross, reported.covariance_cross)
