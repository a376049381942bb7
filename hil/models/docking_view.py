"""Geometry of the docking camera S and the target C (monitor paper 3.1), exact for finite angles.

C y1 y2 y3: origin in the disc's centre, y3 along the disc's normal towards the camera. S x1 x2 x3: origin in the
camera, x3 along the optical axis, x1 to the right and x2 up in the image. ``y = d + A x`` with
``A = diag(1, -1, -1) exp([phi]x)``, whose first-order form is the paper's matrix; d (3,), m, phi (3,), rad.
Image: ``u = cx + f x1/x3``, ``v = cy - f x2/x3``, px, v downwards, pixel centres at integers.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat


@kernel
def attitude(phi):
    """Return A (3, 3), which transforms directions from S to C."""
    turned = quat.to_matrix(quat.from_rotation_vector(phi))  # exp(-[phi]x)
    a = np.empty((3, 3))
    for j in range(3):
        a[0, j] = turned[j, 0]
        a[1, j] = -turned[j, 1]
        a[2, j] = -turned[j, 2]
    return a


@kernel
def to_camera(a, d, y):
    """Return x = A.T (y - d), shape (3,), m: the point ``y`` (3,), m, of C in the camera's axes."""
    x = np.empty(3)
    for j in range(3):
        x[j] = a[0, j] * (y[0] - d[0]) + a[1, j] * (y[1] - d[1]) + a[2, j] * (y[2] - d[2])
    return x


@kernel
def project_point(f, cx, cy, x):
    """Return (u, v), px, of the point ``x`` (3,), m, in the camera's axes; valid for x[2] > 0."""
    return cx + f * x[0] / x[2], cy - f * x[1] / x[2]


@kernel
def of_camera_pose(t_v, q_vt, d, phi):
    """Write d (3,), m, and phi (3,), rad, for the camera's pose ``p_v = A(q_vt) p_t + t_v`` relative to the LED ring.

    That camera's axes v are S, and C is t rotated by 180 deg about x_t: ``y = diag(1, -1, -1) p_t``.
    """
    back = quat.transform_back(q_vt, t_v)
    turn = quat.to_rotation_vector(q_vt)
    for i in range(3):
        d[i] = -back[i] if i == 0 else back[i]
        phi[i] = turn[i]


@kernel
def to_camera_pose(d, phi, t_v, q_vt):
    """Write the pose t -> v, ``t_v`` (3,), m, and ``q_vt`` (4,), for d (3,), m, and phi (3,), rad.

    The inverse of ``of_camera_pose``.
    """
    back = np.empty(3)
    for i in range(3):
        back[i] = -d[i] if i == 0 else d[i]
    quat.from_rotation_vector_into(phi, q_vt)
    quat.transform_into(q_vt, back, t_v)
