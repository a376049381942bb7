"""Navigation by vision only: low-passed differences of successive poses (bench paper, scheme 3).

The paper does not define how rates come from poses. Here each frame gives a rate as the difference to
the frame before over the time between them; a first-order low-pass of time constant ``rate_lag_s``
smooths it. The pose is propagated between frames with that rate and corrected by each new frame with a
first-order low-pass of time constant ``pose_lag_s``. Neither thrust nor orbital motion is used.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import copy_into

VISION_ONLY_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("position_lag_s", "f8"),
        ("velocity_lag_s", "f8"),
        ("attitude_lag_s", "f8"),
        ("rate_lag_s", "f8"),
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
    ],
    align=True,
)


@kernel
def _start(pose, state):
    """Start from the first pose, at rest."""
    state.started = 1
    r = quat.transform_back(pose.q_CH, pose.z_TC_C)
    for i in range(3):
        state.r_CT_H[i] = -r[i]
        state.last_r[i] = -r[i]
        state.v_CT_H[i] = 0.0
        state.w_CH_C[i] = 0.0
    copy_into(state.q_CH, pose.q_CH)
    copy_into(state.last_q, pose.q_CH)
    state.last_t_s = pose.t_s


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
def update(params, state, pose):
    """Use a pose, the first one as the start; one that is not newer than the last is discarded."""
    if state.started == 0:
        _start(pose, state)
        return
    elapsed = pose.t_s - state.last_t_s
    if not elapsed > 0.0:
        return
    measured = quat.transform_back(pose.q_CH, pose.z_TC_C)
    turned = quat.to_rotation_vector(quat.multiply(pose.q_CH, quat.conjugate(state.last_q)))
    off = quat.to_rotation_vector(quat.multiply(pose.q_CH, quat.conjugate(state.q_CH)))
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
    copy_into(state.q_CH, quat.multiply(quat.from_rotation_vector(off), state.q_CH))
    quat.normalise(state.q_CH)
    copy_into(state.last_q, pose.q_CH)
    state.last_t_s = pose.t_s
