"""Quaternions, scalar last, as attitude transformations.

``q_CH = [q1 q2 q3 q4]`` takes the components of a vector from H to c: ``A(q_CH) @ v_H = v_c``.
In this convention ``A(p) @ A(q) = A(multiply(p, q))``: letters that touch cancel, as for matrices
(``q_CT = multiply(q_CH, q_HT)``). scipy's matrix of the same four numbers is the transpose of A.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, stack

_NEAR_UNIT: Final = 5e-6
_SMALL_TURN: Final = 0.01
"""rad^2: below it sine, cosine and arc tangent of half the angle are a few terms of their series."""


@kernel
def multiply_into(p, q, out):
    """Write the quaternion of ``A(p) @ A(q)`` into ``out`` (4,), which is neither of them."""
    out[0] = p[3] * q[0] + p[2] * q[1] - p[1] * q[2] + p[0] * q[3]
    out[1] = -p[2] * q[0] + p[3] * q[1] + p[0] * q[2] + p[1] * q[3]
    out[2] = p[1] * q[0] - p[0] * q[1] + p[3] * q[2] + p[2] * q[3]
    out[3] = -p[0] * q[0] - p[1] * q[1] - p[2] * q[2] + p[3] * q[3]


@kernel
def multiply(p, q):
    """Return the quaternion of ``A(p) @ A(q)``, shape (4,)."""
    out = np.empty(4)
    multiply_into(p, q, out)
    return out


@kernel
def conjugate_into(q, out):
    """Write the quaternion of the opposite transformation into ``out`` (4,)."""
    out[0] = -q[0]
    out[1] = -q[1]
    out[2] = -q[2]
    out[3] = q[3]


@kernel
def conjugate(q):
    """Return the quaternion of the opposite transformation, shape (4,)."""
    out = np.empty(4)
    conjugate_into(q, out)
    return out


@kernel
def normalise(q):
    """Scale ``q`` to unit length in place."""
    square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    excess = square - 1.0
    # the root's series is truncated below 1e-16
    scale = 1.0 - excess * (0.5 - 0.375 * excess) if abs(excess) < _NEAR_UNIT else 1.0 / math.sqrt(square)
    for i in range(4):
        q[i] *= scale


@kernel
def keep_turn(k, q):
    """Leave of the rotation ``q`` what turns about axis ``k`` of 0 to 2, in place."""
    for i in range(3):
        if i != k:
            q[i] = 0.0
    normalise(q)


@kernel
def to_matrix_into(q, a):
    """Write A(q) into ``a`` (3, 3), for a unit quaternion."""
    q1, q2, q3, q4 = q[0], q[1], q[2], q[3]
    a[0, 0] = q1 * q1 - q2 * q2 - q3 * q3 + q4 * q4
    a[0, 1] = 2.0 * (q1 * q2 + q3 * q4)
    a[0, 2] = 2.0 * (q1 * q3 - q2 * q4)
    a[1, 0] = 2.0 * (q1 * q2 - q3 * q4)
    a[1, 1] = -q1 * q1 + q2 * q2 - q3 * q3 + q4 * q4
    a[1, 2] = 2.0 * (q2 * q3 + q1 * q4)
    a[2, 0] = 2.0 * (q1 * q3 + q2 * q4)
    a[2, 1] = 2.0 * (q2 * q3 - q1 * q4)
    a[2, 2] = -q1 * q1 - q2 * q2 + q3 * q3 + q4 * q4


@kernel
def second_column_into(q, out):
    """Write the second column of A(q), y seen after the transformation, into ``out`` (3,), for a unit quaternion."""
    q1, q2, q3, q4 = q[0], q[1], q[2], q[3]
    out[0] = 2.0 * (q1 * q2 + q3 * q4)
    out[1] = -q1 * q1 + q2 * q2 - q3 * q3 + q4 * q4
    out[2] = 2.0 * (q2 * q3 - q1 * q4)


@kernel
def to_matrix(q):
    """Return A(q), shape (3, 3), for a unit quaternion."""
    a = np.empty((3, 3))
    to_matrix_into(q, a)
    return a


@kernel
def from_matrix_into(a, q):
    """Write the unit quaternion with A(q) = ``a`` and q4 >= 0 into ``q`` (4,).

    The largest of the four components is found first (Shepperd's method), so no angle is bad.
    """
    trace = a[0, 0] + a[1, 1] + a[2, 2]
    best = 3
    value = trace
    for i in range(3):
        if a[i, i] > value:
            best = i
            value = a[i, i]
    if best == 3:
        s = 2.0 * math.sqrt(max(1.0 + trace, 0.0))
        share = 1.0 / s
        q[3] = 0.25 * s
        q[0] = (a[1, 2] - a[2, 1]) * share
        q[1] = (a[2, 0] - a[0, 2]) * share
        q[2] = (a[0, 1] - a[1, 0]) * share
    else:
        i = best
        j = (i + 1) % 3
        k = (i + 2) % 3
        s = 2.0 * math.sqrt(max(1.0 + a[i, i] - a[j, j] - a[k, k], 0.0))
        share = 1.0 / s
        q[i] = 0.25 * s
        q[j] = (a[i, j] + a[j, i]) * share
        q[k] = (a[i, k] + a[k, i]) * share
        q[3] = (a[j, k] - a[k, j]) * share
    normalise(q)
    if q[3] < 0.0:
        for i in range(4):
            q[i] = -q[i]


@kernel
def from_matrix(a):
    """Return the unit quaternion q with A(q) = ``a`` and q4 >= 0, shape (4,)."""
    q = np.empty(4)
    from_matrix_into(a, q)
    return q


@kernel
def from_rotation_vector_into(phi, q):
    """Write the quaternion of a frame rotated by ``phi`` (3,), rad, into ``q`` (4,): A = exp(-[phi]x)."""
    squared = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if squared < _SMALL_TURN:
        x = 0.25 * squared  # of the half angle; truncated below 1e-17
        scale = 0.5 * (1.0 - x * (1.0 / 6.0 - x * (1.0 / 120.0 - x * (1.0 / 5040.0 - x * (1.0 / 362880.0)))))
        cosine = 1.0 - x * (0.5 - x * (1.0 / 24.0 - x * (1.0 / 720.0 - x * (1.0 / 40320.0))))
    else:
        angle = math.sqrt(squared)
        scale = elementary.sin(0.5 * angle) / angle
        cosine = elementary.cos(0.5 * angle)
    q[0] = scale * phi[0]
    q[1] = scale * phi[1]
    q[2] = scale * phi[2]
    q[3] = cosine


@kernel
def from_rotation_vector(phi):
    """Return the quaternion of a frame rotated by ``phi`` (3,), rad: A = exp(-[phi]x)."""
    q = np.empty(4)
    from_rotation_vector_into(phi, q)
    return q


@kernel
def to_rotation_vector_into(q, phi):
    """Write the shortest rotation vector, rad, with A(q) = exp(-[phi]x) into ``phi`` (3,)."""
    squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
    whole = q[3] * q[3]
    if squared < 0.25 * _SMALL_TURN * whole:
        x = squared / whole  # squared tangent of the half angle; truncated below 1e-16
        series = 1.0 / 5.0 - x * (1.0 / 7.0 - x * (1.0 / 9.0 - x * (1.0 / 11.0)))
        scale = 2.0 / q[3] * (1.0 - x * (1.0 / 3.0 - x * series))
    else:
        sign = 1.0 if q[3] >= 0.0 else -1.0
        norm = math.sqrt(squared)
        scale = 2.0 * sign * elementary.atan2(norm, abs(q[3])) / norm
    phi[0] = scale * q[0]
    phi[1] = scale * q[1]
    phi[2] = scale * q[2]


@kernel
def to_rotation_vector(q):
    """Return the shortest rotation vector phi (3,), rad, with A(q) = exp(-[phi]x)."""
    phi = np.empty(3)
    to_rotation_vector_into(q, phi)
    return phi


@kernel
def transform_into(q, v, out):
    """Write A(q) @ v into ``out`` (3,), which may be ``v``."""
    tx = 2.0 * (q[1] * v[2] - q[2] * v[1])
    ty = 2.0 * (q[2] * v[0] - q[0] * v[2])
    tz = 2.0 * (q[0] * v[1] - q[1] * v[0])
    out[0] = v[0] - q[3] * tx + q[1] * tz - q[2] * ty
    out[1] = v[1] - q[3] * ty + q[2] * tx - q[0] * tz
    out[2] = v[2] - q[3] * tz + q[0] * ty - q[1] * tx


@kernel
def transform(q, v):
    """Return A(q) @ v, shape (3,)."""
    out = np.empty(3)
    transform_into(q, v, out)
    return out


@kernel
def transform_back_into(q, v, out):
    """Write A(q).T @ v into ``out`` (3,), which may be ``v``."""
    tx = 2.0 * (q[1] * v[2] - q[2] * v[1])
    ty = 2.0 * (q[2] * v[0] - q[0] * v[2])
    tz = 2.0 * (q[0] * v[1] - q[1] * v[0])
    out[0] = v[0] + q[3] * tx + q[1] * tz - q[2] * ty
    out[1] = v[1] + q[3] * ty + q[2] * tx - q[0] * tz
    out[2] = v[2] + q[3] * tz + q[0] * ty - q[1] * tx


@kernel
def transform_back(q, v):
    """Return A(q).T @ v, shape (3,)."""
    out = np.empty(3)
    transform_back_into(q, v, out)
    return out


@kernel
def rate_of_change(q, w, out):
    """Write dq/dt (4,) for the body rate ``w`` (3,), rad/s, in body axes (bench paper eq. (3))."""
    out[0] = 0.5 * (w[2] * q[1] - w[1] * q[2] + w[0] * q[3])
    out[1] = 0.5 * (-w[2] * q[0] + w[0] * q[2] + w[1] * q[3])
    out[2] = 0.5 * (w[1] * q[0] - w[0] * q[1] + w[2] * q[3])
    out[3] = 0.5 * (-w[0] * q[0] - w[1] * q[1] - w[2] * q[2])


@kernel
def rotation_between(p, q, phi):
    """Write the shortest rotation vector, rad, from frame ``q`` to frame ``p``, A(p) A(q).T, into ``phi``."""
    back, between = stack.vector(4), stack.vector(4)
    conjugate_into(q, back)
    multiply_into(p, back, between)
    to_rotation_vector_into(between, phi)
