"""Forces on target and chaser besides the gravity of the central body: drag of its atmosphere, and third bodies.

Both are sampled with the harmonics of the central body and kept over the same span (``cached_gravity``).
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_AIR_LAYERS, MAX_THIRD_BODIES
from hil.dynamics.central_gravity import central_pull, point_mass_differential
from hil.maths import elementary, stack
from hil.maths.arrays import fill

ORBIT_FORCES = np.dtype(
    [
        ("acts", "i8"),  # 0: none of them
        ("radius", "f8"),  # m, of the sphere from which altitudes count
        ("spin", "f8"),  # rad/s, of the atmosphere about inertial z
        ("layers", "i8"),  # layers of the atmosphere, 0 without drag
        ("altitude", "f8", MAX_AIR_LAYERS),  # m, base of each layer, increasing
        ("density", "f8", MAX_AIR_LAYERS),  # kg/m^3, at the base
        ("scale_height", "f8", MAX_AIR_LAYERS),  # m
        ("target_drag", "f8"),  # m^2/kg, drag coefficient times area over mass
        ("chaser_drag", "f8"),  # m^2/kg
        ("bodies", "i8"),
        ("body_gm", "f8", MAX_THIRD_BODIES),  # m^3/s^2
        ("body_position", "f8", (MAX_THIRD_BODIES, 3)),  # m, from the central body at the start of the run, inertial
        ("body_pole", "f8", (MAX_THIRD_BODIES, 3)),  # unit vector of its motion, inertial
        ("body_rate", "f8", MAX_THIRD_BODIES),  # rad/s, about the pole
    ],
    align=True,
)


@kernel
def air_density(params, altitude):
    """Return the density of the atmosphere, kg/m^3, at ``altitude``, m: exponential within each layer.

    params: ORBIT_FORCES. The lowest layer extends downwards, the highest upwards.
    """
    layer = 0
    while layer + 1 < params.layers and altitude >= params.altitude[layer + 1]:
        layer += 1
    return params.density[layer] * elementary.exp(-(altitude - params.altitude[layer]) / params.scale_height[layer])


@kernel
def add_drag(params, drag, r, v, out):
    """Add the acceleration by drag, m/s^2, to ``out`` (3,); the atmosphere rotates with the central body.

    params: ORBIT_FORCES. drag: m^2/kg, drag coefficient times area over mass. r: (3,), m, and v: (3,), m/s, inertial.
    ``-1/2 rho C_D A / m |u| u``, with u the velocity in the atmosphere (Vallado, Fundamentals of Astrodynamics and
    Applications, 4th ed., section 8.6.2).
    """
    distance = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    x, y, z = v[0] + params.spin * r[1], v[1] - params.spin * r[0], v[2]
    speed = math.sqrt(x * x + y * y + z * z)
    factor = -0.5 * air_density(params, distance - params.radius) * drag * speed
    out[0] += factor * x
    out[1] += factor * y
    out[2] += factor * z


@kernel
def place_third_body(position, pole, angle, out):
    """Write ``position`` (3,), m, rotated by ``angle``, rad, about the unit vector ``pole`` (3,), into ``out`` (3,)."""
    c, s, p, k = elementary.cos(angle), elementary.sin(angle), position, pole
    along = (1.0 - c) * (k[0] * p[0] + k[1] * p[1] + k[2] * p[2])
    out[0] = c * p[0] + s * (k[1] * p[2] - k[2] * p[1]) + along * k[0]
    out[1] = c * p[1] + s * (k[2] * p[0] - k[0] * p[2]) + along * k[1]
    out[2] = c * p[2] + s * (k[0] * p[1] - k[1] * p[0]) + along * k[2]


@kernel
def add_third_bodies(params, t_s, r, apart, pull, difference):
    """Add the acceleration by third bodies, m/s^2, at ``r`` to ``pull``, and what it grows by over ``apart``.

    params: ORBIT_FORCES. t_s: time of the run. r, apart: (3,), m, inertial. pull, difference: (3,). A third body pulls
    the central body too: what counts is its gravity at r less that at the origin.
    """
    away, unused, grown = stack.vector(3), stack.vector(3), stack.vector(3)
    for k in range(params.bodies):
        place_third_body(params.body_position[k], params.body_pole[k], params.body_rate[k] * t_s, away)
        for i in range(3):
            away[i] = -away[i]
        point_mass_differential(params.body_gm[k], away, r, unused, grown)
        for i in range(3):
            pull[i] += grown[i]
            away[i] += r[i]
        point_mass_differential(params.body_gm[k], away, apart, unused, grown)
        for i in range(3):
            difference[i] += grown[i]


@kernel
def add_orbit_forces(params, gm, t_s, r_T, v_T, rho, rho_rate, dt, pull, drag):
    """Add drag and third bodies over a span of ``dt``, s, from ``t_s`` on, m/s^2, to ``pull`` (4, 3).

    params: ORBIT_FORCES. gm: m^3/s^2, of the central body. Other arguments, rows and places as for
    ``central_gravity.sample_perturbation``. drag: (3,), written: the chaser's acceleration by drag in the middle of the
    span, which its accelerometers measure.
    """
    r, v, central = stack.vector(3), stack.vector(3), stack.vector(3)
    apart, on_target, unused = stack.vector(3), stack.vector(3), stack.vector(3)
    central_pull(gm, r_T, central)
    fill(drag, 0.0)
    for row in range(3):
        t = 0.5 * row * dt
        for i in range(3):
            r[i] = r_T[i] + t * v_T[i] + 0.5 * t * t * central[i]
            v[i] = v_T[i] + t * central[i]
            apart[i] = rho[i] + t * rho_rate[i]
            on_target[i], unused[i] = 0.0, 0.0
        if row == 1:
            add_third_bodies(params, t_s + t, r, apart, pull[1], pull[3])
        else:
            add_third_bodies(params, t_s + t, r, apart, pull[row], unused)
        if params.layers > 0:
            add_drag(params, params.target_drag, r, v, on_target)
            for i in range(3):
                pull[row, i] += on_target[i]
                r[i] += apart[i]
                v[i] += rho_rate[i]
            if row == 1:
                add_drag(params, params.chaser_drag, r, v, drag)
                for i in range(3):
                    pull[3, i] += drag[i] - on_target[i]
