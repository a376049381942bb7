"""Pose of the chaser in the lab to three rail positions and three gimbal angles, and back.

The lab frame L is parallel to H with its origin at the target's reference point. The rails carry the
turntable's rotation centre; the point that plays the chaser's reference point sits ``lever_arm`` (in
c) away from it, so the carriage goes to ``r_CT_L - R_LC lever_arm``.
"""

from __future__ import annotations

import numpy as np

from hil.maths import euler, quat
from hil.maths.arrays import copy_into
from hil.maths.jit import kernel

BENCH_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("lever_arm", "f8", 3),  # m, in c
        ("order", "i8", 3),  # gimbals outer to inner, 0 roll, 1 pitch, 2 yaw
        ("low", "f8", 6),  # rails x y z in m, gimbals roll pitch yaw in rad
        ("high", "f8", 6),
        ("rate_max", "f8", 6),
        ("acceleration_max", "f8", 6),
    ],
    align=True,
)


@kernel
def axes_of_pose(params, r_CT_H, v_CT_H, q_CH, w_CH_C, axes):
    """Write ``axes`` (AXES): positions and rates that put the chaser's reference point at this pose."""
    arm = quat.transform_back(q_CH, params.lever_arm)
    turning = np.empty(3)
    turning[0] = w_CH_C[1] * params.lever_arm[2] - w_CH_C[2] * params.lever_arm[1]
    turning[1] = w_CH_C[2] * params.lever_arm[0] - w_CH_C[0] * params.lever_arm[2]
    turning[2] = w_CH_C[0] * params.lever_arm[1] - w_CH_C[1] * params.lever_arm[0]
    arm_rate = quat.transform_back(q_CH, turning)
    angles = euler.from_quaternion(q_CH, params.order)
    jacobian = euler.rate_jacobian(angles, params.order)
    for i in range(3):
        axes.rail_m[i] = r_CT_H[i] - arm[i]
        axes.rail_mps[i] = v_CT_H[i] - arm_rate[i]
        axes.gimbal_rad[i] = angles[i]
        axes.gimbal_radps[i] = 0.0
        for j in range(3):
            axes.gimbal_radps[i] += jacobian[i, j] * w_CH_C[j]


@kernel
def pose_of_axes(params, rail_m, gimbal_rad, r_CT_H, q_CH):
    """Write the pose ``r_CT_H`` (3,), m, ``q_CH`` (4,) of a bench whose axes stand at the given positions."""
    copy_into(q_CH, euler.to_quaternion(gimbal_rad, params.order))
    arm = quat.transform_back(q_CH, params.lever_arm)
    for i in range(3):
        r_CT_H[i] = rail_m[i] + arm[i]


@kernel
def limit_setpoint(params, before, wanted, out):
    """Write ``out`` (AXES): the setpoint nearest to ``wanted`` that travel, speed and acceleration allow.

    before: the setpoint of the step before. Returns the number of axes that were limited.
    """
    limited = 0
    for axis in range(6):
        i = axis % 3
        if axis < 3:
            position, target, rate = before.rail_m[i], wanted.rail_m[i], before.rail_mps[i]
        else:
            position, target, rate = before.gimbal_rad[i], wanted.gimbal_rad[i], before.gimbal_radps[i]
        target = min(params.high[axis], max(params.low[axis], target))
        step = (target - position) / params.dt_s
        change = params.acceleration_max[axis] * params.dt_s
        allowed = min(rate + change, max(rate - change, step))
        allowed = min(params.rate_max[axis], max(-params.rate_max[axis], allowed))
        position += allowed * params.dt_s
        position = min(params.high[axis], max(params.low[axis], position))
        wanted_position = wanted.rail_m[i] if axis < 3 else wanted.gimbal_rad[i]
        # an unlimited axis takes the wanted numbers as they are, to the last bit
        if abs(position - wanted_position) <= 1e-12:
            position = wanted_position
            rate_out = wanted.rail_mps[i] if axis < 3 else wanted.gimbal_radps[i]
        else:
            limited += 1
            rate_out = allowed
        if axis < 3:
            out.rail_m[i] = position
            out.rail_mps[i] = rate_out
        else:
            out.gimbal_rad[i] = position
            out.gimbal_radps[i] = rate_out
    return limited


@kernel
def largest_difference(setpoint, feedback, out):
    """Write the largest |setpoint - feedback| of rails, m, and of gimbals, rad, and their axes into ``out`` (4,)."""
    for i in range(4):
        out[i] = 0.0
    for i in range(3):
        rail = abs(setpoint.rail_m[i] - feedback.rail_m[i])
        gimbal = abs(setpoint.gimbal_rad[i] - feedback.gimbal_rad[i])
        # "not <=" also catches nan
        if not rail <= out[0]:
            out[0] = rail
            out[1] = i
        if not gimbal <= out[2]:
            out[2] = gimbal
            out[3] = i


@kernel
def write_axes(rail_m, rail_mps, gimbal_rad, gimbal_radps, out):
    """Write the four arrays (3,) into ``out`` (AXES)."""
    for i in range(3):
        out.rail_m[i] = rail_m[i]
        out.rail_mps[i] = rail_mps[i]
        out.gimbal_rad[i] = gimbal_rad[i]
        out.gimbal_radps[i] = gimbal_radps[i]
