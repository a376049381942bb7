"""Target's orbit: position and velocity from elements, and their Hill frame."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, quat
from hil.maths.elementary import square


def state_of_elements(
    gm: float,
    semi_major_axis_m: float,
    eccentricity: float,
    inclination: float,
    raan: float,
    argument_of_periapsis: float,
    true_anomaly: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return r_T_I, m, and v_T_I, m/s, each (3,), of Keplerian elements; gm in m^3/s^2, angles in rad.

    Source: Vallado, Fundamentals of Astrodynamics and Applications, 4th ed., algorithm 10. An ellipse only.
    """
    p = semi_major_axis_m * (1.0 - square(eccentricity))
    c, s = elementary.cos(true_anomaly), elementary.sin(true_anomaly)
    r = p / (1.0 + eccentricity * c)
    speed = math.sqrt(gm / p)
    co, so = elementary.cos(raan), elementary.sin(raan)
    cw, sw = elementary.cos(argument_of_periapsis), elementary.sin(argument_of_periapsis)
    ci, si = elementary.cos(inclination), elementary.sin(inclination)
    to_periapsis = np.array([co * cw - so * sw * ci, so * cw + co * sw * ci, sw * si])
    ahead = np.array([-co * sw - so * cw * ci, -so * sw + co * cw * ci, cw * si])
    position = r * (c * to_periapsis + s * ahead)
    velocity = speed * (-s * to_periapsis + (eccentricity + c) * ahead)
    return position, velocity


@kernel
def hill_frame(r, v, a):
    """Write A(q_HI) (3, 3): rows are the axes of H in inertial axes, z to the central body, y against the orbit normal.

    r: (3,), m, and v: (3,), m/s, of the target, inertial; they must not be parallel. x = y x z is along v in a
    circular orbit, otherwise along its horizontal part.
    """
    hx, hy, hz = r[1] * v[2] - r[2] * v[1], r[2] * v[0] - r[0] * v[2], r[0] * v[1] - r[1] * v[0]
    h = math.sqrt(hx * hx + hy * hy + hz * hz)
    distance = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    across, down = -1.0 / h, -1.0 / distance
    a[1, 0], a[1, 1], a[1, 2] = hx * across, hy * across, hz * across
    for i in range(3):
        a[2, i] = r[i] * down
    a[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    a[0, 1] = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    a[0, 2] = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]


@kernel
def hill_rate(r, v, acceleration, a, out):
    """Write w_HI_H (3,), rad/s: ``[0, -h / r^2, -r a_h / h]``, with a_h the acceleration along the orbit normal.

    acceleration: (3,), m/s^2, of the target, inertial. a: its ``hill_frame``. Source: the rate of the radial,
    transverse, normal triad (Gauss' variational equations; Battin 1999, section 10.4), seen in H.
    """
    distance = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    transverse = a[0, 0] * v[0] + a[0, 1] * v[1] + a[0, 2] * v[2]
    normal = -(a[1, 0] * acceleration[0] + a[1, 1] * acceleration[1] + a[1, 2] * acceleration[2])
    out[0] = 0.0
    out[1] = -transverse / distance
    out[2] = -normal / transverse


@kernel
def rotate_on_circle(r, v, angle):
    """Rotate ``r`` and ``v`` (3,), orthogonal to each other, by ``angle``, rad, in their plane, in place."""
    c, s = elementary.cos(angle), elementary.sin(angle)
    distance = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for i in range(3):
        radial, ahead = r[i] / distance, v[i] / speed
        r[i] = distance * (c * radial + s * ahead)
        v[i] = speed * (c * ahead - s * radial)


@kernel
def quaternion_near(a, previous, q):
    """Write the unit quaternion of ``a`` (3, 3) with the sign of ``previous`` (4,) into ``q``: no jumps in orbit."""
    quat.from_matrix_into(a, q)
    if q[0] * previous[0] + q[1] * previous[1] + q[2] * previous[2] + q[3] * previous[3] < 0.0:
        for i in range(4):
            q[i] = -q[i]
