"""Sunlight: fraction that the central body leaves visible, and its pressure on the solar array, a flat plate.

The plate is fixed to the hub. The target has no array in this model, so the force acts on the chaser only; shadows of
the vehicles on each other are not modelled.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary


@kernel
def visible_sun(radius, sun_angle, r, sun):
    """Return the fraction of the Sun's disc, 0 to 1, that a sphere of ``radius``, m, about the origin leaves visible.

    sun_angle: rad, apparent radius of the Sun. r: (3,), m, outside the sphere. sun: (3,), unit vector to the Sun, in
    the axes of r. Umbra and penumbra are cones (Montenbruck and Gill, Satellite Orbits, 2000, section 3.4.2); the Sun's
    direction is the same everywhere in the orbit.
    """
    distance = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    a, b = sun_angle, elementary.asin(min(1.0, radius / distance))
    cosine = -(r[0] * sun[0] + r[1] * sun[1] + r[2] * sun[2]) / distance
    c = elementary.acos(min(1.0, max(-1.0, cosine)))
    if c >= a + b:
        return 1.0
    if c <= b - a:
        return 0.0
    if c <= a - b:
        return 1.0 - (b / a) ** 2
    x = (c * c + a * a - b * b) / (2.0 * c)
    y = math.sqrt(max(0.0, a * a - x * x))
    covered = a * a * elementary.acos(min(1.0, max(-1.0, x / a)))
    covered += b * b * elementary.acos(min(1.0, max(-1.0, (c - x) / b))) - c * y
    return 1.0 - covered / (math.pi * a * a)


SOLAR_PRESSURE_PA = 4.56e-6  # at 1 au: Montenbruck and Gill, Satellite Orbits (2000), section 3.4

PLATE_PARAMS = np.dtype(
    [
        ("area", "f8"),  # m^2
        ("pressure", "f8"),  # Pa, of sunlight outside shadows
        ("normal", "f8", 3),  # unit vector, in c
        ("arm", "f8", 3),  # m, from the centre of mass to the plate's centre, in c
        ("specular", "f8"),  # fraction of the light that is reflected specularly
        ("diffuse", "f8"),  # fraction that is reflected diffusely
    ],
    align=True,
)


@kernel
def pressure_force(plate, pressure, sun_C, out):
    """Write the force (3,), N, in c: ``-P A cos(a) [(1 - rho_s) s + 2 (rho_s cos(a) + rho_d / 3) n]``.

    plate: PLATE_PARAMS. pressure: Pa, of the light that arrives. sun_C: (3,), unit vector to the Sun, in c. n is the
    normal of the lit side, a its angle from the Sun. Source: Wertz, Spacecraft Attitude Determination and Control
    (1978), section 17.2.2; one plate, both sides equal.
    """
    cosine = plate.normal[0] * sun_C[0] + plate.normal[1] * sun_C[1] + plate.normal[2] * sun_C[2]
    side = math.copysign(1.0, cosine)
    cosine = abs(cosine)
    along_sun = -pressure * plate.area * cosine * (1.0 - plate.specular)
    along_normal = -2.0 * pressure * plate.area * cosine * (plate.specular * cosine + plate.diffuse / 3.0)
    for i in range(3):
        out[i] = along_sun * sun_C[i] + along_normal * side * plate.normal[i]
