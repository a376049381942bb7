"""Search for all assignments of the spots of two images to the LEDs, without a prediction of the pose.

Three spots of one image and three LEDs give up to four poses; each is checked on all other LEDs in both images.
Any hypothesis that explains m of the N spots of an image has a triple among the first N - m + 3 of them, so the
search starts at the largest m, and ends when no better hypothesis can remain.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths.arrays import copy_matrix
from hil.maths.record_view import copy_record
from hil.vmu.kernels.budget import passes, settle
from hil.vmu.kernels.hypotheses import acceptable, is_known, mirror
from hil.vmu.kernels.match import converge
from hil.vmu.kernels.p3p import axes_of_three, ray_lengths
from hil.vmu.kernels.records import MAX_SPOTS
from hil.vmu.kernels.start_poses import is_tried, near_prediction, plausible, pose_of_three, take_spots
from hil.vmu.kernels.stereo import allow_pairs

SEARCH = np.dtype(
    [
        ("near", "f8"),  # m, range of the target's origin from the left camera, at least and at most
        ("far", "f8"),
        ("least_facing", "f8"),  # cosine of the largest angle between -z_t and the line of sight
        ("reach_px", "f8"),  # largest distance of a spot from the projection of a start pose, plus its noise
        ("gate_px", "f8"),  # and from that of a refined pose
        ("normal", "f8", 3),  # normal of the LEDs' best-fit plane, in t
        ("centre", "f8", 3),  # m, of the LEDs, in t
        ("level", "i8"),  # above 0: only hypotheses that explain this number of spots of one camera, or more
        ("most_triples", "i8"),  # pairings of three spots with three LEDs that may be tried
        ("predicted", "i8"),  # 1: three spots of a single camera are valid near the following pose
        ("r", "f8", (3, 3)),
        ("t", "f8", 3),  # m
        ("away", "f8"),  # m, at most
        ("least_trace", "f8"),  # of the rotation from it
    ],
    align=True,
)

STATE_FITS, STATE_BEST, STATE_FULL, STATE_STARTS, STATE_TRIPLES, STATE_CLEAN = range(6)
"""Indices of ``state``: fits found, most spots of one, whether some were dropped, starts and triples tried, most spots
of one that passes its test without a floor."""
STATE_WIDTH: Final = 6

_MOST_STARTS = 400
_CLOSE_SCORE = 15.0  # within which a hypothesis without some of the spots is one of its own
_SLACK = 2  # fits with up to this many spots fewer than the best are kept


@kernel
def try_start(scene, view, settings, start, starts, fits, state):
    """Converge ``start`` unless already tried; append a new valid pose to ``fits``.

    The last elements of ``fits`` and of ``starts``, the list of tried starts, are scratch.
    """
    n = scene.leds.shape[0]
    if is_tried(starts, min(state[STATE_STARTS], starts.shape[0] - 1), start, n):
        return
    if state[STATE_STARTS] >= _MOST_STARTS:
        state[STATE_FULL] = 1
        return
    starts[state[STATE_STARTS] % (starts.shape[0] - 1)] = start
    state[STATE_STARTS] += 1
    fit = fits[fits.shape[0] - 1]
    fits[fits.shape[0] - 1] = start
    converge(scene, view, settings.gate_px, fit)
    add_new(fits, state)


@kernel
def add_new(fits, state):
    """Append the hypothesis in the last element of ``fits`` if it passes its test and is new; return whether it was."""
    d = np.empty(6)
    fit = fits[fits.shape[0] - 1]
    if not acceptable(fit) or is_known(fits, state[STATE_FITS], fit, d):
        return False
    state[STATE_BEST] = max(state[STATE_BEST], fit.points)
    if state[STATE_FITS] == fits.shape[0] - 1:
        drop_poor(fits, state)
    if state[STATE_FITS] == fits.shape[0] - 1:
        state[STATE_FULL] = 1
        return False
    fits[state[STATE_FITS]] = fit
    state[STATE_FITS] += 1
    return True


@kernel
def drop_poor(fits, state):
    """Remove the poses that explain too few spots compared with the best so far."""
    kept = 0
    for k in range(state[STATE_FITS]):
        if fits[k].points >= state[STATE_BEST] - _SLACK:
            fits[kept] = fits[k]
            kept += 1
    state[STATE_FITS] = kept


@kernel
def add_settled(scene, view, settings, density, start, fits, state):
    """Fit ``start`` within the error budget, then the mirror image of the result; append the new ones to ``fits``.

    density: (2,), px^-2, of stray lights. The last element of ``fits`` is scratch.
    """
    rival = np.empty_like(fits[:1])
    fit = fits[fits.shape[0] - 1]
    fits[fits.shape[0] - 1] = start
    for side in range(2):
        if side == 1:
            fits[fits.shape[0] - 1] = start
        best = -np.inf
        for k in range(state[STATE_FITS]):
            best = max(best, fits[k].score)
        settle(scene, view, density, settings.gate_px, state[STATE_CLEAN], best, fit, rival)
        if not add_new(fits, state):
            return
        if passes(fit):
            state[STATE_CLEAN] = max(state[STATE_CLEAN], fit.points)
        mirror(fit.r, fit.t, settings.normal, settings.centre, start.r, start.t)
        copy_matrix(start.spot, fit.spot)
        if rival[0].valid == 1 and rival[0].score > fit.score - _CLOSE_SCORE:
            copy_record(rival[0], fit)
            add_new(fits, state)


@kernel
def search_triple(scene, view, settings, c, trio, least, allowed, starts, fits, state):
    """Try every three LEDs for the three spots ``trio`` of camera c.

    least: number of its spots to be explained. allowed: see ``allow_pairs``.
    """
    leds, squares = scene.leds, scene.squares
    n = leds.shape[0]
    i, j, k = trio[0], trio[1], trio[2]
    a, b, d = view.spots[c, i], view.spots[c, j], view.spots[c, k]
    y1, y2, y3 = a.ray, b.ray, d.ray
    if not math.isfinite(y1[0] + y2[0] + y3[0]):
        return
    du1, dv1, du2, dv2 = b.u - a.u, b.v - a.v, d.u - a.u, d.v - a.v
    side = 1 if du1 * dv2 - dv1 * du2 > 0.0 else -1
    # the tilt of three points seen head-on has an error of the order of the root of the noise
    extent = math.sqrt(max(du1 * du1 + dv1 * dv1, du2 * du2 + dv2 * dv2))
    sigma = math.sqrt(max(max(a.var_u + a.var_v, b.var_u + b.var_v), d.var_u + d.var_v))
    reach = settings.reach_px + 4.0 * sigma + 0.5 * math.sqrt(2.0 * sigma * extent)
    other_spots = view.counts[1 - c]
    vectors, values, lengths = np.empty((3, 2)), np.empty(2), np.empty((4, 3))
    arm, point, ends = np.empty(3), np.empty(3), np.empty((3, 3))
    there, here = np.empty((3, 3)), np.empty((3, 3))
    fit = starts[starts.shape[0] - 1]
    for p in range(n):
        for q in range(n):
            if p == q or not allowed[i, j, p, q]:
                continue
            for s in range(n):
                if s in (p, q) or scene.sides[p, q, s] == -side:
                    continue
                if not (allowed[i, k, p, s] and allowed[j, k, q, s]):
                    continue
                if state[STATE_TRIPLES] >= settings.most_triples:
                    state[STATE_FULL] = 1
                    return
                state[STATE_TRIPLES] += 1
                n_solutions = ray_lengths(
                    y1, y2, y3, squares[p, q], squares[p, s], squares[q, s], here, vectors, values, lengths
                )
                if n_solutions == 0:
                    continue
                axes_of_three(leds[p], leds[q], leds[s], there)
                for m in range(n_solutions):
                    for e in range(3):
                        ends[0, e] = lengths[m, 0] * y1[e]
                        ends[1, e] = lengths[m, 1] * y2[e]
                        ends[2, e] = lengths[m, 2] * y3[e]
                    pose_of_three(scene.rotation[c], scene.translation[c], ends, leds, p, q, s, there, here, fit)
                    if not plausible(settings, fit):
                        continue
                    if other_spots < 2 and least == 3 and not near_prediction(settings, fit):
                        continue
                    for e in range(n):
                        fit.spot[0, e] = -1
                        fit.spot[1, e] = -1
                    fit.spot[c, p], fit.spot[c, q], fit.spot[c, s] = i, j, k
                    if take_spots(scene, view, c, least, reach, fit, arm, point):
                        try_start(scene, view, settings, fit, starts, fits, state)


@kernel
def search_level(scene, view, settings, c, level, index, count, allowed, some, starts, fits, state):
    """Try the triples of camera c that cover any hypothesis that explains ``level`` of its spots index[:count]."""
    trio = np.empty(3, np.int64)
    # one more than needed: a light visible to this camera only may have a wrong partner in the other one
    spare = 1 if view.counts[1 - c] > 0 else 0
    for k in range(2, min(count - level + 3 + spare, count)):
        for j in range(1, k):
            if state[STATE_TRIPLES] >= settings.most_triples:
                state[STATE_FULL] = 1
                return
            if not some[index[j], index[k]]:
                continue
            for i in range(j):
                if some[index[i], index[j]] and some[index[i], index[k]]:
                    trio[0], trio[1], trio[2] = index[i], index[j], index[k]
                    search_triple(scene, view, settings, c, trio, level, allowed, starts, fits, state)


@kernel
def search_camera(scene, view, settings, c, level, lowest, index, count, allowed, some, starts, fits, state):
    """Search by the spots index[:count] of camera c, from ``level`` spots downwards; return the last level tried.

    It ends when no hypothesis that explains more of the camera's spots than the best so far can remain.
    """
    n = scene.leds.shape[0]
    while level >= lowest:
        search_level(scene, view, settings, c, level, index, count, allowed, some, starts, fits, state)
        mine = 0
        for k in range(state[STATE_FITS]):
            if fits[k].points == state[STATE_BEST]:
                own = 0
                for m in range(n):
                    if fits[k].spot[c, m] >= 0:
                        own += 1
                mine = max(mine, own)
        if level <= mine:
            break
        level -= 1
    return max(level, lowest)


@kernel
def search(scene, view, settings, starts, fits, state):
    """Write all poses that explain the most spots, or nearly so, to ``fits``; return how many.

    Lights that the other camera may see too are tried first; if nearly all LEDs are among them, that is all.
    The last elements of ``starts`` and of ``fits`` are scratch. state: (STATE_WIDTH,), see STATE_FITS.
    """
    n = scene.leds.shape[0]
    for k in range(STATE_WIDTH):
        state[k] = 0
    first = 0 if view.counts[0] >= max(3, settings.level) else 1
    other = 1 - first
    allowed = np.empty((MAX_SPOTS, MAX_SPOTS, n, n), np.uint8)
    some, index = np.empty((MAX_SPOTS, MAX_SPOTS), np.uint8), np.empty(MAX_SPOTS, np.int64)
    paired = allow_pairs(scene, view, first, settings.near, settings.far, allowed, some, index)
    if settings.level > 0:
        lights = paired if paired >= settings.level else view.counts[first]
        search_level(
            scene, view, settings, first, settings.level, index, lights, allowed, some, starts, fits, state
        )  # fmt: skip
        drop_poor(fits, state)
        return state[STATE_FITS]
    if paired >= n - 1 and paired < view.counts[first]:
        search_camera(
            scene, view, settings, first, min(paired, n), n - 1, index, paired, allowed, some, starts, fits, state
        )  # fmt: skip
        if state[STATE_BEST] >= 2 * n - 2:
            drop_poor(fits, state)
            return state[STATE_FITS]
    # any three lights of a single camera give a pose: valid only near a prediction
    lowest = 3 if view.counts[other] >= 2 or settings.predicted == 1 else 4
    level = search_camera(
        scene, view, settings, first, min(view.counts[first], n), lowest, index, view.counts[first], allowed, some,
        starts, fits, state,
    )  # fmt: skip
    # an equally good hypothesis not yet found has few spots in the first image and many in the other
    lowest = 3 if view.counts[first] >= 2 or settings.predicted == 1 else 4
    own = min(view.counts[other], n)
    allow_pairs(scene, view, other, settings.near, settings.far, allowed, some, index)
    while own >= max(lowest, state[STATE_BEST] - level + 1):
        search_level(
            scene, view, settings, other, own, index, view.counts[other], allowed, some, starts, fits, state
        )  # fmt: skip
        own -= 1
    drop_poor(fits, state)
    return state[STATE_FITS]
