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
from hil.maths.arrays import copy_into, fill

GEOMETRY = np.dtype(
    [
        ("enabled", "i8"),  # 0: an ideal machine
        ("carries", "f8", (3, 3)),  # 1: the rail of the row carries that of the column
        ("centre", "f8", 3),  # m, of the travel of each rail
        ("inverse", "f8", 3),  # 1/m, of half of it; 0 for a fixed rail
        ("rail", "f8", (3, 4, 6)),  # of 1, t, t^2, t^3: displacement x y z, m, and rotation, rad, of each carriage
        ("squareness", "f8", 3),  # rad, more than 90 deg between x and y, y and z, z and x
        ("zero", "f8", 3),  # rad, added to the encoders of roll, pitch, yaw
        ("turntable_tilt", "f8", 3),  # rad, of the outer gimbal's axis
        ("middle_tilt", "f8"),  # rad, outer and middle axis are not orthogonal
        ("middle_offset", "f8"),  # m, of the middle axis from the outer one
        ("inner_tilt", "f8"),  # rad, middle and inner axis
        ("inner_offset", "f8", 2),  # m, of the inner axis from the middle one, and along that
        ("q_reference", "f8", 4),  # inner gimbal to c
        ("arm", "f8", 3),  # m, lever arm in c
        ("base", "f8", 3),  # m, origin of the rails in L
        ("q_base", "f8", 4),  # L to the rails' axes
    ],
    align=True,
)

_SMALL = 1.1e-5  # m, rad: second-order terms of rails, and of gimbals, at which the iteration ends
_ITERATIONS = 6
_NEAR_M = 0.05  # from the ideal rails, within which an earlier solution is one to begin with
_POLE = 1e-9  # least cosine of the middle angle


@kernel
def _rails_deviation(g, rail_m, shift, tilt):
    """Write the displacement ``shift`` (3,), m, and rotation ``tilt`` (3,), rad, of the turntable, in rails' axes."""
    x, y, z = rail_m[0], rail_m[1], rail_m[2]
    s_x, s_y, s_z = -g.squareness[0] * y - g.squareness[2] * z, -g.squareness[1] * z, 0.0
    t_x, t_y, t_z = g.turntable_tilt[0], g.turntable_tilt[1], g.turntable_tilt[2]
    rail = stack.vector(6)
    for n in range(3):
        t = (rail_m[n] - g.centre[n]) * g.inverse[n]
        for m in range(6):
            rail[m] = g.rail[n, 0, m] + t * (g.rail[n, 1, m] + t * (g.rail[n, 2, m] + t * g.rail[n, 3, m]))
        u, v, w = g.carries[n, 0] * x, g.carries[n, 1] * y, g.carries[n, 2] * z
        s_x += rail[0] + rail[4] * w - rail[5] * v
        s_y += rail[1] + rail[5] * u - rail[3] * w
        s_z += rail[2] + rail[3] * v - rail[4] * u
        t_x, t_y, t_z = t_x + rail[3], t_y + rail[4], t_z + rail[5]
    shift[0], shift[1], shift[2] = s_x, s_y, s_z
    tilt[0], tilt[1], tilt[2] = t_x, t_y, t_z


@kernel
def _gimbals_deviation(g, order, a, shift, turn):
    """Write by how much the gimbals displace the inner one, ``shift`` (3,), m, and rotate it, ``turn`` (3,), rad.

    a: (3, 3), attitude of the inner one, in whose axes the outer axis is column i of it, the middle one (p, q, 0), and
    its own (0, 0, 1). Results are in rails' axes.
    """
    i, j, k = order[0], order[1], order[2]
    cosine = max(_POLE, math.sqrt(a[i, i] * a[i, i] + a[j, i] * a[j, i]))  # of the middle angle
    p, q = -a[j, i] / cosine, a[i, i] / cosine
    across, tilt = g.inner_offset[0] - g.middle_offset * a[k, i], g.inner_tilt - g.middle_tilt * a[k, i]
    s_i, s_j, s_k = across * q + g.inner_offset[1] * p, g.inner_offset[1] * q - across * p, g.middle_offset * cosine
    t_i, t_j, t_k = tilt * q, -tilt * p, g.middle_tilt * cosine
    for m in range(3):
        shift[m] = a[i, m] * s_i + a[j, m] * s_j + a[k, m] * s_k
        turn[m] = a[i, m] * t_i + a[j, m] * t_j + a[k, m] * t_k


@kernel
def _turned(sign, phi, q, out):
    """Write ``q`` (4,) after the small rotation ``phi`` (3,), rad, by ``sign``, to ``out`` (4,)."""
    small, square = stack.vector(4), 0.0
    for i in range(3):
        small[i] = 0.5 * sign * phi[i]
        square += small[i] * small[i]
    small[3] = 1.0 - square * (0.5 + 0.125 * square)
    quat.multiply_into(q, small, out)


@kernel
def machine_pose(g, order, rail_m, gimbal_rad, r_L, q_CL):
    """Write the pose ``r_L`` (3,), m, ``q_CL`` (4,) of the chaser in L with the encoders at the given positions."""
    angles, q, near, a = stack.vector(3), stack.vector(4), stack.vector(4), stack.matrix(3, 3)
    shift, tilt, offset, turn = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3)
    for i in range(3):
        angles[i] = gimbal_rad[i] + g.zero[i]
    euler.to_quaternion_into(angles, order, near)
    quat.to_matrix_into(near, a)
    _rails_deviation(g, rail_m, shift, tilt)
    _gimbals_deviation(g, order, a, offset, turn)
    for i in range(3):
        turn[i] += tilt[i]
    _turned(1.0, turn, near, q)
    quat.multiply_into(g.q_reference, q, near)
    quat.transform_back_into(near, g.arm, r_L)
    for i in range(3):
        r_L[i] += rail_m[i] + shift[i] + offset[i]
    quat.transform_back_into(g.q_base, r_L, r_L)
    for i in range(3):
        r_L[i] += g.base[i]
    quat.multiply_into(near, g.q_base, q_CL)


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
def _square(a):
    """Return the square of the length of ``a`` (3,)."""
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


@kernel
def compensate(g, order, q, ideal, rail_m, gimbal_rad, jacobian):
    """Write the rails ``rail_m`` (3,), m, and gimbals ``gimbal_rad`` (3,), rad, that put c at an attitude.

    q: (4,), that attitude in rails' axes, overwritten. ideal: (3,), rails of an ideal machine. jacobian: (3, 3),
    written, of the gimbals' angles by the body rate. The deviation is first that at ``rail_m``, an earlier solution if
    it is close by, and is iterated until the remainder is of second order; the last rotation is one of the angles.
    """
    shift, offset, a = stack.vector(3), stack.vector(3), stack.matrix(3, 3)
    tilt, turn, known, change, rest = (
        stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3)
    )  # fmt: skip
    inner, back = stack.vector(4), stack.vector(4)
    quat.conjugate_into(g.q_reference, back)
    quat.multiply_into(back, q, inner)
    copy_into(q, inner)
    fill(known, 0.0)
    for i in range(3):
        if not abs(rail_m[i] - ideal[i]) < _NEAR_M:
            rail_m[i] = ideal[i]
    for _ in range(_ITERATIONS):
        quat.to_matrix_into(q, a)
        _rails_deviation(g, rail_m, shift, tilt)
        _gimbals_deviation(g, order, a, offset, turn)
        for i in range(3):
            change[i] = ideal[i] - shift[i] - offset[i] - rail_m[i]
            rail_m[i] += change[i]
            turn[i] += tilt[i]
            rest[i] = known[i] - turn[i]
        of_rails = (_square(shift) + _square(tilt)) * _square(change)
        of_gimbals = (_square(offset) + _square(turn)) * _square(rest)
        if not max(of_rails, of_gimbals) > _SMALL * _SMALL:
            break
        _turned(-1.0, turn, inner, q)
        copy_into(known, turn)
    euler.from_matrix_into(a, order, gimbal_rad)
    euler.rate_jacobian_of_matrix_into(a, order, jacobian)
    for i in range(3):
        change[i] = a[i, 0] * rest[0] + a[i, 1] * rest[1] + a[i, 2] * rest[2]
    for i in range(3):
        turned = jacobian[i, 0] * change[0] + jacobian[i, 1] * change[1] + jacobian[i, 2] * change[2]
        gimbal_rad[i] += turned - g.zero[i]
