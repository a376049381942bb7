"""Shadow of the central body: the visible fraction of the Sun's disc."""

from __future__ import annotations

import math

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
