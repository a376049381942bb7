"""Gravity of the central body: a point mass and fully normalised spherical harmonics.

The harmonics follow Pines (AIAA Journal 11, 1973) in the normalised form of Lundberg and Schutz (Journal
of Guidance 11, 1988): no angle appears, so there is no singularity at the poles. Order by order, from
the diagonal up, only two earlier Legendre functions are held. The field holds outside the sphere that
encloses the body.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, stack

GRAVITY_PARAMS = np.dtype(
    [
        ("gm", "f8"),  # m^3/s^2
        ("radius", "f8"),  # m, reference radius of the coefficients
        ("degree", "i8"),  # highest degree in use; below 2 the body is a point mass
        ("rotation", "f8"),  # rad, from inertial x to the body's prime meridian at t = 0
        ("rate", "f8"),  # rad/s, of the body-fixed axes about inertial z
    ],
    align=True,
)

LANES = 4  # places that are evaluated side by side
FIELD_COLUMNS = 6  # C, S, alpha, beta, coupled C, coupled S


def field_table(c, s):
    """Return the field as the kernel reads it, (N + 1, N + 1, 6), indexed by order m, then degree n.

    c, s: (N + 1, N + 1), indexed [n, m], fully normalised, without dimension. Degree 0, the point mass, is
    omitted. In each place: C, S; the factors of ``A_nm = alpha u A_(n-1)m - beta A_(n-2)m`` (on the diagonal
    alpha is the one from A_(m-1)(m-1)); and C, S of the order below times the factor of
    ``dA_n(m-1)/du = factor A_nm``.
    """
    size = c.shape[0]
    table = np.zeros((size, size, FIELD_COLUMNS))
    for m in range(size):
        for n in range(m, size):
            if n > 0:
                table[m, n, 0], table[m, n, 1] = c[n, m], s[n, m]
            if n == m and m > 0:
                table[m, n, 2] = math.sqrt((2 * n + 1) / (2 * n) * (2.0 if m == 1 else 1.0))
            elif n > m:
                table[m, n, 2] = math.sqrt((2 * n + 1) * (2 * n - 1) / ((n - m) * (n + m)))
                lower = (2 * n + 1) * (n + m - 1) * (n - m - 1)
                table[m, n, 3] = math.sqrt(lower / ((2 * n - 3) * (n + m) * (n - m))) if lower else 0.0
            if m > 0:
                factor = math.sqrt((n - m + 1) * (n + m) * (0.5 if m == 1 else 1.0))
                table[m, n, 4], table[m, n, 5] = factor * c[n, m - 1], factor * s[n, m - 1]
    return table


@kernel
def harmonics_of_four(params, field, positions, out):
    """Write the acceleration by the harmonics of degree 1 and above, m/s^2, at four places, in body-fixed axes.

    params: GRAVITY_PARAMS. field: (N + 1, N + 1, 6) of ``field_table``, N >= params.degree. positions: (4, 3), m,
    body-fixed. out: (4, 3). The recursion is a chain of dependent operations; four of them side by side, in the
    lanes of a register, take hardly longer than one.
    """
    s, t, u, step = stack.vector(LANES), stack.vector(LANES), stack.vector(LANES), stack.vector(LANES)
    a1, a2, a3, a4 = stack.vector(LANES), stack.vector(LANES), stack.vector(LANES), stack.vector(LANES)
    diagonal = stack.vector(LANES)  # GM / r^2 (R / r)^m A_mm
    real, imaginary = stack.vector(LANES), stack.vector(LANES)  # (s + i t)^m
    real_below, imaginary_below = stack.vector(LANES), stack.vector(LANES)  # (s + i t)^(m - 1)
    legendre, previous = stack.vector(LANES), stack.vector(LANES)
    sum_c, sum_s = stack.vector(LANES), stack.vector(LANES)
    radial_c, radial_s = stack.vector(LANES), stack.vector(LANES)
    coupled_c, coupled_s = stack.vector(LANES), stack.vector(LANES)
    for j in range(LANES):
        x, y, z = positions[j, 0], positions[j, 1], positions[j, 2]
        r = math.sqrt(x * x + y * y + z * z)
        s[j], t[j], u[j], step[j] = x / r, y / r, z / r, params.radius / r
        a1[j], a2[j], a3[j], a4[j] = 0.0, 0.0, 0.0, 0.0
        diagonal[j] = params.gm / (r * r)
        real[j], imaginary[j], real_below[j], imaginary_below[j] = 1.0, 0.0, 0.0, 0.0
    for m in range(params.degree + 1):
        if m > 0:
            alpha = field[m, m, 2]
            for j in range(LANES):
                diagonal[j] *= step[j] * alpha
                real_below[j], imaginary_below[j] = real[j], imaginary[j]
                real[j] = s[j] * real_below[j] - t[j] * imaginary_below[j]
                imaginary[j] = s[j] * imaginary_below[j] + t[j] * real_below[j]
        for j in range(LANES):
            legendre[j], previous[j] = diagonal[j], 0.0
            sum_c[j], sum_s[j], radial_c[j], radial_s[j], coupled_c[j], coupled_s[j] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(m, params.degree + 1):
            c, d, alpha, beta = field[m, n, 0], field[m, n, 1], field[m, n, 2], field[m, n, 3]
            below_c, below_d = field[m, n, 4], field[m, n, 5]
            weight = float(n + m + 1)
            if n > m:
                for j in range(LANES):
                    following = step[j] * (alpha * u[j] * legendre[j] - step[j] * beta * previous[j])
                    previous[j], legendre[j] = legendre[j], following
            for j in range(LANES):
                of_c, of_d = legendre[j] * c, legendre[j] * d
                sum_c[j] += of_c
                sum_s[j] += of_d
                radial_c[j] += weight * of_c
                radial_s[j] += weight * of_d
                coupled_c[j] += legendre[j] * below_c
                coupled_s[j] += legendre[j] * below_d
        for j in range(LANES):
            along_u = coupled_c[j] * real_below[j] + coupled_s[j] * imaginary_below[j]
            a1[j] += m * (sum_c[j] * real_below[j] + sum_s[j] * imaginary_below[j])
            a2[j] += m * (sum_s[j] * real_below[j] - sum_c[j] * imaginary_below[j])
            a3[j] += along_u
            a4[j] -= radial_c[j] * real[j] + radial_s[j] * imaginary[j] + u[j] * along_u
    for j in range(LANES):
        out[j, 0], out[j, 1], out[j, 2] = a1[j] + s[j] * a4[j], a2[j] + t[j] * a4[j], a3[j] + u[j] * a4[j]


@kernel
def harmonics(params, field, x, y, z):
    """Return the acceleration by the harmonics at one place, m/s^2, as three floats; see ``harmonics_of_four``."""
    positions, out = stack.matrix(LANES, 3), stack.matrix(LANES, 3)
    for j in range(LANES):
        positions[j, 0], positions[j, 1], positions[j, 2] = x, y, z
    harmonics_of_four(params, field, positions, out)
    return out[0, 0], out[0, 1], out[0, 2]


@kernel
def perturbation(params, field, t_s, x, y, z):
    """Return the harmonics' acceleration, m/s^2, in inertial axes, as three floats, for x, y, z in m, inertial.

    The body rotates about inertial z, at ``params.rate``; ``t_s`` counts from the start of the run.
    """
    if params.degree < 2:
        return 0.0, 0.0, 0.0
    angle = params.rotation + params.rate * t_s
    c, s = elementary.cos(angle), elementary.sin(angle)
    fixed_x, fixed_y, fixed_z = harmonics(params, field, c * x + s * y, c * y - s * x, z)
    return c * fixed_x - s * fixed_y, s * fixed_x + c * fixed_y, fixed_z


@kernel
def central_pull(gm, r, out):
    """Write the gravity (3,), m/s^2, of a point mass of ``gm``, m^3/s^2, at ``r`` (3,), m."""
    squared = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    central = -gm / (squared * math.sqrt(squared))
    for i in range(3):
        out[i] = central * r[i]


@kernel
def acceleration(params, field, t_s, r, out):
    """Write the gravity (3,), m/s^2, at ``r`` (3,), m, both in inertial axes with the origin at the body's centre."""
    px, py, pz = perturbation(params, field, t_s, r[0], r[1], r[2])
    central_pull(params.gm, r, out)
    out[0] += px
    out[1] += py
    out[2] += pz


@kernel
def point_mass_differential(gm, r_T, rho, target, difference):
    """Write the target's gravity and the chaser's minus the target's, each (3,), m/s^2, of a point mass.

    gm: m^3/s^2. r_T: (3,), m, of the target. rho: (3,), m, chaser relative to target. The difference is taken after
    Battin (An Introduction to the Mathematics and Methods of Astrodynamics, 1999, section 8.4): with
    ``q = rho.(rho + 2 r) / r^2`` it is ``-GM/r^3 (rho + f(q) (r + rho))`` and nothing cancels.
    """
    squared = r_T[0] * r_T[0] + r_T[1] * r_T[1] + r_T[2] * r_T[2]
    q = (
        rho[0] * (rho[0] + 2.0 * r_T[0]) + rho[1] * (rho[1] + 2.0 * r_T[1]) + rho[2] * (rho[2] + 2.0 * r_T[2])
    ) / squared
    power = math.sqrt(1.0 + q)
    power = power * (1.0 + q)  # (1 + q)^(3/2) = (|r + rho| / |r|)^3
    f = -q * (3.0 + 3.0 * q + q * q) / (power * (1.0 + power))  # (1 + q)^(-3/2) - 1
    central = -gm / (squared * math.sqrt(squared))
    for i in range(3):
        target[i] = central * r_T[i]
        difference[i] = central * (rho[i] + f * (r_T[i] + rho[i]))


@kernel
def sample_perturbation(params, field, t_s, r_T, v_T, rho, rho_rate, dt, held):
    """Write the harmonics' accelerations of a span of ``dt``, s, from ``t_s`` on, m/s^2, into ``held`` (4, 3).

    Rows: the target's at the start, in the middle and at the end of the span, and the chaser's minus the target's in
    the middle, which stands for the whole span: plain differences are good to 1e-19 m/s^2. r_T: (3,), m, and v_T:
    (3,), m/s, of the target, inertial; rho: (3,), m, and rho_rate: (3,), m/s, of the chaser relative to it. The places
    are those of a parabola under the point mass; what that leaves out moves them by a micrometre.
    """
    if params.degree < 2:
        for row in range(4):
            held[row, 0], held[row, 1], held[row, 2] = 0.0, 0.0, 0.0
        return
    positions, pull = stack.matrix(LANES, 3), stack.matrix(LANES, 3)
    cosine, sine = stack.vector(LANES), stack.vector(LANES)
    squared = r_T[0] * r_T[0] + r_T[1] * r_T[1] + r_T[2] * r_T[2]
    central = -params.gm / (squared * math.sqrt(squared))
    for row in range(4):
        t = 0.5 * (1 if row == 3 else row) * dt
        reach = 1.0 + 0.5 * t * t * central
        x, y, z = reach * r_T[0] + t * v_T[0], reach * r_T[1] + t * v_T[1], reach * r_T[2] + t * v_T[2]
        if row == 3:
            cosine[3], sine[3] = cosine[1], sine[1]
            x, y, z = x + rho[0] + t * rho_rate[0], y + rho[1] + t * rho_rate[1], z + rho[2] + t * rho_rate[2]
        else:
            angle = params.rotation + params.rate * (t_s + t)
            cosine[row], sine[row] = elementary.cos(angle), elementary.sin(angle)
        positions[row, 0] = cosine[row] * x + sine[row] * y
        positions[row, 1] = cosine[row] * y - sine[row] * x
        positions[row, 2] = z
    harmonics_of_four(params, field, positions, pull)
    for row in range(4):
        held[row, 0] = cosine[row] * pull[row, 0] - sine[row] * pull[row, 1]
        held[row, 1] = sine[row] * pull[row, 0] + cosine[row] * pull[row, 1]
        held[row, 2] = pull[row, 2]
    for i in range(3):
        held[3, i] -= held[1, i]


@kernel
def differential(params, field, t_s, r_T, rho, target, difference):
    """Write the target's gravity and the chaser's minus the target's, each (3,), m/s^2, under the whole field.

    params: GRAVITY_PARAMS. Arguments as for ``point_mass_differential``; the truth's step holds the harmonics' part.
    """
    point_mass_differential(params.gm, r_T, rho, target, difference)
    tx, ty, tz = perturbation(params, field, t_s, r_T[0], r_T[1], r_T[2])
    px, py, pz = perturbation(params, field, t_s, r_T[0] + rho[0], r_T[1] + rho[1], r_T[2] + rho[2])
    target[0] += tx
    target[1] += ty
    target[2] += tz
    difference[0] += px - tx
    difference[1] += py - ty
    difference[2] += pz - tz
