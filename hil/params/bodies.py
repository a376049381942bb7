"""Records of convex bodies from their configuration."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.config.bodies import BenchBody, SpacecraftBody
from hil.core.messages import new
from hil.models.bodies import BODIES


def bodies(
    given: Sequence[SpacecraftBody | BenchBody], on: str, offset_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> np.record:
    """Return BODIES of those ``on`` one kind. offset_m: from the origin of the record's frame to that of the bodies."""
    found = new(BODIES)
    chosen = [(number, body) for number, body in enumerate(given, 1) if body.on == on]
    found.n, found.low, found.high = len(chosen), math.inf, -math.inf
    for k, (number, body) in enumerate(chosen):
        points = np.array(body.vertices_m) + np.array(offset_m)
        centre = points.mean(axis=0)
        found.number[k], found.vertices[k], found.radius[k] = number, len(points), body.radius_m
        found.vertex[k, : len(points)] = points
        found.centre[k] = centre
        found.reach[k] = body.radius_m + np.linalg.norm(points - centre, axis=1).max()
        found.arm[k] = body.radius_m + np.linalg.norm(points, axis=1).max()
        found.low = np.minimum(found.low, points.min(axis=0) - body.radius_m)
        found.high = np.maximum(found.high, points.max(axis=0) + body.radius_m)
        found.farthest = max(float(found.farthest), float(found.arm[k]))
    return found
