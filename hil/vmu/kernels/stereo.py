"""Stereo check: distance between two lights from the second camera, and the pairs of LEDs that it allows."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.records import MAX_SPOTS

_PARTNERS = 4  # lights of the other image on one epipolar line that are considered
_SIGMAS = 5.0
_SLACK_PX = 0.5
_SLACK = (
    0.1  # of an LED distance: the difference in depth of two LEDs has an error of the order of the root of the noise
)


@kernel
def depth(scene, view, c, i, j, out):
    """Write the distance along the ray of spot i of camera c, if spot j of the other camera is the same light.

    out: (2,), m, with its standard deviation. Return False if the two rays do not intersect.
    """
    o = 1 - c
    y, z = view.spots[c, i].ray, view.spots[o, j].ray
    turned, shift = np.empty(3), np.empty(3)
    for a in range(3):
        total, moved = 0.0, scene.translation[o, a]
        for b in range(3):
            relative = 0.0
            for d in range(3):
                relative += scene.rotation[o, a, d] * scene.rotation[c, b, d]
            total += relative * y[b]
            moved -= relative * scene.translation[c, b]
        turned[a], shift[a] = total, moved
    x0, x1, x2 = (
        turned[1] * z[2] - turned[2] * z[1],
        turned[2] * z[0] - turned[0] * z[2],
        turned[0] * z[1] - turned[1] * z[0],
    )
    s0, s1, s2 = shift[1] * z[2] - shift[2] * z[1], shift[2] * z[0] - shift[0] * z[2], shift[0] * z[1] - shift[1] * z[0]
    square = x0 * x0 + x1 * x1 + x2 * x2
    if not square > 1e-12:
        return False
    away = -(x0 * s0 + x1 * s1 + x2 * s2) / square
    if not away > 0.0:
        return False
    px, py, pz = away * turned[0] + shift[0], away * turned[1] + shift[1], away * turned[2] + shift[2]
    u, v = project(scene.lens[o], px, py, pz)
    a, b = view.spots[c, i], view.spots[o, j]
    variance = max(a.var_u, a.var_v) + max(b.var_u, b.var_v)
    du, dv = b.u - u, b.v - v
    gate = _SIGMAS * math.sqrt(variance) + _SLACK_PX
    if not du * du + dv * dv < gate * gate:
        return False
    baseline = math.sqrt(shift[0] * shift[0] + shift[1] * shift[1] + shift[2] * shift[2])
    out[0] = away
    out[1] = away * away * math.sqrt(variance) / (scene.lens[c].fx * baseline)
    return True


@kernel
def depths(scene, view, c, near, far, ranges, counts):
    """Write the possible depths of spots of camera c, ranges (MAX_SPOTS, 4, 2), and their number, counts (MAX_SPOTS,).

    The number is 0 (unknown) for a spot without a partner, or with too many.
    """
    out = np.empty(2)
    for i in range(view.counts[c]):
        counts[i] = 0
        for j in range(view.counts[1 - c]):
            if depth(scene, view, c, i, j, out) and 0.5 * near < out[0] < 1.5 * far:
                if counts[i] == _PARTNERS:
                    counts[i] = 0
                    break
                ranges[i, counts[i], 0], ranges[i, counts[i], 1] = out[0], out[1]
                counts[i] += 1


@kernel
def write_gap(first, second, between, out):
    """Write the distance of two lights along and across the rays, m, and the sigma of that along, to out (3,).

    first, second: depth and its sigma, m, along rays with cosine ``between``.
    """
    a, b = first[0], second[0]
    along = abs(a - b)
    out[0] = along
    out[1] = math.sqrt(max(a * a + b * b - 2.0 * a * b * between - along * along, 0.0))
    out[2] = math.sqrt(first[1] * first[1] + second[1] * second[1])


@kernel
def may_be_apart(gap, length):
    """Return whether two lights with the distances ``gap`` of ``write_gap`` can be ``length`` m apart."""
    across = gap[1]
    if across > 1.05 * length:
        return False
    needed = math.sqrt(max(length * length - across * across, 0.0))
    return abs(gap[0] - needed) < _SIGMAS * gap[2] + _SLACK * length


@kernel
def allow_pairs(scene, view, c, near, far, allowed, some, index):
    """Write to allowed (MAX_SPOTS, MAX_SPOTS, n, n), 1 or 0, whether two spots of camera c can be two different LEDs.

    some: (MAX_SPOTS, MAX_SPOTS), whether they can be any two. index: (MAX_SPOTS,), the spots in order, those first
    that have a possible partner in the other image. Return how many have one.
    """
    n = scene.leds.shape[0]
    ranges, counts = np.empty((MAX_SPOTS, _PARTNERS, 2)), np.zeros(MAX_SPOTS, np.int64)
    depths(scene, view, c, near, far, ranges, counts)
    paired = 0
    for i in range(view.counts[c]):
        if counts[i] != 0:
            index[paired] = i
            paired += 1
    last = paired
    for i in range(view.counts[c]):
        if counts[i] == 0:
            index[last] = i
            last += 1
    lengths = np.sqrt(scene.squares)
    gap = np.empty((_PARTNERS * _PARTNERS, 3))
    for i in range(view.counts[c]):
        some[i, i] = 0
        for j in range(i):
            y, z = view.spots[c, i].ray, view.spots[c, j].ray
            between = y[0] * z[0] + y[1] * z[1] + y[2] * z[2]
            some[i, j] = 0
            m = 0
            for a in range(counts[i]):
                for b in range(counts[j]):
                    write_gap(ranges[i, a], ranges[j, b], between, gap[m])
                    m += 1
            for p in range(n):
                for q in range(p):
                    fits = m == 0
                    for k in range(m):
                        if not fits:
                            fits = may_be_apart(gap[k], lengths[p, q])
                    possible = 1 if fits else 0
                    allowed[i, j, p, q] = allowed[i, j, q, p] = allowed[j, i, p, q] = allowed[j, i, q, p] = possible
                    if fits:
                        some[i, j] = 1
            some[j, i] = some[i, j]
    return paired
