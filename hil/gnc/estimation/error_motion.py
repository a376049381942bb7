"""Transition of the errors over a step, applied to the rows of a matrix.

With ``A = A(q_CH)`` in mid-step, ``f`` and ``w`` the specific force and rate without bias and drift, ``B`` the response
of Hill's equations to an acceleration in H:

    (r, v)' = F (r, v) + B A.T ds,   ds = theta x f - db - s_a f + m_a x f, if f is measured
                                     ds = theta x f + d, if it is that of commands, with the disturbance d
                                     ds = theta x f + d + s_u f, if their scale is a state
    theta'  = R theta - dt J dw,     dw = dd + s_g w - m_g x w

``s``, ``m`` are scale factor and misalignment of a sensor. Terms that are zero in Hill's equations are omitted.
``rows`` is a matrix with a row for each error, ``lanes`` the number of its columns, a multiple of 8.
"""

from __future__ import annotations

from typing import Final

from hil.core.jit import kernel
from hil.gnc.estimation.error_state import BIAS, DRIFT, FILTER_ERRORS, LANES, ROTATION
from hil.maths import stack

_TRANSPOSED: Final = 12  # columns for position, velocity and rotation, in whole vector registers


@kernel
def force_error(errors, moved, rows, lanes, out):
    """Write the error ``ds`` of the specific force in c, (3, lanes). moved: STEP_INPUT."""
    f0, f1, f2 = moved.force[0], moved.force[1], moved.force[2]
    k, sign = BIAS, -1.0
    if moved.measured == 0:
        k, sign = errors.disturbance, 1.0 if errors.disturbance != 0 else 0.0
    for j in range(lanes):
        t0, t1, t2 = rows[ROTATION, j], rows[ROTATION + 1, j], rows[ROTATION + 2, j]
        out[0, j] = f2 * t1 - f1 * t2 + sign * rows[k, j]
        out[1, j] = f0 * t2 - f2 * t0 + sign * rows[k + 1, j]
        out[2, j] = f1 * t0 - f0 * t1 + sign * rows[k + 2, j]
    if moved.measured == 0:
        k = errors.thrust_scale
        if k != 0:
            for j in range(lanes):
                out[0, j] += f0 * rows[k, j]
                out[1, j] += f1 * rows[k, j]
                out[2, j] += f2 * rows[k, j]
        return
    k = errors.accelerometer_scale
    if k != 0:
        for j in range(lanes):
            out[0, j] -= f0 * rows[k, j]
            out[1, j] -= f1 * rows[k + 1, j]
            out[2, j] -= f2 * rows[k + 2, j]
    k = errors.accelerometer_misalignment
    if k != 0:
        for j in range(lanes):
            out[0, j] += f2 * rows[k + 1, j] - f1 * rows[k + 2, j]
            out[1, j] += f0 * rows[k + 2, j] - f2 * rows[k, j]
            out[2, j] += f1 * rows[k, j] - f0 * rows[k + 1, j]


@kernel
def rate_error(errors, rate, rows, lanes, out):
    """Write the error ``dw`` of the rate in c, (3, lanes). rate: (3,), rad/s."""
    w0, w1, w2 = rate[0], rate[1], rate[2]
    for j in range(lanes):
        for i in range(3):
            out[i, j] = rows[DRIFT + i, j]
    k = errors.gyro_scale
    if k != 0:
        for j in range(lanes):
            out[0, j] += w0 * rows[k, j]
            out[1, j] += w1 * rows[k + 1, j]
            out[2, j] += w2 * rows[k + 2, j]
    k = errors.gyro_misalignment
    if k != 0:
        for j in range(lanes):
            out[0, j] += w1 * rows[k + 2, j] - w2 * rows[k + 1, j]
            out[1, j] += w2 * rows[k, j] - w0 * rows[k + 2, j]
            out[2, j] += w0 * rows[k + 1, j] - w1 * rows[k, j]


@kernel
def carry_motion(of_pkf, a, force, rows, lanes, out):
    """Write position and velocity after the step, (6, lanes), into ``out``, which may be ``rows``.

    a: A (3, 3). force: (3, lanes), of ``force_error``.
    """
    h, g = of_pkf.hill_transition, of_pkf.hill_response
    h00, h02, h03, h05 = h[0, 0], h[0, 2], h[0, 3], h[0, 5]
    h11, h14, h41, h44 = h[1, 1], h[1, 4], h[4, 1], h[4, 4]
    h22, h23, h25 = h[2, 2], h[2, 3], h[2, 5]
    h32, h33, h35 = h[3, 2], h[3, 3], h[3, 5]
    h52, h53, h55 = h[5, 2], h[5, 3], h[5, 5]
    g00, g02, g11, g20, g22 = g[0, 0], g[0, 2], g[1, 1], g[2, 0], g[2, 2]
    g30, g32, g41, g50, g52 = g[3, 0], g[3, 2], g[4, 1], g[5, 0], g[5, 2]
    a00, a01, a02 = a[0, 0], a[0, 1], a[0, 2]
    a10, a11, a12 = a[1, 0], a[1, 1], a[1, 2]
    a20, a21, a22 = a[2, 0], a[2, 1], a[2, 2]
    for j in range(lanes):
        x0, x1, x2, x3, x4, x5 = rows[0, j], rows[1, j], rows[2, j], rows[3, j], rows[4, j], rows[5, j]
        s0, s1, s2 = force[0, j], force[1, j], force[2, j]
        u0 = a00 * s0 + a10 * s1 + a20 * s2
        u1 = a01 * s0 + a11 * s1 + a21 * s2
        u2 = a02 * s0 + a12 * s1 + a22 * s2
        out[0, j] = h00 * x0 + h02 * x2 + h03 * x3 + h05 * x5 + (g00 * u0 + g02 * u2)
        out[1, j] = h11 * x1 + h14 * x4 + g11 * u1
        out[2, j] = h22 * x2 + h23 * x3 + h25 * x5 + (g20 * u0 + g22 * u2)
        out[3, j] = h32 * x2 + h33 * x3 + h35 * x5 + (g30 * u0 + g32 * u2)
        out[4, j] = h41 * x1 + h44 * x4 + g41 * u1
        out[5, j] = h52 * x2 + h53 * x3 + h55 * x5 + (g50 * u0 + g52 * u2)


@kernel
def add_force_noise(of_pkf, variance, out):
    """Add the covariance of the force's white noise to r and v in ``out`` (6, _TRANSPOSED).

    It acts as a force in H, because it is isotropic. variance: of a step, (m/s^2)^2.
    """
    g, noise = of_pkf.hill_response, stack.matrix(3, _TRANSPOSED)
    for m in range(3):
        for i in range(6):
            noise[m, i] = variance * g[i, m]
        for i in range(6, _TRANSPOSED):
            noise[m, i] = 0.0
    g00, g02, g11, g20, g22 = g[0, 0], g[0, 2], g[1, 1], g[2, 0], g[2, 2]
    g30, g32, g41, g50, g52 = g[3, 0], g[3, 2], g[4, 1], g[5, 0], g[5, 2]
    for j in range(_TRANSPOSED):
        u0, u1, u2 = noise[0, j], noise[1, j], noise[2, j]
        out[0, j] += g00 * u0 + g02 * u2
        out[1, j] += g11 * u1
        out[2, j] += g20 * u0 + g22 * u2
        out[3, j] += g30 * u0 + g32 * u2
        out[4, j] += g41 * u1
        out[5, j] += g50 * u0 + g52 * u2


@kernel
def carry_rotation(phi, rate, rows, lanes, first, out):
    """Write rotations after the step into the rows of ``out`` from ``first`` on; ``out`` may be ``rows``.

    phi: (3, 6), of ``akf.transition``. rate: (3, lanes), of ``rate_error``.
    """
    f00, f01, f02, f03, f04, f05 = phi[0, 0], phi[0, 1], phi[0, 2], phi[0, 3], phi[0, 4], phi[0, 5]
    f10, f11, f12, f13, f14, f15 = phi[1, 0], phi[1, 1], phi[1, 2], phi[1, 3], phi[1, 4], phi[1, 5]
    f20, f21, f22, f23, f24, f25 = phi[2, 0], phi[2, 1], phi[2, 2], phi[2, 3], phi[2, 4], phi[2, 5]
    for j in range(lanes):
        t0, t1, t2 = rows[ROTATION, j], rows[ROTATION + 1, j], rows[ROTATION + 2, j]
        w0, w1, w2 = rate[0, j], rate[1, j], rate[2, j]
        out[first, j] = f00 * t0 + f01 * t1 + f02 * t2 + (f03 * w0 + f04 * w1 + f05 * w2)
        out[first + 1, j] = f10 * t0 + f11 * t1 + f12 * t2 + (f13 * w0 + f14 * w1 + f15 * w2)
        out[first + 2, j] = f20 * t0 + f21 * t1 + f22 * t2 + (f23 * w0 + f24 * w1 + f25 * w2)


@kernel
def carry_filters(errors, of_pkf, a, moved, phi, p, lanes):
    """Carry position, velocity and rotation in the covariance ``p`` over the step: ``F p F.T`` and the force's noise.

    moved: STEP_INPUT. The transition is applied to the rows, and then to the rows of the transpose. lanes: columns of
    ``p`` that are used, a constant, with which the loops become vector instructions.
    """
    n = errors.n
    of_force, of_rate = stack.matrix(3, LANES), stack.matrix(3, LANES)
    force_error(errors, moved, p, lanes, of_force)
    rate_error(errors, moved.rate, p, lanes, of_rate)
    carry_motion(of_pkf, a, of_force, p, lanes, p)
    carry_rotation(phi, of_rate, p, lanes, ROTATION, p)
    # columns: position and velocity, then rotation
    transposed = stack.matrix(LANES, _TRANSPOSED)
    of_force_2, of_rate_2 = stack.matrix(3, _TRANSPOSED), stack.matrix(3, _TRANSPOSED)
    motion, rotation = stack.matrix(6, _TRANSPOSED), stack.matrix(3, _TRANSPOSED)
    for j in range(BIAS, FILTER_ERRORS):  # first what is read first
        _transpose(p, j, transposed)
    for j in range(BIAS):
        _transpose(p, j, transposed)
    for j in range(errors.imu, n):
        _transpose(p, j, transposed)
    force_error(errors, moved, transposed, _TRANSPOSED, of_force_2)
    rate_error(errors, moved.rate, transposed, _TRANSPOSED, of_rate_2)
    carry_motion(of_pkf, a, of_force_2, transposed, _TRANSPOSED, motion)
    add_force_noise(of_pkf, moved.variance, motion)
    carry_rotation(phi, of_rate_2, transposed, _TRANSPOSED, 0, rotation)
    for i in range(6):
        for j in range(i + 1):
            p[i, j] = p[j, i] = motion[i, j]
    for i in range(3):
        for j in range(6):
            p[ROTATION + i, j] = p[j, ROTATION + i] = rotation[i, j]
        for j in range(i + 1):
            p[ROTATION + i, ROTATION + j] = p[ROTATION + j, ROTATION + i] = rotation[i, 6 + j]
    for j in range(BIAS, ROTATION):
        _mirror(j, p)
    for j in range(DRIFT, n):
        _mirror(j, p)


@kernel
def _transpose(p, j, out):
    """Write column ``j`` of position, velocity and rotation into row ``j`` of ``out`` (n, _TRANSPOSED)."""
    for i in range(6):
        out[j, i] = p[i, j]
    for i in range(3):
        out[j, 6 + i] = p[ROTATION + i, j]
    for i in range(9, _TRANSPOSED):
        out[j, i] = 0.0


@kernel
def _mirror(j, p):
    """Write column ``j`` of position, velocity and rotation into row ``j``."""
    for i in range(6):
        p[j, i] = p[i, j]
    for i in range(ROTATION, DRIFT):
        p[j, i] = p[i, j]


@kernel
def add_part(errors, first, part, p):
    """Carry bias or drift, from ``first`` on, in the covariance ``p``; ``part``: index of its instability.

    Bias and drift are sums of a random walk and of a process that loses a part of itself in each step.
    """
    for i in range(3):
        lost = errors.kept[part + i] - 1.0
        for j in range(errors.lanes):
            p[first + i, j] += lost * p[part + i, j]
        for j in range(errors.n):
            p[j, first + i] += lost * p[j, part + i]
    for i in range(3):
        for j in range(i):
            p[first + j, first + i] = p[first + i, first + j]


@kernel
def decay(errors, p):
    """Carry the Gauss-Markov processes in the covariance ``p``: each keeps a part, and gets as much fresh variance."""
    for i in range(errors.n):
        kept = errors.kept[i]
        for j in range(errors.lanes):
            p[i, j] *= kept * errors.kept[j]
        p[i, i] += errors.variance[i] * (1.0 - kept * kept)
