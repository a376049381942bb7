"""Every way in which the spots of two images can be the LEDs, without any idea of the pose.

Three spots of one image and three LEDs give up to four poses; each is checked on all other LEDs in both images.
Any hypothesis that explains m of the N spots of an image has a triple among the first N - m + 3 of them, so the
search begins at the largest m, and ends when no hypothesis that explains more can be left.
"""

from __future__ import annotations

import math

import numpy as np

from hil.maths.jit import kernel
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.p3p import axes_of_three, ray_lengths
from hil.vmu.kernels.records import MAX_LEDS
from hil.vmu.kernels.refine import place

SEARCH = np.dtype(
    [
        ("near", "f8"),  # m, range of the target's origin from the left camera, at least and at most
        ("far", "f8"),
        ("least_facing", "f8"),  # cosine of the largest angle between -z_t and the line of sight
        ("reach_px", "f8"),  # a spot this near to the projection of a start pose counts
        ("reach_share", "f8"),  # and this share of the three spots' extent
        ("slack", "i8"),  # starts that explain this many spots fewer than the best are kept
    ],
    align=True,
)

_SAME_TURN = 0.9995  # cosine-like measure of two starts that will end at one pose: about 2.5 deg


@kernel
def side_of(leds, p, q, s, least_facing):
    """Return the sense, 1 or -1, in which a camera in front sees the LEDs p, q, s; 0 where it depends on the pose."""
    ax, ay, az = leds[q, 0] - leds[p, 0], leds[q, 1] - leds[p, 1], leds[q, 2] - leds[p, 2]
    bx, by, bz = leds[s, 0] - leds[p, 0], leds[s, 1] - leds[p, 1], leds[s, 2] - leds[p, 2]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    lean = math.acos(min(abs(nz) / size, 1.0)) if size > 0.0 else 0.5 * math.pi
    if lean + math.acos(least_facing) > 0.5 * math.pi - 0.1:
        return 0
    return 1 if nz > 0.0 else -1


@kernel
def nearest(view, c, u, v, reach):
    """Return the index of the spot of camera c nearest to (u, v) and within ``reach`` px, -1 for none."""
    best, least = -1, reach * reach
    for k in range(view.counts[c]):
        du, dv = view.sights[c, k].u - u, view.sights[c, k].v - v
        square = du * du + dv * dv
        if square < least:
            best, least = k, square
    return best


@kernel
def take_spots(scene, view, c, least, reach, fit, arm, point):
    """Write the spots nearest to the projections of the pose in ``fit``, camera c first; return how many.

    0 as soon as fewer than ``least`` of camera c's can be explained. fit.spot of camera c holds the three that
    the pose came from.
    """
    have = 3
    open_ = scene.leds.shape[0] - 3
    for n in range(scene.leds.shape[0]):
        if fit.spot[c, n] >= 0:
            continue
        place(scene.rotation[c], scene.translation[c], fit.r, fit.t, scene.leds[n], arm, point)
        u, v = project(scene.lens[c], point[0], point[1], point[2])
        k = nearest(view, c, u, v, reach)
        for m in range(scene.leds.shape[0]):
            if k >= 0 and fit.spot[c, m] == k:
                k = -1
        fit.spot[c, n] = k
        open_ -= 1
        if k >= 0:
            have += 1
        if have + open_ < least:
            return 0
    other = 1 - c
    if view.counts[other] == 0:
        return have
    for n in range(scene.leds.shape[0]):
        place(scene.rotation[other], scene.translation[other], fit.r, fit.t, scene.leds[n], arm, point)
        u, v = project(scene.lens[other], point[0], point[1], point[2])
        k = nearest(view, other, u, v, reach)
        for m in range(n):
            if k >= 0 and fit.spot[other, m] == k:
                k = -1
        fit.spot[other, n] = k
        if k >= 0:
            have += 1
    return have


@kernel
def same_start(a, b, n):
    """Return whether two starts name the same spots and are turned alike."""
    for c in range(2):
        for m in range(n):
            if a.spot[c, m] != b.spot[c, m]:
                return False
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += a.r[i, j] * b.r[i, j]
    return 0.5 * (trace - 1.0) > _SAME_TURN


@kernel
def keep(fits, state, slack, fit, n):
    """Put ``fit`` into ``fits`` where it is new and explains enough. state: see ``search_triple``."""
    state[1] = max(state[1], fit.points)
    if fit.points < state[1] - slack:
        return
    for k in range(state[0]):
        if same_start(fits[k], fit, n):
            return
    if state[0] == fits.shape[0] - 1:
        kept = 0  # make room: some explain too little by now
        for k in range(state[0]):
            if fits[k].points >= state[1] - slack:
                fits[kept] = fits[k]
                kept += 1
        if kept == state[0]:
            state[2] = 1
            return
        state[0] = kept
    fits[state[0]] = fit
    state[0] += 1


@kernel
def plausible(settings, fit):
    """Return whether the target of ``fit`` is in front, in range and shows its face."""
    x, y, z = fit.t[0], fit.t[1], fit.t[2]
    away = math.sqrt(x * x + y * y + z * z)
    if not settings.near <= away <= settings.far or not z > 0.0:
        return False
    facing = (fit.r[0, 2] * x + fit.r[1, 2] * y + fit.r[2, 2] * z) / away
    return facing >= settings.least_facing


@kernel
def pose_of_three(rotation, translation, ends, leds, p, q, s, there, here, fit):
    """Write the pose to ``fit`` that puts the LEDs p, q, s at ``ends`` (3, 3), m, in a camera's axes.

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
def search_triple(scene, view, settings, c, trio, least, fits, state):
    """Try every three LEDs for the three spots ``trio`` of camera c; add what explains enough to ``fits``.

    least: spots of camera c that a hypothesis must explain. state: (3,), how many of fits are in use (the last
    one is scratch), the most spots that one explains, and 1 where there was no room for all.
    """
    leds, squares = scene.leds, scene.squares
    n = leds.shape[0]
    i, j, k = trio[0], trio[1], trio[2]
    y1, y2, y3 = view.sights[c, i].ray, view.sights[c, j].ray, view.sights[c, k].ray
    if not math.isfinite(y1[0] + y2[0] + y3[0]):
        return
    du1, dv1 = view.sights[c, j].u - view.sights[c, i].u, view.sights[c, j].v - view.sights[c, i].v
    du2, dv2 = view.sights[c, k].u - view.sights[c, i].u, view.sights[c, k].v - view.sights[c, i].v
    side = 1 if du1 * dv2 - dv1 * du2 > 0.0 else -1
    reach = settings.reach_px + settings.reach_share * math.sqrt(max(du1 * du1 + dv1 * dv1, du2 * du2 + dv2 * dv2))
    vectors, values, lengths = np.empty((3, 2)), np.empty(2), np.empty((4, 3))
    arm, point, ends = np.empty(3), np.empty(3), np.empty((3, 3))
    there, here = np.empty((3, 3)), np.empty((3, 3))
    fit = fits[fits.shape[0] - 1]
    for p in range(n):
        for q in range(n):
            for s in range(n):
                if p == q or s in (p, q) or scene.sides[p, q, s] == -side:
                    continue
                found = ray_lengths(y1, y2, y3, squares[p, q], squares[p, s], squares[q, s], vectors, values, lengths)
                if found == 0:
                    continue
                axes_of_three(leds[p], leds[q], leds[s], there)
                for m in range(found):
                    for a in range(3):
                        ends[0, a] = lengths[m, 0] * y1[a]
                        ends[1, a] = lengths[m, 1] * y2[a]
                        ends[2, a] = lengths[m, 2] * y3[a]
                    pose_of_three(scene.rotation[c], scene.translation[c], ends, leds, p, q, s, there, here, fit)
                    if not plausible(settings, fit):
                        continue
                    for a in range(MAX_LEDS):
                        fit.spot[0, a] = -1
                        fit.spot[1, a] = -1
                    fit.spot[c, p], fit.spot[c, q], fit.spot[c, s] = i, j, k
                    fit.points = take_spots(scene, view, c, least, reach, fit, arm, point)
                    if fit.points > 0:
                        keep(fits, state, settings.slack, fit, n)


@kernel
def search_level(scene, view, settings, c, level, fits, state):
    """Try the triples of camera c that a hypothesis explaining ``level`` spots needs beyond those of level + 1."""
    last = view.counts[c] - level + 2
    first_time = level == min(view.counts[c], scene.leds.shape[0])
    trio = np.empty(3, np.int64)
    for k in range(2 if first_time else last, last + 1):
        for j in range(1, k):
            for i in range(j):
                trio[0], trio[1], trio[2] = i, j, k
                search_triple(scene, view, settings, c, trio, level, fits, state)


@kernel
def search(scene, view, settings, fits, state):
    """Write the start poses of all hypotheses that explain the most spots, or ``settings.slack`` fewer, to ``fits``.

    The last place of ``fits`` is scratch. state: see ``search_triple``. Return how many.
    """
    n = scene.leds.shape[0]
    state[0], state[1], state[2] = 0, 0, 0
    first = 0 if view.counts[0] >= 3 else 1
    level = min(view.counts[first], n)
    while level >= 3:
        search_level(scene, view, settings, first, level, fits, state)
        mine = 0
        for k in range(state[0]):
            if fits[k].points == state[1]:
                own = 0
                for a in range(n):
                    if fits[k].spot[first, a] >= 0:
                        own += 1
                mine = max(mine, own)
        if level <= mine:
            break
        level -= 1
    level = max(level, 3)
    # a hypothesis that explains as many in both images and was not met has few in the first: many in the other
    other = 1 - first
    lowest = max(3, state[1] - level + 1)
    most = min(view.counts[other], n)
    for own in range(most, lowest - 1, -1):
        search_level(scene, view, settings, other, own, fits, state)
        lowest = max(3, state[1] - level + 1)
        if own <= lowest:
            break
    return state[0]
