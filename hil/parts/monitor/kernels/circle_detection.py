"""Circle detection: complete circles and arcs from the borders of the regions above each threshold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.core.jit import kernel
from hil.parts.monitor.preprocess import Prepared

Floats = NDArray[np.float64]

_FEWEST_POINTS: Final = 24
_TRIES: Final = 60
_CONTOURS: Final = 12  # per threshold, the longest ones
_MOST_POINTS: Final = 720
_BEND: Final = 0.012
_LEAST_CLEAN: Final = 0.25
_LEAST_RADIUS_PX: Final = 9.0


@dataclass(frozen=True)
class CircleCandidate:
    """A circle in the image, px; ``coverage``: visible fraction, ``clean``: fraction of its border's points on it."""

    u: float
    v: float
    radius: float
    coverage: float
    clean: float


@kernel
def _through(points, i, j, k):
    """Return the circle (u, v, radius) through three points; radius -1 if they are collinear."""
    x1, y1 = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    x2, y2 = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
    twice = 2.0 * (x1 * y2 - x2 * y1)
    if abs(twice) < 1e-6:
        return 0.0, 0.0, -1.0
    a, b = x1 * x1 + y1 * y1, x2 * x2 + y2 * y2
    u, v = (y2 * a - y1 * b) / twice, (x1 * b - x2 * a) / twice
    return points[i, 0] + u, points[i, 1] + v, math.hypot(u, v)


@kernel
def fit_circle(points, near, start, turns):
    """Fit a circle to the ``points`` (n, 2) within ``near`` px of ``start`` (3,): u, v, radius, by Gauss-Newton.

    ``start`` is improved in place (monitor paper 3, Phi_2). Return the fraction of the points used (0 on failure).
    """
    n = points.shape[0]
    used = 0
    for _ in range(turns):
        s00, s01, s02, s11, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        t0, t1, t2 = 0.0, 0.0, 0.0
        used = 0
        for i in range(n):
            du, dv = points[i, 0] - start[0], points[i, 1] - start[1]
            distance = math.hypot(du, dv)
            residual = distance - start[2]
            if abs(residual) > near or distance <= 0.0:
                continue
            used += 1
            a, b = du / distance, dv / distance
            s00 += a * a
            s01 += a * b
            s02 += a
            s11 += b * b
            s12 += b
            s22 += 1.0
            t0 += a * residual
            t1 += b * residual
            t2 += residual
        c00, c01, c02 = s11 * s22 - s12 * s12, s02 * s12 - s01 * s22, s01 * s12 - s02 * s11
        det = s00 * c00 + s01 * c01 + s02 * c02
        if used < 6 or abs(det) < 1e-9:
            return 0.0
        c11, c12, c22 = s00 * s22 - s02 * s02, s01 * s02 - s00 * s12, s00 * s11 - s01 * s01
        start[0] += (c00 * t0 + c01 * t1 + c02 * t2) / det
        start[1] += (c01 * t0 + c11 * t1 + c12 * t2) / det
        start[2] += (c02 * t0 + c12 * t1 + c22 * t2) / det
        if not (math.isfinite(start[2]) and 1.0 < start[2] < 1e5):
            return 0.0
    return used / n


@kernel
def best_circle(points, tries, near, bend, out):
    """Write the circle (3,) with the most of ``points`` (n, 2) within ``near`` px; return their fraction.

    bend: tolerance as a fraction of the radius, if larger: a circle seen obliquely is an ellipse.
    Triples of points are drawn by a fixed sequence: the same points give the same circle.
    """
    n = points.shape[0]
    most = 0
    seed = 12345
    for attempt in range(tries):
        seed = (1103515245 * seed + 12345) % 2147483648
        i = (seed >> 8) % n
        # far apart for complete circles, nearer together for arcs that are part of a longer border
        apart = n // (3 if attempt % 3 == 0 else (6 if attempt % 3 == 1 else 10))
        seed = (1103515245 * seed + 12345) % 2147483648
        j = (i + apart - apart // 2 + (seed >> 8) % max(apart, 1)) % n
        seed = (1103515245 * seed + 12345) % 2147483648
        k = (i + 2 * apart - apart // 2 + (seed >> 8) % max(apart, 1)) % n
        u, v, radius = _through(points, i, j, k)
        if radius < 3.0 or radius > 4000.0:
            continue
        inside = 0
        reach = max(near, bend * radius)
        for m in range(n):
            if abs(math.hypot(points[m, 0] - u, points[m, 1] - v) - radius) < reach:
                inside += 1
        if inside > most:
            most = inside
            out[0], out[1], out[2] = u, v, radius
        if most > 0.95 * n:
            break
    if most == 0:
        return 0.0
    return fit_circle(points, max(near, bend * out[2]), out, 4)


@kernel
def arc_coverage(points, circle, near):
    """Return the fraction of the circle's 72 sectors that have a point within ``near`` px of it."""
    seen = np.zeros(72)
    for i in range(points.shape[0]):
        du, dv = points[i, 0] - circle[0], points[i, 1] - circle[1]
        if abs(math.hypot(du, dv) - circle[2]) < near:
            seen[int((math.atan2(dv, du) / (2.0 * math.pi) + 1.0) * 72.0) % 72] = 1.0
    return seen.sum() / 72.0


def find_circles(prepared: Prepared, left: float, top: float, line_step: float) -> list[CircleCandidate]:
    """Return the circles of a region, the best first.

    left, top: px, the region's first pixel in the image; line_step: px from one line of the region to the next.
    """
    circles: list[CircleCandidate] = []
    for level in prepared.thresholds:
        _, binary = cv2.threshold(prepared.image, level, 255, cv2.THRESH_BINARY)
        contours: Any = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
        contours = sorted((c for c in contours if len(c) >= _FEWEST_POINTS), key=len, reverse=True)[:_CONTOURS]
        for contour in contours:
            shape = _circle_of(contour, prepared.image.shape, left, top, line_step)
            if shape is not None:
                circles.append(shape)
    circles.sort(key=lambda one: one.coverage * one.clean, reverse=True)
    return _distinct(circles)


def _circle_of(
    contour: Any, shape: tuple[int, ...], left: float, top: float, line_step: float
) -> CircleCandidate | None:
    points = contour.reshape(-1, 2).astype(float)
    inner = (points[:, 0] > 1) & (points[:, 0] < shape[1] - 2) & (points[:, 1] > 1) & (points[:, 1] < shape[0] - 2)
    points = points[inner]
    if len(points) < _FEWEST_POINTS:
        return None
    if len(points) > _MOST_POINTS:
        points = points[:: len(points) // _MOST_POINTS + 1]
    points = np.ascontiguousarray(points * [1.0, line_step] + [left, top])
    circle = np.zeros(3)
    near = 1.2 * line_step
    clean = best_circle(points, _TRIES, near, _BEND, circle)
    if clean < _LEAST_CLEAN or circle[2] < _LEAST_RADIUS_PX:
        return None
    near = max(near, 1.3 * _BEND * circle[2])
    share = arc_coverage(points, circle, near)
    if share < 0.22:
        return None
    return CircleCandidate(float(circle[0]), float(circle[1]), float(circle[2]), share, clean)


def _distinct(circles: list[CircleCandidate]) -> list[CircleCandidate]:
    kept: list[CircleCandidate] = []
    for one in circles:
        reach = 0.04 * one.radius + 2.0
        if all(
            math.hypot(one.u - other.u, one.v - other.v) > reach or abs(one.radius - other.radius) > reach
            for other in kept
        ):
            kept.append(one)
    return kept
