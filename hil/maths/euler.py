"""Tait-Bryan angles of an attitude transformation, any of the six orders of three different axes.

Axes are numbered 0 x, 1 y, 2 z. ``order`` is outer to inner: (2, 1, 0) is yaw, pitch, roll, the
3-2-1 angles of the bench paper, with ``A = A_x(roll) A_y(pitch) A_z(yaw)``. Angles are always
stored by axis: ``angles[0]`` turns about x (theta1), ``angles[1]`` about y, ``angles[2]`` about z.
"""

from __future__ import annotations

import math

import numpy as np

from hil.maths import local, quat
from hil.maths.jit import kernel


@kernel
def _axis_quaternion(axis, angle, q):
    """Write the quaternion of a frame turned by ``angle``, rad, about its axis ``axis`` into ``q`` (4,)."""
    q[0] = q[1] = q[2] = 0.0
    q[axis] = math.sin(0.5 * angle)
    q[3] = math.cos(0.5 * angle)


@kernel
def axis_quaternion(axis, angle):
    """Return the quaternion of a frame turned by ``angle``, rad, about its axis ``axis``, shape (4,)."""
    q = np.empty(4)
    _axis_quaternion(axis, angle, q)
    return q


@kernel
def to_quaternion_into(angles, order, q):
    """Write the quaternion of the Tait-Bryan ``angles`` (3,), rad, in ``order`` into ``q`` (4,)."""
    outer, middle, inner, both = local.vector(4), local.vector(4), local.vector(4), local.vector(4)
    _axis_quaternion(order[0], angles[order[0]], outer)
    _axis_quaternion(order[1], angles[order[1]], middle)
    _axis_quaternion(order[2], angles[order[2]], inner)
    quat.multiply_into(middle, outer, both)
    quat.multiply_into(inner, both, q)


@kernel
def to_quaternion(angles, order):
    """Return the quaternion (4,) of the Tait-Bryan ``angles`` (3,), rad, in ``order``."""
    q = np.empty(4)
    to_quaternion_into(angles, order, q)
    return q


@kernel
def from_quaternion_into(q, order, angles):
    """Write the Tait-Bryan angles, rad, of A(q) in ``order``, by axis, into ``angles`` (3,).

    For (2, 1, 0) this is bench paper eq. (9) with its third line mended to
    ``theta3 = atan2(2 (q3 q4 + q1 q2), q1^2 - q2^2 - q3^2 + q4^2)``. The middle angle lies in
    [-pi/2, pi/2]; at its ends the outer angle takes what can be known and the inner one is zero.
    """
    a = local.matrix(3, 3)
    quat.to_matrix_into(q, a)
    i, j, k = order[0], order[1], order[2]
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    sine = min(1.0, max(-1.0, sign * a[k, i]))
    angles[j] = math.asin(sine)
    if abs(sine) < 1.0 - 1e-12:
        angles[i] = math.atan2(-sign * a[k, j], a[k, k])
        angles[k] = math.atan2(-sign * a[j, i], a[i, i])
    else:
        angles[k] = 0.0
        angles[i] = math.atan2(sign * a[j, k], a[j, j])


@kernel
def from_quaternion(q, order):
    """Return the Tait-Bryan angles (3,), rad, of A(q) in ``order``, by axis; see ``from_quaternion_into``."""
    angles = np.empty(3)
    from_quaternion_into(q, order, angles)
    return angles


@kernel
def rate_jacobian_into(angles, order, e):
    """Write E with d(angles by axis)/dt = E @ w, w the body rate in the inner frame, into ``e`` (3, 3).

    Each angle turns about its own gimbal axis; the columns of the inverse are those axes seen from
    the inner frame. Singular where the middle angle is +-90 deg.
    """
    i, j, k = order[0], order[1], order[2]
    middle, inner = local.vector(4), local.vector(4)
    outer_axis, middle_axis = local.vector(3), local.vector(3)
    _axis_quaternion(j, angles[j], middle)
    _axis_quaternion(k, angles[k], inner)
    for n in range(3):
        outer_axis[n] = 1.0 if n == i else 0.0
        middle_axis[n] = 1.0 if n == j else 0.0
    quat.transform_into(middle, outer_axis, outer_axis)
    quat.transform_into(inner, outer_axis, outer_axis)
    quat.transform_into(inner, middle_axis, middle_axis)
    # outer_axis = (o_i, o_j, o_k), middle_axis = (m_i, m_j, 0) in axes i, j, k; inner axis = (0, 0, 1)
    det = outer_axis[i] * middle_axis[j] - outer_axis[j] * middle_axis[i]
    e[i, k] = e[j, k] = e[k, i] = e[k, j] = 0.0
    e[i, i] = middle_axis[j] / det
    e[i, j] = -middle_axis[i] / det
    e[j, i] = -outer_axis[j] / det
    e[j, j] = outer_axis[i] / det
    e[k, k] = 1.0
    for column in range(3):
        e[k, column] -= outer_axis[k] * e[i, column] + middle_axis[k] * e[j, column]


@kernel
def rate_jacobian(angles, order):
    """Return E (3, 3) with d(angles by axis)/dt = E @ w; see ``rate_jacobian_into``."""
    e = np.empty((3, 3))
    rate_jacobian_into(angles, order, e)
    return e
