"""Filters and control in the axes of a target that tumbles.

The position filter's step is that of a motion without gravity in axes at rest, those of the body in mid-step: the state
and its covariance are transformed into these before it, and into the rotating ones after it. The gradient of gravity,
below ``3 n^2 r`` or 1e-5 m/s^2 at 3 m, is not modelled.

A rate of the axes that is not estimated (``hil.gnc.estimation.target_motion``) looks like drift of the gyros to the
attitude filter, because the chaser rotates with the target; what its drift exceeds the expected one by is taken for an
error of the rate, and corrects it in the position filter.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.gnc.estimation.error_state import BIAS, DRIFT, ROTATION
from hil.maths import quat, stack
from hil.maths.arrays import cross_into, fill
from hil.models.rotating_frame import frame_acceleration

AXES_STEP = np.dtype(
    [
        ("half", "f8", (3, 3)),  # matrix of half the rotation
        ("before", "f8", 3),  # rad/s, rate at the start of the step
        ("after", "f8", 3),  # at its end
    ],
    align=True,
)
"""Motion of the body's axes over a step of the filters, as corrected by the attitude filter."""


@kernel
def correct_motion(hill, akf, expected_drift, dt, axes):
    """Write the motion of the axes over a step of ``dt`` into ``axes`` (AXES_STEP).

    hill: HILL_STEP, as the tumble is known. akf: AKF_STATE. expected_drift: of the gyros, (3,), rad/s.
    """
    error, half, q = stack.vector(3), stack.vector(3), stack.vector(4)
    for i in range(3):
        error[i] = akf.x[4 + i] - expected_drift[i]
    quat.transform_back_into(akf.x[0:4], error, error)
    for i in range(3):
        half[i] = 0.5 * (hill.rotation[i] + dt * error[i])
        axes.before[i] = hill.rate_before[i] + error[i]
        axes.after[i] = hill.rate_after[i] + error[i]
    quat.from_rotation_vector_into(half, q)
    quat.to_matrix_into(q, axes.half)


@kernel
def _transformation(a, before, after, f):
    """Write the transformation (6, 6) of [r, v] by ``a`` (3, 3), between axes that rotate at two rates, rad/s."""
    for i in range(3):
        for j in range(3):
            k, m, n, o = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            f[i, j] = f[3 + i, 3 + j] = a[i, j]
            f[i, 3 + j] = 0.0
            f[3 + i, j] = a[i, k] * before[m] - a[i, m] * before[k]  # a [before]x - [after]x a
            f[3 + i, j] -= after[n] * a[o, j] - after[o] * a[n, j]


@kernel
def _congruence(f, p, n, rate):
    """Transform the covariance ``p`` (n, n), whose first six errors are those of r and v, by ``f`` (6, 6).

    A row beyond these six is the mirror of its column, but for those of the rotation and of the target's rate, from
    index ``rate`` on: what the rate adds to both (``target_motion.carry_errors``) is symmetric to rounding.
    """
    a00, a01, a02, a10, a11, a12 = f[0, 0], f[0, 1], f[0, 2], f[1, 0], f[1, 1], f[1, 2]
    a20, a21, a22, b00, b01, b02 = f[2, 0], f[2, 1], f[2, 2], f[3, 0], f[3, 1], f[3, 2]
    b10, b11, b12, b20, b21, b22 = f[4, 0], f[4, 1], f[4, 2], f[5, 0], f[5, 1], f[5, 2]
    for j in range((n + 7) // 8 * 8):  # whole vector registers
        x0, x1, x2, x3, x4, x5 = p[0, j], p[1, j], p[2, j], p[3, j], p[4, j], p[5, j]
        p[0, j] = a00 * x0 + a01 * x1 + a02 * x2
        p[1, j] = a10 * x0 + a11 * x1 + a12 * x2
        p[2, j] = a20 * x0 + a21 * x1 + a22 * x2
        p[3, j] = b00 * x0 + b01 * x1 + b02 * x2 + a00 * x3 + a01 * x4 + a02 * x5
        p[4, j] = b10 * x0 + b11 * x1 + b12 * x2 + a10 * x3 + a11 * x4 + a12 * x5
        p[5, j] = b20 * x0 + b21 * x1 + b22 * x2 + a20 * x3 + a21 * x4 + a22 * x5
    new = stack.vector(6)
    for row in range(n):
        if not (row < BIAS or ROTATION <= row < DRIFT or (rate != 0 and rate <= row < rate + 3)):
            for i in range(6):
                p[row, i] = p[i, row]
            continue
        for i in range(6):
            new[i] = 0.0
            for j in range(3 if i < 3 else 6):
                new[i] += f[i, j] * p[row, j]
        for i in range(6):
            p[row, i] = new[i]


@kernel
def enter_middle(axes, filters, n, rate):
    """Transform the PKF's estimate and the covariance of the ``n`` errors of FILTERS for the filter's step.

    axes: AXES_STEP. rate: index of the target's rate among the errors, 0 if it is none of them. The step is made in
    axes at rest, those of the body in mid-step.
    """
    rest = stack.vector(3)
    fill(rest, 0.0)
    _apply(axes.half, axes.before, rest, filters, n, rate)


@kernel
def leave_middle(axes, filters, n, rate):
    """Transform back after the filter's step; arguments: see ``enter_middle``."""
    rest = stack.vector(3)
    fill(rest, 0.0)
    _apply(axes.half, rest, axes.after, filters, n, rate)


@kernel
def _apply(a, before, after, filters, n, rate):
    f, new = stack.matrix(6, 6), stack.vector(6)
    _transformation(a, before, after, f)
    for i in range(6):
        new[i] = 0.0
        for j in range(6):
            new[i] += f[i, j] * filters.pkf.x[j]
    for i in range(6):
        filters.pkf.x[i] = new[i]
    _congruence(f, filters.p, n, rate)


@kernel
def feed_forward(rate_H, change_H, inertia, q_CH, rate_C, acceleration_C, reference, out):
    """Write what keeps the chaser on a reference in rotating axes into ``out`` (6,).

    Acceleration in H, m/s^2, and angular acceleration about each axis of c, rad/s^2: torque over its own moment.
    rate_H, change_H: of the axes, rad/s, rad/s^2, zero of the Hill frame. inertia: (3, 3), kg m^2. rate_C,
    acceleration_C: reference's rate and its change against H, in c. reference: REFERENCE.
    """
    w, dw, force = stack.vector(3), stack.vector(3), stack.vector(3)
    frame_acceleration(rate_H, change_H, reference.r_CT_H, reference.v_CT_H, force)
    for i in range(3):
        out[i] = force[i]
    quat.transform_into(q_CH, rate_H, w)
    quat.transform_into(q_CH, change_H, dw)
    momentum, torque, turning = stack.vector(3), stack.vector(3), stack.vector(3)
    cross_into(rate_C, w, turning)
    for i in range(3):
        dw[i] += acceleration_C[i] - turning[i]
        w[i] += rate_C[i]
    for i in range(3):
        momentum[i] = inertia[i, 0] * w[0] + inertia[i, 1] * w[1] + inertia[i, 2] * w[2]
    cross_into(w, momentum, torque)
    for i in range(3):
        torque[i] += inertia[i, 0] * dw[0] + inertia[i, 1] * dw[1] + inertia[i, 2] * dw[2]
        out[3 + i] = torque[i] / inertia[i, i]
