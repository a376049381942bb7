"""Edge samples: places along the projected edges of the target at which the edge's shift is measured.

A sample is a strip a few pixels long along an edge and a few wide across it. No pixel belongs to two samples of one
edge, so the errors of the samples' measurements are independent.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.models import docking_view

STEP, BAR = 0, 1

EDGE_SAMPLE = np.dtype(
    [
        ("u", "f8"), ("v", "f8"),  # px, the point of the edge (of the bar's centre line) under the assumed pose
        ("nu", "f8"), ("nv", "f8"),  # the edge's normal in the image, outwards
        ("curvature", "f8"),  # 1/px, positive where the inside is convex
        ("length", "f8"),  # px along the edge
        ("inside", "f8"), ("outside", "f8"),  # px, extent of the strip to either side
        ("width", "f8"),  # px, of a bar measured as a whole
        ("y1", "f8"), ("y2", "f8"), ("y3", "f8"),  # m, the same point in C
        ("feature", "i8"), ("kind", "i8"),
        ("cluster", "i8"),  # the straight edge, or the eighth of a circle, of the sample
        ("shift", "f8"), ("variance", "f8"),  # px, px^2: measured, outwards
        ("low", "f8"), ("high", "f8"),  # grey values inside and outside
        ("misfit", "f8"), ("pixels", "f8"),  # weighted square sum of the pixels' residuals, number of pixels
        ("steepness", "f8"),  # px^-2, information of the pixels on the shift alone
        ("grows", "f8"),  # 1: a border whose outside is at the normal's end, -1: at its start, 0: a bar by both borders
        ("good", "i8"),
    ],
    align=True,
)  # fmt: skip

ARCS = 8
SIDES = 3

_GUARD_SIGMAS = 3.0  # distance of the strip from other borders, in blur widths


@kernel
def _project(lens, a, d, y1, y2, y3):
    """Return (u, v, depth) of a point of C."""
    p = np.empty(3)
    p[0], p[1], p[2] = y1, y2, y3
    x = docking_view.to_camera(a, d, p)
    if x[2] < 1e-3:
        return 0.0, 0.0, -1.0
    u, v = docking_view.project_point(lens[0], lens[1], lens[2], x)
    return u, v, x[2]


@kernel
def project_borders(lens, a, d, circles, borders, circles_px, lines_px):
    """Write the images of the parts' borders.

    circles_px: (n, 4): u, v, radius, px, group (radius -1 if behind the camera). lines_px: (m, 5): both
    ends, px, group (nan if behind the camera).
    """
    for i in range(circles.shape[0]):
        c = circles[i]
        u, v, depth = _project(lens, a, d, c.y1, c.y2, c.y3)
        circles_px[i, 0], circles_px[i, 1], circles_px[i, 3] = u, v, c.group
        circles_px[i, 2] = lens[0] * c.radius / depth if depth > 0.0 else -1.0
    for i in range(borders.shape[0]):
        b = borders[i]
        u0, v0, d0 = _project(lens, a, d, b.a1, b.a2, b.y3)
        u1, v1, d1 = _project(lens, a, d, b.b1, b.b2, b.y3)
        ok = d0 > 0.0 and d1 > 0.0
        lines_px[i, 0] = u0 if ok else np.nan
        lines_px[i, 1], lines_px[i, 2], lines_px[i, 3], lines_px[i, 4] = v0, u1, v1, b.group


@kernel
def _distance(u, v, s):
    """Return the distance of (u, v) from the line segment ``s``, px; nan if there is none."""
    du, dv = s[2] - s[0], s[3] - s[1]
    square = du * du + dv * dv
    along = 0.0
    if square > 0.0:
        along = min(max(((u - s[0]) * du + (v - s[1]) * dv) / square, 0.0), 1.0)
    return math.hypot(u - s[0] - along * du, v - s[1] - along * dv)


@kernel
def _clearance(u, v, group, circles_px, lines_px):
    """Return the distance of (u, v) from the nearest border of another group, px."""
    least = math.inf
    for i in range(circles_px.shape[0]):
        if circles_px[i, 3] != group and circles_px[i, 2] > 0.0:
            gap = abs(math.hypot(u - circles_px[i, 0], v - circles_px[i, 1]) - circles_px[i, 2])
            least = min(least, gap)
    for i in range(lines_px.shape[0]):
        if lines_px[i, 4] != group:
            gap = _distance(u, v, lines_px[i])
            if gap < least:
                least = gap
    return least


@kernel
def _reach(u, v, nu, nv, extent, half_length, guard, group, circles_px, lines_px):
    """Return the free distance from (u, v) along (nu, nv) to other borders, at most ``extent``, px."""
    needed = guard + half_length * 0.5
    free = _clearance(u, v, group, circles_px, lines_px) - needed
    if free >= extent:
        return extent
    if free < 0.0:
        return -1.0
    reach = free
    for _ in range(4):  # sphere tracing: advance by the free distance at the current end
        free = _clearance(u + reach * nu, v + reach * nv, group, circles_px, lines_px) - needed
        if free <= 0.05:
            break
        reach = min(reach + free, extent)
    return reach


@kernel
def _in_picture(lens, u, v, margin):
    return margin <= u <= lens[3] - 1.0 - margin and margin <= v <= lens[4] - 1.0 - margin


@kernel
def _finish(sample, lens, extent, least, blur, group, circles_px, lines_px):
    """Set the extent of the strip; return whether enough of it is free and in the image."""
    if not _in_picture(lens, sample.u, sample.v, extent + 0.5 * sample.length + 0.5 * sample.width):
        return False
    guard = _GUARD_SIGMAS * blur
    half = 0.5 * sample.width
    half_length = 0.5 * sample.length
    outside = _reach(sample.u + half * sample.nu, sample.v + half * sample.nv, sample.nu, sample.nv,
                     extent, half_length, guard, group, circles_px, lines_px)  # fmt: skip
    inside = _reach(sample.u - half * sample.nu, sample.v - half * sample.nv, -sample.nu, -sample.nv,
                    extent, half_length, guard, group, circles_px, lines_px)  # fmt: skip
    if sample.curvature > 0.0:
        inside = min(inside, 1.0 / sample.curvature - guard)
    sample.outside, sample.inside = half + outside, half + inside
    return outside >= least and inside >= least


@kernel
def _curvature(u0, v0, u1, v1, u2, v2):
    """Return the curvature, 1/px, of the circle through three points."""
    cross = (u1 - u0) * (v2 - v0) - (v1 - v0) * (u2 - u0)
    sides = math.hypot(u1 - u0, v1 - v0) * math.hypot(u2 - u1, v2 - v1) * math.hypot(u2 - u0, v2 - v0)
    return 2.0 * abs(cross) / sides if sides > 0.0 else 0.0


@kernel
def _place_on_circle(
    lens, a, d, circle, number, length, most, extent, least, blur, circles_px, lines_px, samples, count
):
    _, _, depth = _project(lens, a, d, circle.y1, circle.y2, circle.y3)
    if depth <= 0.0:
        return count
    around = 2.0 * math.pi * lens[0] * circle.radius / depth
    pieces = int(min(max(math.ceil(around / length), 8.0), most))
    for i in range(pieces):
        if count >= samples.shape[0]:
            return count
        t = 2.0 * math.pi * (i + 0.5) / pieces
        y1, y2 = circle.y1 + circle.radius * math.cos(t), circle.y2 + circle.radius * math.sin(t)
        u, v, depth = _project(lens, a, d, y1, y2, circle.y3)
        if depth <= 0.0 or not _in_picture(lens, u, v, extent):
            continue
        step = 0.05
        ua, va, da = _project(lens, a, d, circle.y1 + circle.radius * math.cos(t - step),
                              circle.y2 + circle.radius * math.sin(t - step), circle.y3)  # fmt: skip
        ub, vb, db = _project(lens, a, d, circle.y1 + circle.radius * math.cos(t + step),
                              circle.y2 + circle.radius * math.sin(t + step), circle.y3)  # fmt: skip
        if da <= 0.0 or db <= 0.0:
            continue
        tu, tv = ub - ua, vb - va
        size = math.hypot(tu, tv)
        sample = samples[count]
        sample.nu, sample.nv = tv / size, -tu / size
        sample.u, sample.v, sample.width = u, v, 0.0
        sample.y1, sample.y2, sample.y3 = y1, y2, circle.y3
        sample.curvature = _curvature(ua, va, u, v, ub, vb)
        sample.length, sample.grows = min(length, around / pieces), 1.0
        sample.feature, sample.kind, sample.cluster = circle.feature, STEP, ARCS * number + ARCS * i // pieces
        if _finish(sample, lens, extent, least, blur, circle.group, circles_px, lines_px):
            count += 1
    return count


@kernel
def _place_on_line(
    lens, a, d, line, number, clusters, side, length, most, extent, least, blur, circles_px, lines_px, samples, count
):
    """Place samples on a line; side: 0 for the line itself, +-1 for that border of a wide bar."""
    e1, e2 = line.b1 - line.a1, line.b2 - line.a2
    size = math.hypot(e1, e2)
    m1, m2 = side * 0.5 * line.width * e2 / size, -side * 0.5 * line.width * e1 / size
    u0, v0, d0 = _project(lens, a, d, line.a1 + m1, line.a2 + m2, line.y3)
    u1, v1, d1 = _project(lens, a, d, line.b1 + m1, line.b2 + m2, line.y3)
    if d0 <= 0.0 or d1 <= 0.0:
        return count
    number = int(clusters + SIDES * number + 1 + side)
    long = math.hypot(u1 - u0, v1 - v0)
    guard = _GUARD_SIGMAS * blur
    free = long - 2.0 * guard
    if free < 2.0:
        return count
    pieces = int(min(math.ceil(free / length), most))
    tu, tv = (u1 - u0) / long, (v1 - v0) / long
    way = -1.0 if side < 0.0 else 1.0
    scale = lens[0] / (0.5 * (d0 + d1))
    for i in range(pieces):
        if count >= samples.shape[0]:
            return count
        share = (guard + (i + 0.5) * free / pieces) / long
        # the corresponding fraction in C, by perspective
        share = share * d0 / (d1 + share * (d0 - d1))
        y1, y2 = line.a1 + m1 + share * e1, line.a2 + m2 + share * e2
        u, v, depth = _project(lens, a, d, y1, y2, line.y3)
        if depth <= 0.0 or not _in_picture(lens, u, v, extent):
            continue
        sample = samples[count]
        sample.nu, sample.nv = way * tv, -way * tu
        sample.u, sample.v, sample.curvature = u, v, 0.0
        sample.y1, sample.y2, sample.y3 = y1, y2, line.y3
        sample.length = min(length, free / pieces)
        sample.feature, sample.cluster = line.feature, number
        sample.kind = BAR if line.width > 0.0 and side == 0.0 else STEP
        sample.width = line.width * scale if sample.kind == BAR else 0.0
        sample.grows = 0.0 if sample.kind == BAR else 1.0
        if _finish(sample, lens, extent, least, blur, line.group, circles_px, lines_px):
            count += 1
    return count


@kernel
def place_edge_samples(lens, a, d, circles, lines, borders, blur, length, most, wide_bar, extent, samples):
    """Write the samples of all parts under the pose a (3, 3), d (3,), m; return how many.

    blur: px, 1 sigma of an edge. length: px along the edge; most: largest number per edge. wide_bar: px, bars wider
    than this are measured at each side separately. extent: px, half width of the strips.
    """
    circles_px, lines_px = np.empty((circles.shape[0], 4)), np.empty((borders.shape[0], 5))
    project_borders(lens, a, d, circles, borders, circles_px, lines_px)
    least = 1.5 * blur + 1.0
    count = 0
    for i in range(circles.shape[0]):
        small = circles[i].group < 0
        if small and circles_px[i, 2] < 5.0 * blur + 1.0:
            continue
        count = _place_on_circle(
            lens, a, d, circles[i], i, length, most, extent, least, blur, circles_px, lines_px, samples, count
        )
    clusters = ARCS * circles.shape[0]
    for i in range(lines.shape[0]):
        line = lines[i]
        if line.width > 0.0:
            _, _, depth = _project(lens, a, d, line.a1, line.a2, line.y3)
            if depth > 0.0 and lens[0] * line.width / depth > wide_bar:
                for side in (-1.0, 1.0):
                    count = _place_on_line(lens, a, d, line, i, clusters, side, length, most, extent, least, blur,
                                           circles_px, lines_px, samples, count)  # fmt: skip
                continue
        count = _place_on_line(
            lens, a, d, line, i, clusters, 0.0, length, most, extent, least, blur, circles_px, lines_px, samples, count
        )
    return count
