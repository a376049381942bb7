"""Tait-Bryan angles of an attitude transformation, any of the six orders of three different axes.

Axes are numbered 0 x, 1 y, 2 z. ``order`` is outer to inner: (2, 1, 0) is yaw, pitch, roll, the
3-2-1 angles of the bench paper, with ``A = A_x(roll) A_y(pitch) A_z(yaw)``. Angles are always
stored by axis: ``angles[0]`` is about x (theta1), ``angles[1]`` about y, ``angles[2]`` about z.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, quat, stack

YAW_PITCH_ROLL = np.array([2, 1, 0])
"""The order of the 3-2-1 angles."""


@kernel
def _axis_quaternion(axis, angle, q):
    """Write the quaternion of a frame rotated by ``angle``, rad, about its axis ``axis`` into ``q`` (4,)."""
    q[0] = q[1] = q[2] = 0.0
    q[axis] = elementary.sin(0.5 * angle)
    q[3] = elementary.cos(0.5 * angle)


@kernel
def axis_quaternion(axis, angle):
    """Return the quaternion of a frame rotated by ``angle``, rad, about its axis ``axis``, shape (4,)."""
    q = np.empty(4)
    _axis_quaternion(axis, angle, q)
    return q


@kernel
def to_quaternion_into(angles, order, q):
    """Write the quaternion of the Tait-Bryan ``angles`` (3,), rad, in ``order`` into ``q`` (4,)."""
    outer, middle, inner, both = stack.vector(4), stack.vector(4), stack.vector(4), stack.vector(4)
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

    For (2, 1, 0) this is bench paper eq. (9) with its third line corrected to
    ``theta3 = atan2(2 (q3 q4 + q1 q2), q1^2 - q2^2 - q3^2 + q4^2)``. The middle angle lies in
    [-pi/2, pi/2]; at its ends the outer angle takes what can be known and the inner one is zero.
    """
    a = stack.matrix(3, 3)
    quat.to_matrix_into(q, a)
    from_matrix_into(a, order, angles)


@kernel
def _angle(y, x):
    """Return ``atan2(y, x)``; if it is small, by a series truncated below 1e-17."""
    if x > 0.0 and abs(y) < 0.1 * x:
        t = y / x
        s = t * t
        series = 1.0 / 9.0 - s * (1.0 / 11.0 - s * (1.0 / 13.0 - s * (1.0 / 15.0)))
        return t * (1.0 - s * (1.0 / 3.0 - s * (1.0 / 5.0 - s * (1.0 / 7.0 - s * series))))
    return elementary.atan2(y, x)


@kernel
def from_matrix_into(a, order, angles):
    """Write the Tait-Bryan angles, rad, of ``a`` (3, 3) in ``order``, by axis, into ``angles`` (3,)."""
    i, j, k = order[0], order[1], order[2]
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    sine = min(1.0, max(-1.0, sign * a[k, i]))
    if abs(sine) < 1.0 - 1e-12:
        angles[i] = _angle(-sign * a[k, j], a[k, k])
        angles[j] = _angle(sine, math.sqrt(a[i, i] * a[i, i] + a[j, i] * a[j, i]))
        angles[k] = _angle(-sign * a[j, i], a[i, i])
    else:
        angles[j] = elementary.asin(sine)
        angles[k] = 0.0
        angles[i] = elementary.atan2(sign * a[j, k], a[j, j])


@kernel
def from_quaternion(q, order):
    """Return the Tait-Bryan angles (3,), rad, of A(q) in ``order``, by axis; see ``from_quaternion_into``."""
    angles = np.empty(3)
    from_quaternion_into(q, order, angles)
    return angles


@kernel
def rate_jacobian_into(angles, order, e):
    """Write E with d(angles by axis)/dt = E @ w, w the body rate in the inner frame, into ``e`` (3, 3)."""
    q, a = stack.vector(4), stack.matrix(3, 3)
    to_quaternion_into(angles, order, q)
    quat.to_matrix_into(q, a)
    rate_jacobian_of_matrix_into(a, order, e)


@kernel
def rate_jacobian_of_matrix_into(a, order, e):
    """Write ``rate_jacobian_into`` of the angles of ``a`` (3, 3).

    Each angle turns about its own gimbal axis; the columns of the inverse are those axes seen from
    the inner frame: column i of ``a``, the middle axis turned by the inner angle, and the inner axis. Singular where
    the middle angle is +-90 deg.
    """
    i, j, k = order[0], order[1], order[2]
    square = a[i, i] * a[i, i] + a[j, i] * a[j, i]  # cos^2 of the middle angle
    cosine = math.sqrt(square)
    e[i, i], e[i, j], e[i, k] = a[i, i] / square, a[j, i] / square, 0.0
    e[j, i], e[j, j], e[j, k] = -a[j, i] / cosine, a[i, i] / cosine, 0.0
    e[k, i], e[k, j], e[k, k] = -a[k, i] * e[i, i], -a[k, i] * e[i, j], 1.0


@kernel
def rate_jacobian(angles, order):
    """Return E (3, 3) with d(angles by axis)/dt = E @ w; see ``rate_jacobian_into``."""
    e = np.empty((3, 3))
    rate_jacobian_into(angles, order, e)
    return e
