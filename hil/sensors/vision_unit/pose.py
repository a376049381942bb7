"""Poses of the vision unit (POSE) as others take them: filters, bench guard, GNCs elsewhere.

``z_TC_C`` is the target seen from the chaser, in c: the chaser is at ``-A(q_CH).T z_TC_C`` in H.
"""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.core.messages import POSITION_ONLY
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, copy_matrix, fill_matrix
from hil.maths.kalman import is_covariance_3

_UNIT_TOLERANCE = 1e-3  # of the length of a quaternion


@kernel
def write_pose(r_CT_H, q_CH, sigma_m, sigma_rad, pose):
    """Write the pose of a chaser at ``r_CT_H`` (3,), m, with ``q_CH``, and a covariance without correlations."""
    quat.transform_into(q_CH, r_CT_H, pose.z_TC_C)
    copy_into(pose.q_CH, q_CH)
    fill_matrix(pose.covariance_position, 0.0)
    fill_matrix(pose.covariance_attitude, 0.0)
    for i in range(3):
        pose.z_TC_C[i] = -pose.z_TC_C[i]
        pose.covariance_position[i, i], pose.covariance_attitude[i, i] = sigma_m**2, sigma_rad**2


@kernel
def copy_pose(source, factor, target):
    """Copy what the filters need of POSE, with the covariances times ``factor``."""
    copy_into(target.z_TC_C, source.z_TC_C)
    copy_into(target.q_CH, source.q_CH)
    target.t_s, target.status = source.t_s, source.status
    for i in range(3):
        for j in range(3):
            target.covariance_position[i, j] = factor * source.covariance_position[i, j]
            target.covariance_attitude[i, j] = factor * source.covariance_attitude[i, j]


@kernel
def position_in_h(pose, r_CT_H):
    """Write the measured position (3,), m, in H."""
    quat.transform_back_into(pose.q_CH, pose.z_TC_C, r_CT_H)
    for i in range(3):
        r_CT_H[i] = -r_CT_H[i]


@kernel
def largest_sigmas(pose):
    """Return the largest standard deviations of ``pose``: of its position in H, m, and of its attitude, rad.

    Seen from H, an error of the attitude moves the chaser across the line of sight.
    """
    square, position, attitude = 0.0, 0.0, 0.0
    for i in range(3):
        square += pose.z_TC_C[i] ** 2
        position = max(position, pose.covariance_position[i, i])
        attitude = max(attitude, pose.covariance_attitude[i, i])
    return math.sqrt(position + square * attitude), math.sqrt(attitude)


@kernel
def is_measurement(range_max, sigma_max, sigma_angle_max, pose):
    """Return whether ``pose`` can be one: finite, a rotation, within range, with covariances that are some.

    range_max, sigma_max: m. sigma_angle_max: rad.
    """
    square, norm = 0.0, 0.0
    for i in range(3):
        square += pose.z_TC_C[i] ** 2
    for i in range(4):
        norm += pose.q_CH[i] ** 2
    return (
        math.isfinite(pose.t_s)
        and square <= range_max**2
        and abs(norm - 1.0) <= 2.0 * _UNIT_TOLERANCE
        and is_covariance_3(pose.covariance_position, sigma_max)
        and (pose.status == POSITION_ONLY or is_covariance_3(pose.covariance_attitude, sigma_angle_max))
    )


@kernel
def is_repeat(last, pose):
    """Return whether ``pose`` has all digits of ``last`` (POSE)."""
    same = True
    for i in range(3):
        same = same and pose.z_TC_C[i] == last.z_TC_C[i]
    for i in range(4):
        same = same and pose.q_CH[i] == last.q_CH[i]
    return same


@kernel
def deviation(pose, r_CT_H, q_CH, error, variance):
    """Write by how much ``pose`` is off a chaser at ``r_CT_H`` with ``q_CH``, (6,): in c, m, then a rotation, rad.

    variance: (6,), receives the variance that the unit reports of each.
    """
    z, rotation = stack.vector(3), stack.vector(3)
    quat.transform_into(q_CH, r_CT_H, z)
    quat.rotation_between(pose.q_CH, q_CH, rotation)
    for i in range(3):
        error[i], error[3 + i] = pose.z_TC_C[i] + z[i], rotation[i]
        variance[i], variance[3 + i] = pose.covariance_position[i, i], pose.covariance_attitude[i, i]


@kernel
def write_sent(pose, sent):
    """Write ``sent``, a pose as a GNC elsewhere gets it (GNC_POSE), or the fields of it that BACKEND_POSE has too."""
    sent.t_s = pose.t_s
    copy_into(sent.r_TC_C_m, pose.z_TC_C)
    copy_into(sent.q_CH, pose.q_CH)
    copy_matrix(sent.covariance_position_m2, pose.covariance_position)
    copy_matrix(sent.covariance_attitude_rad2, pose.covariance_attitude)


@kernel
def write_all_sent(pose, sent):
    """Write ``sent`` (BACKEND_POSE): as ``write_sent``, with cross covariance and status."""
    write_sent(pose, sent)
    sent.status = pose.status
    copy_matrix(sent.covariance_cross_m_rad, pose.covariance_cross)


@kernel
def read_sent(sent, pose):
    """Write ``pose`` from a BACKEND_POSE."""
    pose.t_s, pose.status = sent.t_s, sent.status
    copy_matrix(pose.covariance_cross, sent.covariance_cross_m_rad)
    copy_into(pose.z_TC_C, sent.r_TC_C_m)
    copy_into(pose.q_CH, sent.q_CH)
    copy_matrix(pose.covariance_position, sent.covariance_position_m2)
    copy_matrix(pose.covariance_attitude, sent.covariance_attitude_rad2)
