"""Mounting of camera and LED ring: the chaser's pose as the camera measures it, and back.

The camera is at ``camera_position`` (in c, from the chaser's reference point) with the axes
``q_vc``, the LED ring at ``led_ring_position`` (in H, from the target's reference point) with ``q_th``.
The camera's pose is ``p_v = A(q_vt) p_t + t_v``.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack

MOUNTING = np.dtype(
    [
        ("camera_position", "f8", 3),  # m, in c
        ("q_vc", "f8", 4),
        ("led_ring_position", "f8", 3),  # m, in H
        ("q_th", "f8", 4),
        ("position_variance", "f8"),  # m^2, of each axis: position error that the bench adds
        ("attitude_variance", "f8"),  # rad^2, about each axis: attitude error that the bench adds
    ],
    align=True,
)


@kernel
def camera_pose(mounting, r_CT_H, q_CH, t_v, q_vt):
    """Write the pose t -> v, ``t_v`` (3,), m, and ``q_vt`` (4,), of a chaser at ``r_CT_H`` with ``q_CH``."""
    target_pose(
        mounting.camera_position, mounting.q_vc, mounting.led_ring_position, mounting.q_th, r_CT_H, q_CH, t_v, q_vt
    )  # fmt: skip


@kernel
def target_pose(camera, q_vc, target, q_th, r_CT_H, q_CH, t_v, q_vt):
    """Write the same of a camera at ``camera`` (3,), in c, and a target at ``target`` (3,), in H, with their axes."""
    target_c, q_ht, q_ct = stack.vector(3), stack.vector(4), stack.vector(4)
    for i in range(3):
        target_c[i] = target[i] - r_CT_H[i]
    quat.transform_into(q_CH, target_c, target_c)
    for i in range(3):
        target_c[i] -= camera[i]
    quat.transform_into(q_vc, target_c, t_v)
    quat.conjugate_into(q_th, q_ht)
    quat.multiply_into(q_CH, q_ht, q_ct)
    quat.multiply_into(q_vc, q_ct, q_vt)


@kernel
def _multiply(a, b, out):
    """Write the matrix product of ``a`` and ``b`` into ``out``, which is neither of them."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            total = 0.0
            for k in range(b.shape[0]):
                total += a[i, k] * b[k, j]
            out[i, j] = total


@kernel
def chaser_pose(mounting, t_v, q_vt, covariance, pose):
    """Write ``pose`` (POSE without t_s, fresh and status) of the chaser from the camera's pose and covariance.

    covariance: (6, 6), P_v, of the error dt_v of t_v and of the small-angle rotation e_v about v's axes,
    ``R_est = exp([e]x) R_true``. With A = A(q_cv), b = A(q_ch) led_ring_position and z = A t_v + camera_position - b,
    the errors in c are, to first order,

        e_c = A e_v,    dz_c = A dt_v - e_c x b = A dt_v + [b]x A e_v,

    so that the joint covariance of (dz_c, e_c) is J P_v J^T with J = [[A, [b]x A], [0, A]]: ``covariance_position``,
    ``covariance_cross`` (rows dz_c, columns e_c) and ``covariance_attitude``. The bench's own error, independent in
    position and attitude and unknown to the vision unit, is added to the two diagonal blocks.
    """
    q_cv, turned = stack.vector(4), stack.vector(4)
    ring_c, arm = stack.vector(3), stack.vector(3)
    a, g, weighted = stack.matrix(3, 3), stack.matrix(3, 6), stack.matrix(3, 6)
    quat.conjugate_into(mounting.q_vc, q_cv)
    quat.multiply_into(q_vt, mounting.q_th, turned)
    quat.multiply_into(q_cv, turned, pose.q_CH)
    # both orders of multiplication keep unit length up to rounding
    quat.normalise(pose.q_CH)
    quat.transform_into(q_cv, t_v, ring_c)
    quat.transform_into(pose.q_CH, mounting.led_ring_position, arm)
    quat.to_matrix_into(q_cv, a)
    for i in range(3):
        pose.z_TC_C[i] = ring_c[i] + mounting.camera_position[i] - arm[i]
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            g[i, m] = a[i, m]
            g[i, 3 + m] = -(a[j, m] * arm[k] - a[k, m] * arm[j])
    _multiply(g, covariance, weighted)
    for i in range(3):
        for j in range(3):
            position = cross = 0.0
            for n in range(6):
                position += weighted[i, n] * g[j, n]
            for n in range(3):
                cross += weighted[i, 3 + n] * a[j, n]
            pose.covariance_position[i, j], pose.covariance_cross[i, j] = position, cross
    _multiply(a, covariance[3:, 3:], weighted[:, :3])
    for i in range(3):
        for j in range(3):
            attitude = 0.0
            for n in range(3):
                attitude += weighted[i, n] * a[j, n]
            pose.covariance_attitude[i, j] = attitude
        pose.covariance_position[i, i] += mounting.position_variance
        pose.covariance_attitude[i, i] += mounting.attitude_variance
