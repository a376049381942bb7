"""Start poses: from three spots and three LEDs, with candidate spots for the other LEDs."""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.match import cell_of
from hil.vmu.kernels.p3p import axes_of_three
from hil.vmu.kernels.refine import place_when_seen

_SAME_TRACE = 2.9924  # of the rotation between two starts that converge to one pose: 5 deg
_ALONE = 5  # spots of one camera that suffice without any from the other camera


@kernel
def orientation_of(leds, p, q, s, least_facing):
    """Return the orientation, 1 or -1, in which a camera in front sees LEDs p, q, s; 0 if it depends on the pose."""
    ax, ay, az = leds[q, 0] - leds[p, 0], leds[q, 1] - leds[p, 1], leds[q, 2] - leds[p, 2]
    bx, by, bz = leds[s, 0] - leds[p, 0], leds[s, 1] - leds[p, 1], leds[s, 2] - leds[p, 2]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    lean = math.acos(min(abs(nz) / size, 1.0)) if size > 0.0 else 0.5 * math.pi
    if lean + math.acos(least_facing) > 0.5 * math.pi - 0.1:
        return 0
    return 1 if nz > 0.0 else -1


@kernel
def plausible(settings, fit):
    """Return whether the target of ``fit`` is in front of the camera, in range, and facing it."""
    x, y, z = fit.t[0], fit.t[1], fit.t[2]
    away = math.sqrt(x * x + y * y + z * z)
    if not settings.near <= away <= settings.far or not z > 0.0:
        return False
    facing = (fit.r[0, 2] * x + fit.r[1, 2] * y + fit.r[2, 2] * z) / away
    return facing >= settings.least_facing


@kernel
def trace_between(r_a, r_b):
    """Return the trace of the rotation between two attitudes, ``1 + 2 cos(angle)``."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += r_a[i, j] * r_b[i, j]
    return total


@kernel
def near_prediction(settings, fit):
    """Return whether a pose is within the bounds of the predicted one."""
    x, y, z = fit.t[0] - settings.t[0], fit.t[1] - settings.t[1], fit.t[2] - settings.t[2]
    if x * x + y * y + z * z > settings.away * settings.away:
        return False
    return trace_between(settings.r, fit.r) >= settings.least_trace


@kernel
def pose_of_three(rotation, translation, ends, leds, p, q, s, there, here, fit):
    """Write to ``fit`` the pose that places the LEDs p, q, s at ``ends`` (3, 3), m, in a camera's axes.

    rotation, translation: from v to those axes. there: axes of the three LEDs in t. here: scratch, (3, 3).
    """
    axes_of_three(ends[0], ends[1], ends[2], here)
    for a in range(3):
        for b in range(3):
            total = 0.0
            for d in range(3):  # v <- camera <- triangle <- t
                turned = here[d, 0] * there[b, 0] + here[d, 1] * there[b, 1] + here[d, 2] * there[b, 2]
                total += rotation[d, a] * turned
            fit.r[a, b] = total
    for a in range(3):
        total = 0.0
        for d in range(3):
            middle = (ends[0, d] + ends[1, d] + ends[2, d]) / 3.0
            total += rotation[d, a] * (middle - translation[d])
            total -= fit.r[a, d] * (leds[p, d] + leds[q, d] + leds[s, d]) / 3.0
        fit.t[a] = total


@kernel
def take_nearest(scene, view, c, n, reach, fit, arm, point):
    """Assign to LED n the spot of camera c nearest to its projection, within ``reach`` px and free; return whether."""
    place_when_seen(scene, c, scene.leds[n], fit.r, fit.t, arm, point)
    u, v = project(scene.lens[c], point[0], point[1], point[2])
    fit.spot[c, n] = -1
    if not math.isfinite(u + v):
        return False
    i, j, size = cell_of(scene.lens[c], u, v)
    if reach < size and view.near[c, i, j] == 0:
        return False
    best, least = -1, reach * reach
    for k in range(view.counts[c]):
        du, dv = view.spots[c, k].u - u, view.spots[c, k].v - v
        square = du * du + dv * dv
        if square < least:
            best, least = k, square
    for m in range(scene.leds.shape[0]):
        if best >= 0 and fit.spot[c, m] == best:
            best = -1
    fit.spot[c, n] = best
    return best >= 0


@kernel
def take_spots(scene, view, c, least, reach, fit, arm, point):
    """Assign the spots nearest to the projections of the pose in ``fit``; return whether there are enough.

    fit.spot of camera c holds the three spots that define the pose. Enough: ``least`` of camera c, and two of the other
    camera if that has two, or else _ALONE of camera c.
    """
    have = 3
    remaining = scene.leds.shape[0] - 3
    for n in range(scene.leds.shape[0]):
        if fit.spot[c, n] >= 0:
            continue
        if take_nearest(scene, view, c, n, reach, fit, arm, point):
            have += 1
        remaining -= 1
        if have + remaining < least:
            return False
    other = 1 - c
    if view.counts[other] < 2:
        return True
    seen = 0
    for n in range(scene.leds.shape[0]):
        if take_nearest(scene, view, other, n, reach, fit, arm, point):
            seen += 1
    return seen >= 2 or have >= _ALONE


@kernel
def is_tried(others, count, fit, n):
    """Return whether one of the first ``count`` starts has the same spots and nearly the same attitude."""
    for k in range(count):
        other = others[k]
        same = True
        for m in range(n):
            if other.spot[0, m] != fit.spot[0, m] or other.spot[1, m] != fit.spot[1, m]:
                same = False
                break
        if same and trace_between(other.r, fit.r) > _SAME_TRACE:
            return True
    return False
