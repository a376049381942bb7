"""Detection of an outline with corners: borders of the regions above each threshold that have its shape.

A border that leaves the region has another shape; so have borders of which a part is hidden.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.parts.monitor.kernels.patterns import LARGEST_ROLL
from hil.parts.monitor.preprocess import Prepared

Floats = NDArray[np.float64]

_CONTOURS: Final = 12  # per threshold, the longest ones
_FEWEST_POINTS: Final = 24
_COMPARED: Final = 96  # points of a border
_LEAST_RADIUS_PX: Final = 9.0
_ROLLS: Final = np.linspace(-LARGEST_ROLL, LARGEST_ROLL, 41)
_LARGEST_MISFIT: Final = 0.05
_CANDIDATES: Final = 6


@dataclass(frozen=True)
class PolygonCandidate:
    """An outline in the image: its centroid and the radius of the circle of its area, px; roll, rad.

    misfit: median distance of the border from the polygon, as a fraction of the radius.
    """

    u: float
    v: float
    radius: float
    roll: float
    misfit: float


def find_polygons(
    prepared: Prepared, left: float, top: float, line_step: float, corners: Floats
) -> list[PolygonCandidate]:
    """Return the borders of a region that have the shape of ``corners``, the best first.

    left, top: px, the region's first pixel in the image; line_step: px from one line of the region to the next.
    corners: (n, 2), relative to the polygon's centroid and to the radius of the circle of its area.
    """
    candidates: list[PolygonCandidate] = []
    for points in _borders(prepared):
        places = points * [1.0, line_step] + [left, top]
        area, centroid = _area_and_centroid(places)
        radius = math.sqrt(area / math.pi)
        if radius < _LEAST_RADIUS_PX:
            continue
        step = -(-len(places) // _COMPARED)
        misfits = _misfits((places[::step] - centroid) / radius, corners)
        candidates += [
            PolygonCandidate(float(centroid[0]), float(centroid[1]), radius, float(_ROLLS[k]), float(misfits[k]))
            for k in _local_minima(misfits)
            if misfits[k] < _LARGEST_MISFIT
        ]
    # of rolls that fit equally well the smallest
    return sorted(candidates, key=lambda one: (round(one.misfit, 2), abs(one.roll)))[:_CANDIDATES]


def _borders(prepared: Prepared) -> Iterator[Floats]:
    """Yield the borders (n, 2) of the regions above each threshold, px of the prepared image."""
    height, width = prepared.image.shape
    for level in prepared.thresholds:
        _, binary = cv2.threshold(prepared.image, level, 255, cv2.THRESH_BINARY)
        contours: Any = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
        for contour in sorted(contours, key=len, reverse=True)[:_CONTOURS]:
            points = contour.reshape(-1, 2).astype(float)
            low, high = points.min(axis=0), points.max(axis=0)
            if len(points) >= _FEWEST_POINTS and min(low) > 1 and high[0] < width - 2 and high[1] < height - 2:
                yield points


def _area_and_centroid(points: Floats) -> tuple[float, Floats]:
    """Return the area and the centroid (2,) of the polygon ``points`` (n, 2); the mean point without an area."""
    middle = points.mean(axis=0)
    one = points - middle
    other = np.roll(one, -1, axis=0)
    twice = one[:, 0] * other[:, 1] - other[:, 0] * one[:, 1]
    area = 0.5 * float(twice.sum())
    if abs(area) < 1.0:
        return 0.0, middle
    return abs(area), middle + ((one + other) * twice[:, None]).sum(axis=0) / (6.0 * area)


def _misfits(points: Floats, corners: Floats) -> Floats:
    """Return the median distance of ``points`` (n, 2) from the polygon's border at each of the rolls."""
    c, s = np.cos(_ROLLS)[:, None], np.sin(_ROLLS)[:, None]
    turned = np.stack((c * points[:, 0] + s * points[:, 1], c * points[:, 1] - s * points[:, 0]), axis=-1)
    edges = np.roll(corners, -1, axis=0) - corners
    along = ((turned[:, :, None] - corners) * edges).sum(axis=-1) / (edges**2).sum(axis=-1)
    nearest = corners + np.clip(along, 0.0, 1.0)[..., None] * edges
    distances = np.linalg.norm(turned[:, :, None] - nearest, axis=-1).min(axis=-1)
    return np.asarray(np.median(distances, axis=1))


def _local_minima(values: Floats) -> list[int]:
    """Return the places of the minima of ``values``, of a plateau its first place."""
    before, after = np.append(np.inf, values[:-1]), np.append(values[1:], np.inf)
    return [int(k) for k in np.flatnonzero((values < before) & (values <= after))]
