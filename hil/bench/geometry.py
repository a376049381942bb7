"""Errors of the machine's geometry: pose of a bench whose rails and gimbals are not ideal, and axes that compensate it.

Each rail has a displacement and a small rotation of its carriage, Legendre polynomials of its travel, and displaces all
that it carries; rails are not square, gimbal axes do not meet and are not orthogonal. Zero offsets, lever arm and the
pose of the rails in L act as they are, all other rotations to first order: of 1 mrad each the sum is off by some 1e-6.
What may be wrong of a bench: ``hil.config.tables.machine``.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, euler, quat, stack
from hil.maths.arrays import copy_into, cross_into, fill

GEOMETRY = np.dtype(
    [
        ("enabled", "i8"),  # 0: an ideal machine
        ("stack", "i8", 3),  # rails from the floor up
        ("centre", "f8", 3),  # m, of the travel of each rail
        ("inverse", "f8", 3),  # 1/m, of half of it; 0 for a fixed rail
        ("rail", "f8", (3, 6, 3)),  # displacement x y z, m, and rotation, rad, of each carriage: P1, P2, P3
        ("squareness", "f8", 3),  # rad, more than 90 deg between x and y, y and z, z and x
        ("zero", "f8", 3),  # rad, added to the encoders of roll, pitch, yaw
        ("turntable_tilt", "f8", 3),  # rad, of the outer gimbal's axis
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


@kernel
def _add_cross(a, b, out):
    """Add the cross product of ``a`` and ``b`` (3,) to ``out`` (3,)."""
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@kernel
def _deviation(g, order, rail_m, angles, a, arm, shift, turn):
    """Write by how much the chaser is displaced, ``shift`` (3,), m, and rotated, ``turn`` (3,), rad, in rails' axes.

    angles: of the gimbals, zero offsets included, whose attitude is ``a`` (3, 3). arm: (3,), m, from their centre.
    """
    above, rotation = stack.vector(3), stack.vector(3)
    fill(above, 0.0)
    fill(shift, 0.0)
    fill(turn, 0.0)
    for n in range(2, -1, -1):
        i = g.stack[n]
        t = (rail_m[i] - g.centre[i]) * g.inverse[i]
        p2 = 1.5 * t * t - 0.5
        p3 = (2.5 * t * t - 1.5) * t
        for m in range(3):
            shift[m] += g.rail[i, m, 0] * t + g.rail[i, m, 1] * p2 + g.rail[i, m, 2] * p3
            rotation[m] = g.rail[i, 3 + m, 0] * t + g.rail[i, 3 + m, 1] * p2 + g.rail[i, 3 + m, 2] * p3
            turn[m] += rotation[m]
        _add_cross(rotation, above, shift)
        above[i] += rail_m[i]
    shift[0] -= g.squareness[0] * rail_m[1] + g.squareness[2] * rail_m[2]
    shift[1] -= g.squareness[1] * rail_m[2]
    i, j, k = order[0], order[1], order[2]
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    sine, cosine = sign * elementary.sin(angles[i]), elementary.cos(angles[i])
    middle, across, third = stack.vector(3), stack.vector(3), stack.vector(3)
    middle[i], middle[j], middle[k] = 0.0, cosine, sine  # the middle axis
    across[i], across[j], across[k] = 0.0, -sine, cosine  # at right angles to outer and middle axis
    cross_into(middle, a[k], third)  # to middle and inner axis
    for m in range(3):
        third[m] *= sign
        turn[m] += g.turntable_tilt[m] + g.middle_tilt * across[m] + g.inner_tilt * third[m]
        turn[m] += a[0, m] * g.reference_tilt[0] + a[1, m] * g.reference_tilt[1] + a[2, m] * g.reference_tilt[2]
        shift[m] += g.middle_offset * across[m] + g.inner_offset[0] * third[m] + g.inner_offset[1] * middle[m]
    _add_cross(turn, arm, shift)


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
    _deviation(g, order, rail_m, angles, a, arm, shift, turn)
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
def compensate(g, order, r, q, axes):
    """Correct the positions of ``axes`` (AXES), those of an ideal machine at this pose in rails' axes.

    Errors of 4 mm or 4 mrad are corrected to first order, within their square; of larger ones the place at which they
    are taken is iterated first. r: (3,), m. q: (4,).
    """
    a, jacobian, near, small = stack.matrix(3, 3), stack.matrix(3, 3), stack.vector(4), stack.vector(4)
    arm, shift, turn = stack.vector(3), stack.vector(3), stack.vector(3)
    known_shift, known_turn, step = stack.vector(3), stack.vector(3), stack.vector(3)
    fill(known_shift, 0.0)
    fill(known_turn, 0.0)
    copy_into(near, q)
    for _ in range(_ITERATIONS):
        quat.to_matrix_into(near, a)
        quat.transform_back_into(near, g.arm, arm)
        _deviation(g, order, axes.rail_m, axes.gimbal_rad, a, arm, shift, turn)
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
        quat.transform_back_into(near, g.arm, arm)
        for i in range(3):
            axes.rail_m[i] = r[i] - arm[i] - shift[i]
    for i in range(3):
        turn[i] -= known_turn[i]
        axes.rail_m[i] -= shift[i] - known_shift[i]
    _add_cross(turn, arm, axes.rail_m)
    quat.transform_into(near, turn, turn)
    euler.rate_jacobian_of_matrix_into(a, order, jacobian)
    for i in range(3):
        axes.gimbal_rad[i] -= g.zero[i]
        for j in range(3):
            axes.gimbal_rad[i] -= jacobian[i, j] * turn[j]
