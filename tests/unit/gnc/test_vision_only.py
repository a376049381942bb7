"""Navigation by vision alone: low-passed differences of successive poses."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.scenario import Scenario
from hil.core.messages import POSE, new
from hil.gnc import vision_only
from hil.maths import quat
from hil.params import gnc as gnc_params

FRAME_S = 0.16


@pytest.fixture
def params(scheme_1: Scenario) -> np.record:
    """Return parameters with time constants of a few frames and more."""
    params = gnc_params.navigation(scheme_1).vision_only
    params.position_lag_s, params.velocity_lag_s = 1.0, 6.0
    params.attitude_lag_s, params.rate_lag_s = 0.5, 2.0
    return params


def pose_at(t_s: float, r_CT_H: np.ndarray, q: np.ndarray) -> np.record:
    pose = new(POSE)
    pose.t_s, pose.q_CH, pose.z_TC_C = t_s, q, -quat.to_matrix(q) @ r_CT_H
    return pose


def fly(
    params: np.record,
    state: np.record,
    frames: int,
    r_CT_H: Callable[[float], np.ndarray],
    q_CH: Callable[[float], np.ndarray],
) -> None:
    """Feed noiseless frames of the motion r_CT_H(t), q_CH(t)."""
    vision_only.update(params, state, pose_at(0.0, r_CT_H(0.0), q_CH(0.0)))
    for k in range(1, 8 * frames + 1):
        vision_only.predict(params, state)
        if k % 8 == 0:
            t_s = k * 0.02
            vision_only.update(params, state, pose_at(t_s, r_CT_H(t_s), q_CH(t_s)))


@pytest.mark.parametrize("t_s", [0.0, -3.0, 70.0])
def test_first_pose_starts_it_at_rest_whenever_it_comes(
    params: np.record, rng: np.random.Generator, t_s: float
) -> None:
    q, r, state = Rotation.random(rng=rng).as_quat(), np.array([10.0, -0.5, 0.5]), new(vision_only.VISION_ONLY_STATE)
    vision_only.update(params, state, pose_at(t_s, r, q))
    assert (state.started, state.last_t_s) == (1, t_s)
    np.testing.assert_allclose(state.r_CT_H, r, atol=1e-14)
    np.testing.assert_array_equal(state.q_CH, q)
    np.testing.assert_array_equal([*state.v_CT_H, *state.w_CH_C], 0.0)


def test_steady_motion_is_followed_without_error(params: np.record) -> None:
    v, w = np.array([-0.03, 0.01, 0.02]), np.array([0.004, -0.003, 0.002])
    start = Rotation.from_euler("ZYX", [0.1, -0.1, 0.05])
    state = new(vision_only.VISION_ONLY_STATE)

    def attitude(t: float) -> np.ndarray:
        return (start * Rotation.from_rotvec(w * t)).as_quat()

    fly(params, state, 800, lambda t: np.array([10.0, -0.5, 0.5]) + v * t, attitude)
    end_s = 800 * FRAME_S
    np.testing.assert_allclose(state.v_CT_H, v, atol=1e-9)
    np.testing.assert_allclose(state.w_CH_C, w, atol=1e-9)
    np.testing.assert_allclose(state.r_CT_H, np.array([10.0, -0.5, 0.5]) + v * end_s, atol=1e-8)
    np.testing.assert_allclose(quat.to_matrix(state.q_CH), quat.to_matrix(attitude(end_s)), atol=1e-8)


def test_velocity_answers_a_sudden_start_as_a_first_order_low_pass(params: np.record) -> None:
    state = new(vision_only.VISION_ONLY_STATE)
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    lag, frames = params.velocity_lag_s, 40
    fly(params, state, frames, lambda t: np.array([5.0 - 0.03 * t, 0.0, 0.0]), lambda t: identity)
    left = (lag / (lag + FRAME_S)) ** frames
    assert state.v_CT_H[0] == pytest.approx(-0.03 * (1.0 - left), rel=1e-9)
    assert left == pytest.approx(math.exp(-frames * FRAME_S / lag), rel=0.05)


def test_noise_of_differences_is_smoothed(params: np.record, rng: np.random.Generator) -> None:
    state, identity = new(vision_only.VISION_ONLY_STATE), np.array([0.0, 0.0, 0.0, 1.0])
    found = []
    vision_only.update(params, state, pose_at(0.0, np.array([5.0, 0.0, 0.0]), identity))
    for k in range(1, 2000):
        r = np.array([5.0, 0.0, 0.0]) + 0.005 * rng.standard_normal(3)
        vision_only.update(params, state, pose_at(k * FRAME_S, r, identity))
        found.append(state.v_CT_H.copy())
    g = FRAME_S / (params.velocity_lag_s + FRAME_S)
    # first-order low-pass g of a difference of white noise: variance 2 g^2 / (2 - g) / T^2
    expected = 0.005 / FRAME_S * math.sqrt(2.0 * g * g / (2.0 - g))
    np.testing.assert_allclose(np.std(found[200:], axis=0), expected, rtol=0.15)


def test_frame_that_is_no_newer_is_left_out(params: np.record) -> None:
    state, identity = new(vision_only.VISION_ONLY_STATE), np.array([0.0, 0.0, 0.0, 1.0])
    vision_only.update(params, state, pose_at(1.0, np.array([5.0, 0.0, 0.0]), identity))
    before = state.copy()
    for t_s in (1.0, 0.5, math.nan):
        vision_only.update(params, state, pose_at(t_s, np.array([7.0, 0.0, 0.0]), identity))
    assert state == before


def test_quaternion_keeps_unit_length_between_frames(params: np.record) -> None:
    state = new(vision_only.VISION_ONLY_STATE)
    state.q_CH, state.w_CH_C = [0.0, 0.0, 0.0, 1.0], [0.1, -0.2, 0.3]
    for _ in range(1000):
        vision_only.predict(params, state)
    assert np.linalg.norm(state.q_CH) == pytest.approx(1.0, abs=1e-12)
    expected = Rotation.from_rotvec(20.0 * np.array([0.1, -0.2, 0.3]))
    np.testing.assert_allclose(quat.to_matrix(state.q_CH), expected.as_matrix().T, atol=1e-12)


def noisy(t_s: float, x: float) -> np.record:
    pose = pose_at(t_s, np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    pose.covariance_position, pose.covariance_attitude = 2.5e-5 * np.eye(3), 3e-7 * np.eye(3)
    return pose


def test_pose_beyond_noise_and_lag_is_rejected_and_the_next_good_one_taken(params: np.record) -> None:
    state = new(vision_only.VISION_ONLY_STATE)
    vision_only.update(params, state, noisy(0.0, 5.0))
    vision_only.update(params, state, noisy(0.16, 6.0))
    assert (state.rejected, state.rejected_in_a_row) == (1, 1)
    assert state.r_CT_H[0] == 5.0
    vision_only.update(params, state, noisy(0.32, 5.01))
    assert (state.rejected, state.rejected_in_a_row) == (1, 0)
    assert 5.0 < state.r_CT_H[0] < 5.01


def test_closed_gate_of_vision_alone_opens_for_poses_that_agree_where_the_chaser_can_be(params: np.record) -> None:
    state, limit = new(vision_only.VISION_ONLY_STATE), int(params.close_after)
    vision_only.update(params, state, noisy(0.0, 5.0))
    frames = 0
    while state.rejected_in_a_row > 0 or frames == 0:
        frames += 1
        vision_only.update(params, state, noisy(frames * FRAME_S, 6.0))
        assert frames < 400
    assert frames > limit
    reach_m = 0.5 * params.acceleration * (frames * FRAME_S) ** 2
    assert reach_m + params.acceleration * params.velocity_lag_s * (1.0 + frames * FRAME_S) > 0.9
