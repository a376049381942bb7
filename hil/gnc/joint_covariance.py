"""Joint covariance of the errors of position and attitude filter, over a step and through an update.

Of the joint covariance (15, 15) the position filter holds its own part ``p`` (9, 9) and its covariance ``c`` (9, 6)
with the attitude filter's error; the rest, (6, 6), is the attitude filter's own.
"""

from __future__ import annotations

from typing import Final

from hil.core.jit import kernel
from hil.maths import stack

_LANES: Final = 16  # for the 15 joint errors: full registers
_HALF_LANES: Final = 8  # for the six of position and velocity


@kernel
def propagate(params, state, a, f0, f1, f2, attitude_p, attitude_phi):
    """Carry ``p`` and ``c`` over the step: joint covariance of this filter's and the attitude filter's error.

    a: A(q_CH) (3, 3). f0, f1, f2: specific force in c, m/s^2. The joint transition is applied to the rows, and
    then to the rows of the transpose, because the covariance is symmetric.
    """
    rows, transposed, out = stack.matrix(12, _LANES), stack.matrix(12, _HALF_LANES), stack.matrix(12, _HALF_LANES)
    for i in range(9):
        for j in range(9):
            rows[i, j] = state.p[i, j]
        for j in range(6):
            rows[i, 9 + j] = state.c[i, j]
        rows[i, 15] = 0.0
    for i in range(3):
        for j in range(9):
            rows[9 + i, j] = state.c[j, i]
        for j in range(6):
            rows[9 + i, 9 + j] = attitude_p[i, j]
        rows[9 + i, 15] = 0.0
    half = stack.matrix(6, _LANES)
    push = stack.matrix(3, _LANES)
    for j in range(_LANES):
        push[0, j], push[1, j], push[2, j] = 0.0, 0.0, 0.0
    _move_rows(params, a, f0, f1, f2, rows, push, _LANES, half)
    for i in range(6):
        for j in range(12):
            transposed[j, i] = half[i, j]
    for j in range(12):
        transposed[j, 6], transposed[j, 7] = 0.0, 0.0
    # white noise of the accelerometer acts as a force in H: it is isotropic
    noise = stack.matrix(3, _HALF_LANES)
    accelerometer = params.sigma_accelerometer * params.sigma_accelerometer
    for m in range(3):
        for i in range(6):
            noise[m, i] = accelerometer * params.hill_response[i, m]
        noise[m, 6], noise[m, 7] = 0.0, 0.0
    _move_rows(params, a, f0, f1, f2, transposed, noise, _HALF_LANES, out)
    for i in range(6):
        for j in range(i, 6):
            state.p[i, j] = out[i, j]
            state.p[j, i] = out[i, j]
        for j in range(6, 9):
            state.p[i, j] = half[i, j]
            state.p[j, i] = half[i, j]
    for i in range(3):
        state.p[6 + i, 6 + i] += (params.dt_s * params.sigma_bias) ** 2
    _follow_attitude(state, half, attitude_phi)


@kernel
def _move_rows(params, a, f0, f1, f2, rows, push, lanes, out):
    """Write rows r and v of the joint transition times ``rows`` into ``out``, column by column of ``lanes``.

    rows: position, velocity, bias, rotation, in this order, (>= 12, lanes). push: (3, lanes), added to the force in H.
    Terms that are zero in Hill's equations are omitted.
    """
    h, g = params.hill_transition, params.hill_response
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
        t0, t1, t2 = rows[9, j], rows[10, j], rows[11, j]
        # a bias reduces the force in c, a rotation theta of c adds theta x force
        s0 = f2 * t1 - f1 * t2 - rows[6, j]
        s1 = f0 * t2 - f2 * t0 - rows[7, j]
        s2 = f1 * t0 - f0 * t1 - rows[8, j]
        u0 = push[0, j] + (a00 * s0 + a10 * s1 + a20 * s2)
        u1 = push[1, j] + (a01 * s0 + a11 * s1 + a21 * s2)
        u2 = push[2, j] + (a02 * s0 + a12 * s1 + a22 * s2)
        out[0, j] = h00 * x0 + h02 * x2 + h03 * x3 + h05 * x5 + (g00 * u0 + g02 * u2)
        out[1, j] = h11 * x1 + h14 * x4 + g11 * u1
        out[2, j] = h22 * x2 + h23 * x3 + h25 * x5 + (g20 * u0 + g22 * u2)
        out[3, j] = h32 * x2 + h33 * x3 + h35 * x5 + (g30 * u0 + g32 * u2)
        out[4, j] = h41 * x1 + h44 * x4 + g41 * u1
        out[5, j] = h52 * x2 + h53 * x3 + h55 * x5 + (g50 * u0 + g52 * u2)


@kernel
def _follow_attitude(state, half, attitude_phi):
    """Write ``c`` after the step: its rows r and v from ``half`` (6, _LANES), those of the bias from before."""
    f = attitude_phi
    for i in range(9):
        if i < 6:
            t0, t1, t2, d0, d1, d2 = half[i, 9], half[i, 10], half[i, 11], half[i, 12], half[i, 13], half[i, 14]
        else:
            t0, t1, t2 = state.c[i, 0], state.c[i, 1], state.c[i, 2]
            d0, d1, d2 = state.c[i, 3], state.c[i, 4], state.c[i, 5]
        for j in range(3):
            rotation = f[j, 0] * t0 + f[j, 1] * t1 + f[j, 2] * t2
            state.c[i, j] = rotation + (f[j, 3] * d0 + f[j, 4] * d1 + f[j, 5] * d2)
        state.c[i, 3], state.c[i, 4], state.c[i, 5] = d0, d1, d2


@kernel
def joint_product(phi, lever, sign, p, c, attitude_p, mixed, half):
    """Write ``phi c + sign lever attitude_p`` into ``mixed`` (9, 6), ``phi p + sign lever c.T`` into ``half`` (9, 9).

    phi: (9, 9). lever: (9, 3), of the rotation theta. Their zeros are skipped, see ``hil.maths.kalman``.
    """
    of_p, of_c = stack.vector(9), stack.vector(6)  # sums of one row: kept in registers
    for i in range(9):
        for j in range(9):
            of_p[j] = 0.0
        for j in range(6):
            of_c[j] = 0.0
        for m in range(9):
            factor = phi[i, m]
            if factor != 0.0:
                for j in range(9):
                    of_p[j] += factor * p[m, j]
                for j in range(6):
                    of_c[j] += factor * c[m, j]
        for m in range(3):
            factor = sign * lever[i, m]
            if factor != 0.0:
                for j in range(9):
                    of_p[j] += factor * c[j, m]
                for j in range(6):
                    of_c[j] += factor * attitude_p[m, j]
        for j in range(9):
            half[i, j] = of_p[j]
        for j in range(6):
            mixed[i, j] = of_c[j]


@kernel
def close_product(phi, lever, sign, mixed, half, noise, p):
    """Write ``half phi.T + sign mixed lever.T + noise``, which is symmetric, into ``p`` (9, 9)."""
    transposed, mixed_transposed = stack.matrix(9, 9), stack.matrix(3, 9)
    row = stack.vector(9)
    for i in range(9):
        for j in range(9):
            transposed[j, i] = half[i, j]
        for j in range(3):
            mixed_transposed[j, i] = mixed[i, j]
    for i in range(9):
        for j in range(9):
            row[j] = noise[i, j]
        for m in range(9):
            factor = phi[i, m]
            if factor != 0.0:
                for j in range(9):
                    row[j] += factor * transposed[m, j]
        for m in range(3):
            factor = sign * lever[i, m]
            if factor != 0.0:
                for j in range(9):
                    row[j] += factor * mixed_transposed[m, j]
        for j in range(i, 9):
            p[i, j] = row[j]
            p[j, i] = row[j]
