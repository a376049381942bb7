"""Navigation by vision only: low-passed differences of successive poses (bench paper, scheme 3).

The paper does not define how rates come from poses. Here each frame gives a rate as the difference to
the frame before over the time between them; a first-order low-pass of time constant ``rate_lag_s``
smooths it. The pose is propagated between frames with that rate and corrected by each new frame with a
first-order low-pass of time constant ``pose_lag_s``. Neither thrust nor orbital motion is used.

A pose is rejected if it is farther from the propagated one than its noise and the lag of the rates, at the largest
acceleration, explain. After ``close_after`` consecutive rejections one is accepted that as many poses before agree
with, if the chaser can have come there since the last accepted one.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.gnc.integrity import pose_sigmas
from hil.maths import quat, stack
from hil.maths.arrays import copy_into

VISION_ONLY_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("position_lag_s", "f8"),
        ("velocity_lag_s", "f8"),
        ("attitude_lag_s", "f8"),
        ("rate_lag_s", "f8"),
        ("gate", "f8"),  # standard deviations of a pose
        ("acceleration", "f8"),  # m/s^2, largest
        ("angular_acceleration", "f8"),  # rad/s^2, largest
        ("close_after", "i8"),  # consecutive rejections
    ],
    align=True,
)

VISION_ONLY_STATE = np.dtype(
    [
        ("r_CT_H", "f8", 3),
        ("v_CT_H", "f8", 3),
        ("q_CH", "f8", 4),
        ("w_CH_C", "f8", 3),
        ("last_r", "f8", 3),  # the frame before
        ("last_q", "f8", 4),
        ("last_t_s", "f8"),
        ("started", "i8"),
        ("rejected", "i8"),  # by the gate
        ("rejected_in_a_row", "i8"),
        ("mutual", "i8"),  # consecutive rejected poses that agree with the one before
        ("rejected_r", "f8", 3),  # m, in H, the last one
        ("rejected_q", "f8", 4),
    ],
    align=True,
)


@kernel
def _start(pose, state):
    """Start from the first pose, at rest."""
    state.started = 1
    r = stack.vector(3)
    quat.transform_back_into(pose.q_CH, pose.z_TC_C, r)
    for i in range(3):
        state.r_CT_H[i] = -r[i]
        state.last_r[i] = -r[i]
        state.v_CT_H[i] = 0.0
        state.w_CH_C[i] = 0.0
    copy_into(state.q_CH, pose.q_CH)
    copy_into(state.last_q, pose.q_CH)
    state.last_t_s = pose.t_s


@kernel
def continue_from(state, estimate, t_s):
    """Start from ``estimate`` (NAVIGATION), whose last pose was exposed at ``t_s``."""
    state.started = 1
    copy_into(state.r_CT_H, estimate.r_CT_H)
    copy_into(state.last_r, estimate.r_CT_H)
    copy_into(state.v_CT_H, estimate.v_CT_H)
    copy_into(state.w_CH_C, estimate.w_CH_C)
    copy_into(state.q_CH, estimate.q_CH)
    copy_into(state.last_q, estimate.q_CH)
    state.last_t_s = t_s


@kernel
def predict(params, state):
    """Propagate the pose by one step with the smoothed rates."""
    rotation, aside, moved = stack.vector(3), stack.vector(4), stack.vector(4)
    for i in range(3):
        state.r_CT_H[i] += params.dt_s * state.v_CT_H[i]
        rotation[i] = params.dt_s * state.w_CH_C[i]
    quat.from_rotation_vector_into(rotation, aside)
    quat.multiply_into(aside, state.q_CH, moved)
    copy_into(state.q_CH, moved)


@kernel
def _is_within(params, pose, reached_m, reached_rad, off, turned):
    """Return whether a pose is off by no more, ``off`` and ``turned`` (3,), than its noise and the motion explain."""
    sigma, sigma_angle = pose_sigmas(pose)
    sigmas = math.sqrt(2.0) * params.gate  # of the difference of two poses
    for i in range(3):
        if not abs(off[i]) <= sigmas * sigma + reached_m:
            return False
        if not abs(turned[i]) <= sigmas * sigma_angle + reached_rad:
            return False
    return True


@kernel
def _passes(params, state, pose, elapsed_s):
    """Return whether the gate accepts ``pose``, ``elapsed_s`` after the last accepted one; count it if not."""
    off, turned = stack.vector(3), stack.vector(3)
    quat.transform_back_into(pose.q_CH, pose.z_TC_C, off)
    for i in range(3):
        off[i] += state.r_CT_H[i]
    quat.rotation_between(pose.q_CH, state.q_CH, turned)
    lag_m = params.acceleration * params.velocity_lag_s * (params.position_lag_s + elapsed_s)
    lag_rad = params.angular_acceleration * params.rate_lag_s * (params.attitude_lag_s + elapsed_s)
    if state.rejected_in_a_row < params.close_after and _is_within(params, pose, lag_m, lag_rad, off, turned):
        return True
    lag_m += 0.5 * params.acceleration * elapsed_s**2
    lag_rad += 0.5 * params.angular_acceleration * elapsed_s**2
    if state.mutual >= params.close_after and _is_within(params, pose, lag_m, lag_rad, off, turned):
        return True
    for i in range(3):
        off[i] -= state.r_CT_H[i] - state.rejected_r[i]
    quat.rotation_between(pose.q_CH, state.rejected_q, turned)
    agrees = _is_within(params, pose, params.acceleration, params.angular_acceleration, off, turned)
    state.mutual = state.mutual + 1 if agrees and state.rejected_in_a_row > 0 else 0
    quat.transform_back_into(pose.q_CH, pose.z_TC_C, off)
    for i in range(3):
        state.rejected_r[i] = -off[i]
    copy_into(state.rejected_q, pose.q_CH)
    state.rejected += 1
    state.rejected_in_a_row += 1
    return False


@kernel
def update(params, state, pose):
    """Use a pose, the first one as the start; one that is not newer than the last is discarded, one off rejected."""
    if state.started == 0:
        _start(pose, state)
        return
    elapsed = pose.t_s - state.last_t_s
    if not elapsed > 0.0 or not _passes(params, state, pose, elapsed):
        return
    state.rejected_in_a_row = state.mutual = 0
    measured, turned, off = stack.vector(3), stack.vector(3), stack.vector(3)
    aside, moved = stack.vector(4), stack.vector(4)
    quat.transform_back_into(pose.q_CH, pose.z_TC_C, measured)
    quat.rotation_between(pose.q_CH, state.last_q, turned)
    quat.rotation_between(pose.q_CH, state.q_CH, off)
    to_velocity = elapsed / (params.velocity_lag_s + elapsed)
    to_position = elapsed / (params.position_lag_s + elapsed)
    to_rate = elapsed / (params.rate_lag_s + elapsed)
    to_attitude = elapsed / (params.attitude_lag_s + elapsed)
    for i in range(3):
        r = -measured[i]
        state.v_CT_H[i] += to_velocity * ((r - state.last_r[i]) / elapsed - state.v_CT_H[i])
        state.r_CT_H[i] += to_position * (r - state.r_CT_H[i])
        state.w_CH_C[i] += to_rate * (turned[i] / elapsed - state.w_CH_C[i])
        state.last_r[i] = r
        off[i] *= to_attitude
    quat.from_rotation_vector_into(off, aside)
    quat.multiply_into(aside, state.q_CH, moved)
    copy_into(state.q_CH, moved)
    quat.normalise(state.q_CH)
    copy_into(state.last_q, pose.q_CH)
    state.last_t_s = pose.t_s
