"""Reflections of the LEDs in a plate behind them, as spots of their own or in length and size of the LEDs' spots.

Where LED and reflection merge into one spot, all spots are displaced alike and no residual shows it.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.budget import equations_of, fill_shared, fill_weights, linearise, normal_equations
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.records import MAX_SPOTS
from hil.vmu.kernels.refine import jacobian, place_when_seen

_FEWEST = 6  # spots
_FEWEST_OF_ONE = 5  # spots of one camera
_SEEN_ALIKE = 0.2  # of the square of a disc's size and the angle of its LED from the others
_ODD_RELATIVE = 0.15  # of the elongation that all have: motion that differs between the LEDs
_LEAST_PX2 = 0.004  # 1 sigma of an elongation: sums of pixels, texture, a lens that is not round
_PLATES_M = (0.01, 0.02, 0.03, 0.045, 0.07)  # behind the rearmost LED
_LEANS = 11  # directions of the axis that are tried along u and v
_LEAN = 0.03  # rad: their distance. The axis of a pose by doubled lights is wrong by as much and more
_SIZE = 0.01  # 1 sigma of the square of a size: the lens is not equally sharp everywhere
_BLUR_PX2 = 0.6  # of a lens; the rest of the square of a size is the LED's, which is larger the nearer it is
_LEAST_SCALE = 0.3  # of the variances of elongations and sizes: they may be half as uncertain as stated
_AS_GOOD = 2.0  # of chi-square: plates that explain the spots as well as the best one
_RELATIVE = 0.1  # 1 sigma of an elongation that is not small against the spot
_PLATES, _NEAREST_M, _FARTHEST_M = 24, 0.005, 0.15
_ACROSS_PX = 2.0  # distance of a light from the reflection
_LEANING = 0.12  # of the distance of the reflection from its LED: a plate that is not parallel, a displaced pose
_SEEN_PX, _MERGED_PX = 1.5, 4.0  # farther from its LED, a reflection may be a spot of its own; nearer, it need not
_MOST = 0.3  # of w1 w2, which is at most 1/4


@kernel
def doubled_lights(scene, view, fit, shift):
    """Return the depth, m, by which reflections displace the foremost LED, and the ratio of variances F that shows it.

    shift: (2, n, 2), px, displacement of each LED's spot in each camera, written.

    Two lights of the fractions ``w1`` and ``w2`` with images ``a`` apart are a spot whose covariance has
    ``w1 w2 a a.T`` more. A plate that is ``d`` behind an LED puts its reflection 2 d behind it, with ``a`` the image of
    that length along z_t, away from the cameras: another one for each LED. Motion, tilted LEDs and the lens elongate
    and enlarge all spots alike: F compares what that leaves with what a plate leaves. Weak reflections far away and
    strong ones nearby are the same elongation: of all plates that explain it as well as the best one, the shift is that
    of the plate that displaces the LEDs most against each other. 0, 0 without six spots or if no plate explains them.
    """
    arm, point, slopes, j = np.empty(3), np.empty(3), np.empty((2, 3)), np.empty((2, 6))
    most = 2 * scene.leds.shape[0]
    e, apart, turned = np.empty((most, 3)), np.empty((most, 2)), np.empty((most, 2, 2))
    along, weight = np.empty(most), np.empty((most, 3))
    mean, weights = np.zeros(3), np.zeros(3)
    m, rear = 0, -np.inf
    for n in range(scene.leds.shape[0]):
        rear = max(rear, scene.leds[n, 2])
    for c in range(2):
        for n in range(scene.leds.shape[0]):
            k = fit.spot[c, n]
            if k < 0 or not math.isfinite(view.spots[c, k].shape[0]):
                continue
            place_when_seen(scene, c, scene.leds[n], fit.r, fit.t, arm, point)
            jacobian(scene.lens[c], scene.rotation[c], arm, point, slopes, j)
            for i in range(2):
                apart[m, i] = j[i, 0] * fit.r[0, 2] + j[i, 1] * fit.r[1, 2] + j[i, 2] * fit.r[2, 2]
                turned[m, i, 0], turned[m, i, 1] = j[i, 0], j[i, 1]
            along[m] = scene.leds[n, 2]
            shape, sigma = view.spots[c, k].shape, view.spots[c, k].shape_sigma
            nearer = abs(point[2] - scene.rotation[c, 2] @ fit.t - scene.translation[c, 2]) / point[2]
            least = _LEAST_PX2**2 + _RELATIVE**2 * (shape[0] ** 2 + shape[1] ** 2)
            enlarged = (_SIZE * shape[2]) ** 2 + (2.0 * nearer * max(shape[2] - _BLUR_PX2, 0.0)) ** 2
            for i in range(3):
                e[m, i] = shape[i]
                weight[m, i] = 1.0 / (sigma[i // 2] ** 2 + (enlarged if i == 2 else least))
                weights[i] += weight[m, i]
                mean[i] += weight[m, i] * e[m, i]
            m += 1
    if m < _FEWEST:
        return 0.0, 0.0
    alike, power = 0.0, 0.0
    for i in range(3):
        mean[i] /= weights[i]
        for k in range(m):
            alike += weight[k, i] * (e[k, i] - mean[i]) ** 2 / (3 * m - 3)
    for k in range(m):
        e[k, 2] -= mean[2]  # of the lens and the LED
        for i in range(3):
            power += weight[k, i] * e[k, i] ** 2
    count = len(_PLATES_M) * _LEANS * _LEANS
    parts, remaining, moved = np.empty(count), np.empty(count), np.empty(count)
    added, best = np.empty((m, 3)), np.inf
    for h in range(count):
        behind, lean_u, lean_v = _plate(h)
        square, product, middle, at_u, at_v, all_u, all_v = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(m):
            far = 2.0 * (rear + behind - along[k])
            u = far * (apart[k, 0] + lean_u * turned[k, 0, 0] + lean_v * turned[k, 0, 1])
            v = far * (apart[k, 1] + lean_u * turned[k, 1, 0] + lean_v * turned[k, 1, 1])
            added[k, 0], added[k, 1], added[k, 2] = 0.5 * (u * u - v * v), u * v, 0.5 * (u * u + v * v)
            middle += weight[k, 2] * added[k, 2] / weights[2]
            at_u, at_v, all_u, all_v = at_u + u / m, at_v + v / m, all_u + u * u / m, all_v + v * v / m
        for k in range(m):
            added[k, 2] -= middle
            for i in range(3):
                square += weight[k, i] * added[k, i] ** 2
                product += weight[k, i] * added[k, i] * e[k, i]
        part = product / square
        parts[h], remaining[h], moved[h] = 0.0, np.inf, 0.0
        if 0.0 < part < _MOST:
            parts[h] = 0.5 - math.sqrt(max(0.25 - part, 0.0))
            remaining[h] = power - part * product
            moved[h] = parts[h] ** 2 * (all_u + all_v - at_u * at_u - at_v * at_v)
            best = min(best, remaining[h])
    if not math.isfinite(best):
        return 0.0, 0.0
    scale = max(best / (3 * m - 5), _LEAST_SCALE)
    worst = -1
    for h in range(count):
        if remaining[h] <= best + _AS_GOOD * scale and (worst < 0 or moved[h] > moved[worst]):
            worst = h
    behind, lean_u, lean_v = _plate(worst)
    m, depth = 0, 0.0
    for c in range(2):
        for n in range(scene.leds.shape[0]):
            shift[c, n, 0] = shift[c, n, 1] = 0.0
            if fit.spot[c, n] < 0 or not math.isfinite(view.spots[c, fit.spot[c, n]].shape[0]):
                continue
            far = 2.0 * parts[worst] * (rear + behind - scene.leds[n, 2])
            depth = max(depth, far)
            for i in range(2):
                shift[c, n, i] = far * (apart[m, i] + lean_u * turned[m, i, 0] + lean_v * turned[m, i, 1])
            m += 1
    return depth, alike / scale


@kernel
def _plate(h):
    """Return distance behind the rearmost LED, m, and lean of the axis along u and v, rad, of hypothesis ``h``."""
    x, y = h // _LEANS % _LEANS, h % _LEANS
    return _PLATES_M[h // (_LEANS * _LEANS)], _LEAN * (x - _LEANS // 2), _LEAN * (y - _LEANS // 2)


@kernel
def nearest(view, c, u, v, in_use, most):
    """Return the distance, px, of the nearest spot of camera ``c`` with ``in_use`` of at most ``most``."""
    distance = np.inf
    for k in range(view.counts[c]):
        if in_use[c, k] <= most:
            distance = min(distance, math.hypot(view.spots[c, k].u - u, view.spots[c, k].v - v))
    return distance


@kernel
def plate_shows(scene, view, fit):
    """Return whether lights that ``fit`` does not use are where a plate behind the LEDs shows their reflections.

    Each reflection has to be a light in both cameras, one of which may see it merged with another spot; one in four may
    be missing.
    """
    in_use = np.zeros((2, MAX_SPOTS), np.int64)
    leds, unused = scene.leds.shape[0], 0
    rear = -np.inf
    for n in range(leds):
        rear = max(rear, scene.leds[n, 2])
    for c in range(2):
        unused += view.counts[c]
        for n in range(leds):
            if fit.spot[c, n] >= 0:
                in_use[c, fit.spot[c, n]] = 1
                unused -= 1
    if unused == 0:
        return False
    arm, point, led, image = np.empty(3), np.empty(3), np.empty(3), np.empty((2, 2))
    for step in range(_PLATES):
        plate = _NEAREST_M * (_FARTHEST_M / _NEAREST_M) ** (step / (_PLATES - 1.0))
        shown, missing = 0, 0
        for n in range(leds):
            seen, merged = 0, 0
            for c in range(2):
                for end in range(2):
                    led[0], led[1], led[2] = scene.leds[n, 0], scene.leds[n, 1], scene.leds[n, 2]
                    if end == 1:
                        led[2] += 2.0 * (rear + plate - led[2])
                    place_when_seen(scene, c, led, fit.r, fit.t, arm, point)
                    image[end, 0], image[end, 1] = project(scene.lens[c], point[0], point[1], point[2])
                away = math.hypot(image[1, 0] - image[0, 0], image[1, 1] - image[0, 1])
                reach = min(_ACROSS_PX + _LEANING * away, 0.5 * away)  # not the light of the LED itself
                if away > _SEEN_PX and nearest(view, c, image[1, 0], image[1, 1], in_use, 0) < reach:
                    seen += 1
                elif nearest(view, c, image[1, 0], image[1, 1], in_use, 1) < _MERGED_PX:
                    merged += 1
            if seen > 0 and seen + merged == 2:
                shown += 1
            elif seen + merged < 2:
                missing += 1
        if shown > 3 * missing:
            return True
    return False


@kernel
def moved_pose(scene, view, fit, shift):
    """Return by how many of its sigmas at most a component of the pose is off, if its spots are off by ``shift``."""
    eq = equations_of(fit, scene.leds.shape[0])
    if eq.which.shape[0] < 3 or not linearise(scene, view, fit.spot, fit.r, fit.t, eq):
        return 0.0
    fill_shared(scene, fit.r, fit.t, eq)
    if not math.isfinite(fill_weights(view, fit.spot, eq.shared, fit.floor, eq)):
        return 0.0
    for k in range(eq.which.shape[0]):
        for i in range(2):
            eq.residual[2 * k + i] = shift[eq.which[k, 0], eq.which[k, 1], i]
    normal_equations(eq)
    largest = 0.0
    for a in range(6):
        moved = 0.0
        for b in range(6):
            moved += fit.covariance[a, b] * eq.gradient[b]
        largest = max(largest, abs(moved) / math.sqrt(fit.covariance[a, a]))
    return largest


@kernel
def odd_light(scene, view, fit):
    """Return the LED whose spots are elongated least like the others', and by how many sigmas.

    A disc of radius r that is cut to a half is displaced by 0.42 r and has 0.09 r^2 less of half the difference of its
    variances; motion, tilt and the lens elongate all spots alike, but for the angles at which the LEDs are seen.
    0.0 sigmas with fewer than five spots in each camera.
    """
    n_leds, away = scene.leds.shape[0], 0.0
    total, other, used = np.zeros(n_leds), np.empty((2, n_leds)), np.empty(n_leds, np.int64)
    for i in range(3):
        away += fit.t[i] * fit.t[i]
    away = math.sqrt(away)
    for c in range(2):
        m = 0
        for n in range(n_leds):
            if fit.spot[c, n] >= 0 and math.isfinite(view.spots[c, fit.spot[c, n]].shape[0]):
                used[m] = n
                m += 1
        if m < _FEWEST_OF_ONE:
            continue
        for k in range(m):
            for i in range(2):
                at = 0
                for q in range(m):
                    if q != k:
                        other[i, at] = view.spots[c, fit.spot[c, used[q]]].shape[i]
                        at += 1
            usual_u, usual_v = np.median(other[0, : m - 1]), np.median(other[1, : m - 1])
            spot, led = view.spots[c, fit.spot[c, used[k]]], scene.leds[used[k]]
            angle = math.sqrt(led[0] * led[0] + led[1] * led[1] + led[2] * led[2]) / away
            seen = _SEEN_ALIKE * angle * max(spot.shape[2] - _BLUR_PX2, 0.0)
            variance = spot.shape_sigma[0] ** 2 + _LEAST_PX2**2 + seen**2 + (0.5 * _SIZE * spot.shape[2]) ** 2
            variance += _ODD_RELATIVE**2 * (usual_u**2 + usual_v**2)
            total[used[k]] += ((spot.shape[0] - usual_u) ** 2 + (spot.shape[1] - usual_v) ** 2) / variance
    worst = 0
    for n in range(n_leds):
        if total[n] > total[worst]:
            worst = n
    return worst, math.sqrt(total[worst])


@kernel
def mirrored(scene, view, fit):
    """Return ``plate_shows`` and, unless it does, the results of ``doubled_lights`` and ``moved_pose`` for it."""
    if plate_shows(scene, view, fit):
        return True, 0.0, 0.0, 0.0
    shift = np.zeros((2, scene.leds.shape[0], 2))
    depth, ratio = doubled_lights(scene, view, fit, shift)
    return False, depth, ratio, moved_pose(scene, view, fit, shift) if ratio > 1.0 else 0.0
