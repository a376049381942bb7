"""Errors of the machine's geometry: pose of a bench whose rails and gimbals are not ideal, and axes that compensate it.

Each rail has a displacement and a small rotation of its carriage, Legendre polynomials of its travel, and displaces all
that it carries; rails are not square, gimbal axes do not meet and are not orthogonal. Zero offsets, lever arm and the
pose of the rails in L act as they are, all other rotations to first order: of 1 mrad each the sum is off by some 1e-6.
What may be wrong of a bench: ``hil.config.tables.machine``.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import euler, quat, stack
from hil.maths.arrays import copy_into, cross_into, fill

GEOMETRY = np.dtype(
    [
        ("enabled", "i8"),  # 0: an ideal machine
        ("carries", "f8", (3, 3)),  # 1: the rail of the row carries that of the column
        ("centre", "f8", 3),  # m, of the travel of each rail
        ("inverse", "f8", 3),  # 1/m, of half of it; 0 for a fixed rail
        ("rail", "f8", (3, 3, 6)),  # P1, P2, P3 of the displacement x y z, m, and rotation, rad, of each carriage
        ("squareness", "f8", 3),  # rad, more than 90 deg between x and y, y and z, z and x
        ("zero", "f8", 3),  # rad, added to the encoders of roll, pitch, yaw
        ("turntable_tilt", "f8", 3),  # rad, of the outer gimbal's axis
        ("outer", "f8", 3),  # unit vector of the outer axis
        ("sign", "f8"),  # 1: outer, middle and inner axis are right-handed; else -1, also of what is below
        ("middle_tilt", "f8"),  # rad, outer and middle axis are not orthogonal
        ("middle_offset", "f8"),  # m, of the middle axis from the outer one
        ("inner_tilt", "f8"),  # rad, middle and inner axis
        ("inner_offset", "f8", 2),  # m, of the inner axis from the middle one, and along that
        ("reference_tilt", "f8", 3),  # rad, of c on the inner gimbal
        ("arm", "f8", 3),  # m, lever arm in c
        ("base", "f8", 3),  # m, origin of the rails in L
        ("q_base", "f8", 4),  # L to the rails' axes
    ],
    align=True,
)

_SMALL = 1.6e-5  # product of error and correction, m and rad, up to which the correction is of first order
_ITERATIONS = 5
_POLE = 1e-9  # least cosine of the middle angle


@kernel
def _add_cross(a, b, out):
    """Add the cross product of ``a`` and ``b`` (3,) to ``out`` (3,)."""
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@kernel
def _at(rail, i, m, t, p2, p3):
    """Return component ``m`` of what rail ``i`` does to its carriage."""
    return rail[i, 0, m] * t + rail[i, 1, m] * p2 + rail[i, 2, m] * p3


@kernel
def _deviation(g, order, rail_m, a, arm, shift, turn):
    """Write by how much the chaser is displaced, ``shift`` (3,), m, and rotated, ``turn`` (3,), rad, in rails' axes.

    a: (3, 3), attitude of the gimbals, zero offsets included. arm: (3,), m, from their centre.
    """
    x, y, z = rail_m[0], rail_m[1], rail_m[2]
    s_x, s_y, s_z = -g.squareness[0] * y - g.squareness[2] * z, -g.squareness[1] * z, 0.0
    t_x, t_y, t_z = g.turntable_tilt[0], g.turntable_tilt[1], g.turntable_tilt[2]
    for i in range(3):
        t = (rail_m[i] - g.centre[i]) * g.inverse[i]
        p2, p3 = 1.5 * t * t - 0.5, (2.5 * t * t - 1.5) * t
        u, v, w = g.carries[i, 0] * x, g.carries[i, 1] * y, g.carries[i, 2] * z
        r_x, r_y, r_z = (
            _at(g.rail, i, 3, t, p2, p3),
            _at(g.rail, i, 4, t, p2, p3),
            _at(g.rail, i, 5, t, p2, p3),
        )
        s_x += _at(g.rail, i, 0, t, p2, p3) + r_y * w - r_z * v
        s_y += _at(g.rail, i, 1, t, p2, p3) + r_z * u - r_x * w
        s_z += _at(g.rail, i, 2, t, p2, p3) + r_x * v - r_y * u
        t_x, t_y, t_z = t_x + r_x, t_y + r_y, t_z + r_z
    # unit vectors: the inner axis, the middle one, and those at right angles to outer and middle, middle and inner one
    n = order[2]
    inner, outer = a[n], g.outer
    middle, across, third = stack.vector(3), stack.vector(3), stack.vector(3)
    cross_into(inner, outer, middle)
    size = g.sign / max(_POLE, math.sqrt(middle[0] * middle[0] + middle[1] * middle[1] + middle[2] * middle[2]))
    for m in range(3):
        middle[m] *= size
    cross_into(outer, middle, across)
    cross_into(middle, inner, third)
    for m in range(3):
        shift[m] = g.middle_offset * across[m] + g.inner_offset[0] * third[m] + g.inner_offset[1] * middle[m]
        turn[m] = g.middle_tilt * across[m] + g.inner_tilt * third[m]
        turn[m] += a[0, m] * g.reference_tilt[0] + a[1, m] * g.reference_tilt[1] + a[2, m] * g.reference_tilt[2]
    turn[0] += t_x
    turn[1] += t_y
    turn[2] += t_z
    shift[0] += s_x + turn[1] * arm[2] - turn[2] * arm[1]
    shift[1] += s_y + turn[2] * arm[0] - turn[0] * arm[2]
    shift[2] += s_z + turn[0] * arm[1] - turn[1] * arm[0]


@kernel
def machine_pose(g, order, rail_m, gimbal_rad, r_L, q_CL):
    """Write the pose ``r_L`` (3,), m, ``q_CL`` (4,) of the chaser in L with the encoders at the given positions."""
    angles, near, small, a = stack.vector(3), stack.vector(4), stack.vector(4), stack.matrix(3, 3)
    arm, shift, turn = stack.vector(3), stack.vector(3), stack.vector(3)
    for i in range(3):
        angles[i] = gimbal_rad[i] + g.zero[i]
    euler.to_quaternion_into(angles, order, near)
    quat.to_matrix_into(near, a)
    quat.transform_back_into(near, g.arm, arm)
    _deviation(g, order, rail_m, a, arm, shift, turn)
    for i in range(3):
        r_L[i] = rail_m[i] + arm[i] + shift[i]
    quat.transform_back_into(g.q_base, r_L, r_L)
    for i in range(3):
        r_L[i] += g.base[i]
    quat.from_rotation_vector_into(turn, small)
    both = stack.vector(4)
    quat.multiply_into(near, small, both)
    quat.multiply_into(both, g.q_base, q_CL)


@kernel
def to_rails(g, r, v, q):
    """Take position and velocity (3,) in L, and the attitude ``q`` (4,) against L, to the rails' axes, in place."""
    back, q_L = stack.vector(4), stack.vector(4)
    for i in range(3):
        r[i] -= g.base[i]
    quat.transform_into(g.q_base, r, r)
    quat.transform_into(g.q_base, v, v)
    copy_into(q_L, q)
    quat.conjugate_into(g.q_base, back)
    quat.multiply_into(q_L, back, q)


@kernel
def compensate(g, order, r, q, a, arm, jacobian, axes):
    """Correct the positions of ``axes`` (AXES), those of an ideal machine at this pose in rails' axes.

    a: (3, 3) and arm: (3,), of ``q``, and jacobian: (3, 3), ``euler.rate_jacobian_of_matrix_into``; overwritten.

    Errors of 4 mm or 4 mrad are corrected to first order, within their square; of larger ones the place at which they
    are taken is iterated first. r: (3,), m. q: (4,).
    """
    near, small, shift, turn = stack.vector(4), stack.vector(4), stack.vector(3), stack.vector(3)
    known_shift, known_turn, step = stack.vector(3), stack.vector(3), stack.vector(3)
    fill(known_shift, 0.0)
    fill(known_turn, 0.0)
    copy_into(near, q)
    for _ in range(_ITERATIONS):
        _deviation(g, order, axes.rail_m, a, arm, shift, turn)
        size, change = 0.0, 0.0
        for i in range(3):
            size = max(size, abs(shift[i]), abs(turn[i]))
            change = max(change, abs(shift[i] - known_shift[i]), abs(turn[i] - known_turn[i]))
        if not size * change > _SMALL:
            break
        for i in range(3):
            known_shift[i], known_turn[i], step[i] = shift[i], turn[i], -turn[i]
        quat.from_rotation_vector_into(step, small)
        quat.multiply_into(q, small, near)
        quat.to_matrix_into(near, a)
        euler.from_matrix_into(a, order, axes.gimbal_rad)
        euler.rate_jacobian_of_matrix_into(a, order, jacobian)
        quat.transform_back_into(near, g.arm, arm)
        for i in range(3):
            axes.rail_m[i] = r[i] - arm[i] - shift[i]
    for i in range(3):
        turn[i] -= known_turn[i]
        axes.rail_m[i] -= shift[i] - known_shift[i]
    _add_cross(turn, arm, axes.rail_m)
    for i in range(3):
        step[i] = a[i, 0] * turn[0] + a[i, 1] * turn[1] + a[i, 2] * turn[2]
    for i in range(3):
        axes.gimbal_rad[i] -= g.zero[i]
        for j in range(3):
            axes.gimbal_rad[i] -= jacobian[i, j] * step[j]
