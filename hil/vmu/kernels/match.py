"""Assignment of spots to LEDs for an approximate pose, with outlier removal, score, and search windows."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.lens import in_image, project, undistort
from hil.vmu.kernels.records import MAX_LEDS
from hil.vmu.kernels.refine import jacobian, place, refine

_GATE = 20.0  # chi-square of two components that one true spot in 22000 exceeds
_ROUNDS = 6
_LIMIT_SIGMA = 4.9  # of the sum of squares: one good fit in two million exceeds it
_UNSEEN_COST = 2.0  # ln of the odds that an LED in view is lit and detected
_EDGE_PX = 4.0  # an LED nearer to the image's edge may not be detected
_WINDOW_SIGMAS = 4.5
_SPOT_M = 0.012  # largest LED, with its halo
_WINDOW_MARGIN_PX = 8.0


@kernel
def fill_spot_ray(lens, spot, measured):
    """Write SPOT ``spot`` as SPOT_RAY."""
    measured.u, measured.v = spot.u, spot.v
    measured.var_u, measured.var_v, measured.cov_uv = spot.var_u, spot.var_v, spot.cov_uv
    det = spot.var_u * spot.var_v - spot.cov_uv * spot.cov_uv
    measured.w_uu, measured.w_vv, measured.w_uv = spot.var_v / det, spot.var_u / det, -spot.cov_uv / det
    measured.flux = spot.flux
    x, y = undistort(lens, spot.u, spot.v)
    size = 1.0 / math.sqrt(x * x + y * y + 1.0)
    measured.ray[0], measured.ray[1], measured.ray[2] = x * size, y * size, size


@kernel
def chi_square_limit(degrees):
    """Return the limit of the sum of squares for a fit with ``degrees`` of freedom (Wilson and Hilferty)."""
    if degrees <= 0:
        return 1e-3
    part = 2.0 / (9.0 * degrees)
    return degrees * (1.0 - part + _LIMIT_SIGMA * math.sqrt(part)) ** 3


@kernel
def spread(j, covariance, measured, out):
    """Write the covariance (uu, uv, vv) of spot minus projection, px^2, for a pose of ``covariance`` (6, 6)."""
    uu, uv, vv = measured.var_u, measured.cov_uv, measured.var_v
    for a in range(6):
        pu, pv = 0.0, 0.0
        for b in range(6):
            pu += covariance[a, b] * j[0, b]
            pv += covariance[a, b] * j[1, b]
        uu += j[0, a] * pu
        uv += j[0, a] * pv
        vv += j[1, a] * pv
    out[0], out[1], out[2] = uu, uv, vv


@kernel
def assign(scene, view, r, t, covariance, reach_px, barred, spot):
    """Write the spot of each camera and LED to spot (2, MAX_LEDS): nearest by Mahalanobis distance, mutual, gated.

    covariance: of the pose, (6, 6). reach_px: largest distance of a spot. barred: (2, MAX_LEDS), spot excluded for this
    LED, -1 for none. Return the number of gates that contain more than one spot or share one.
    """
    arm, point, slopes, j, s = np.empty(3), np.empty(3), np.empty((2, 3)), np.empty((2, 6)), np.empty(3)
    distance = np.empty(MAX_LEDS)
    contested = 0
    for c in range(2):
        for n in range(MAX_LEDS):
            spot[c, n] = -1
            distance[n] = np.inf
        for n in range(scene.leds.shape[0]):
            place(scene.rotation[c], scene.translation[c], r, t, scene.leds[n], arm, point)
            u, v = project(scene.lens[c], point[0], point[1], point[2])
            if not math.isfinite(u):
                continue
            jacobian(scene.lens[c], scene.rotation[c], arm, point, slopes, j)
            within = 0
            for k in range(view.counts[c]):
                du, dv = view.spots[c, k].u - u, view.spots[c, k].v - v
                if not du * du + dv * dv < reach_px * reach_px or barred[c, n] == k:
                    continue
                spread(j, covariance, view.spots[c, k], s)
                det = s[0] * s[2] - s[1] * s[1]
                square = (s[2] * du * du - 2.0 * s[1] * du * dv + s[0] * dv * dv) / det
                if square < _GATE:
                    within += 1
                    if square < distance[n]:
                        distance[n] = square
                        spot[c, n] = k
            if within > 1:
                contested += 1
        for n in range(scene.leds.shape[0]):
            for m in range(n):
                if spot[c, n] >= 0 and spot[c, n] == spot[c, m]:
                    contested += 1
                    spot[c, n if distance[n] > distance[m] else m] = -1
    return contested


@kernel
def worst_spot(scene, view, fit, where):
    """Write camera and LED of the spot whose removal lowers chi-square most to where (2,).

    Its residual is weighted by its own covariance minus that of the fit (the spot has attracted the fit).
    """
    arm, point, slopes, j, s = np.empty(3), np.empty(3), np.empty((2, 3)), np.empty((2, 6)), np.empty(3)
    worst = -1.0
    for c in range(2):
        for n in range(scene.leds.shape[0]):
            k = fit.spot[c, n]
            if k < 0:
                continue
            measured = view.spots[c, k]
            place(scene.rotation[c], scene.translation[c], fit.r, fit.t, scene.leds[n], arm, point)
            u, v = project(scene.lens[c], point[0], point[1], point[2])
            du, dv = measured.u - u, measured.v - v
            jacobian(scene.lens[c], scene.rotation[c], arm, point, slopes, j)
            spread(j, fit.covariance, measured, s)
            floor = 1e-3
            uu = max(2.0 * measured.var_u - s[0], floor * measured.var_u)
            vv = max(2.0 * measured.var_v - s[2], floor * measured.var_v)
            uv = 2.0 * measured.cov_uv - s[1]
            det = uu * vv - uv * uv
            if not det > 0.0:
                uv, det = 0.0, uu * vv
            square = (vv * du * du - 2.0 * uv * du * dv + uu * dv * dv) / det
            if square > worst:
                worst = square
                where[0], where[1] = c, n


@kernel
def count(fit, n_leds):
    """Write the number of spots that ``fit`` uses."""
    fit.points = 0
    for c in range(2):
        for n in range(n_leds):
            if fit.spot[c, n] >= 0:
                fit.points += 1


@kernel
def converge(scene, view, reach_px, fit):
    """Extend a start pose and first spots in ``fit`` to all matching spots, without outliers.

    Alternates between refinement and assignment within the gates of the refined pose; then, while chi-square is too
    high and enough spots remain to identify the outlier, removes the worst.
    """
    before = np.empty((2, MAX_LEDS), np.int64)
    barred = np.full((2, MAX_LEDS), -1, np.int64)
    where = np.zeros(2, np.int64)
    fit.removed = 0
    for _ in range(_ROUNDS + 4):
        refine(scene, view, fit)
        if fit.valid == 0:
            return
        changed = False
        for c in range(2):
            for n in range(MAX_LEDS):
                before[c, n] = fit.spot[c, n]
        assign(scene, view, fit.r, fit.t, fit.covariance, reach_px, barred, fit.spot)
        for c in range(2):
            for n in range(scene.leds.shape[0]):
                if before[c, n] >= 0 and fit.spot[c, n] < 0 and barred[c, n] < 0:
                    fit.spot[c, n] = before[c, n]  # a spot is removed only as an outlier, worst first
                    for m in range(scene.leds.shape[0]):
                        if m != n and fit.spot[c, m] == fit.spot[c, n]:
                            fit.spot[c, n] = -1
                            break
                if fit.spot[c, n] != before[c, n]:
                    changed = True
        count(fit, scene.leds.shape[0])
        if fit.points < 3:
            fit.valid = 0
            return
        if changed:
            continue
        degrees = 2 * fit.points - 6
        if fit.chi2 <= chi_square_limit(degrees):
            return
        if fit.removed >= 3 or degrees - 2 < 2 + 2 * (fit.removed + 1):
            return
        worst_spot(scene, view, fit, where)
        barred[where[0], where[1]] = fit.spot[where[0], where[1]]
        fit.spot[where[0], where[1]] = -1
        fit.removed += 1


@kernel
def score_fit(scene, view, density, fit):
    """Write points, unseen and score of ``fit``.

    score: sum over the spots of the log density as an LED at its projection over ``density`` (2,), px^-2, that of stray
    lights in each image; minus a cost per LED that should be in view without a spot.
    """
    arm, point = np.empty(3), np.empty(3)
    count(fit, scene.leds.shape[0])
    fit.unseen = 0
    fit.score = -0.5 * fit.chi2
    for c in range(2):
        if view.counts[c] == 0:
            continue
        for n in range(scene.leds.shape[0]):
            k = fit.spot[c, n]
            if k >= 0:
                measured = view.spots[c, k]
                area = 2.0 * math.pi * math.sqrt(measured.var_u * measured.var_v - measured.cov_uv * measured.cov_uv)
                fit.score -= math.log(max(area, 0.01) * density[c])
                continue
            place(scene.rotation[c], scene.translation[c], fit.r, fit.t, scene.leds[n], arm, point)
            u, v = project(scene.lens[c], point[0], point[1], point[2])
            if in_image(scene.lens[c], u, v, _EDGE_PX):
                fit.unseen += 1
                fit.score -= _UNSEEN_COST


@kernel
def led_windows(scene, r, t, covariance, out, counts):
    """Write the windows, px, of the LEDs per camera to out (2, n, 4): u and v of the first pixel and after the last.

    covariance: (6, 6), of the pose. counts: (2,), number of windows per camera; LEDs out of view have none.
    """
    arm, point, slopes, j = np.empty(3), np.empty(3), np.empty((2, 3)), np.empty((2, 6))
    for c in range(2):
        counts[c] = 0
        lens = scene.lens[c]
        for n in range(scene.leds.shape[0]):
            place(scene.rotation[c], scene.translation[c], r, t, scene.leds[n], arm, point)
            u, v = project(lens, point[0], point[1], point[2])
            if not math.isfinite(u + v):
                continue
            jacobian(lens, scene.rotation[c], arm, point, slopes, j)
            halo = _WINDOW_MARGIN_PX + lens.fx * _SPOT_M / point[2]
            row = out[c, counts[c]]
            for i in range(2):
                variance = 0.0
                for a in range(6):
                    for b in range(6):
                        variance += j[i, a] * covariance[a, b] * j[i, b]
                half = _WINDOW_SIGMAS * math.sqrt(variance) + halo
                centre, end = (u, lens.width) if i == 0 else (v, lens.height)
                row[i] = max(math.floor(centre - half), 0.0)
                row[2 + i] = min(math.ceil(centre + half) + 1.0, end)
            if row[0] < row[2] and row[1] < row[3]:
                counts[c] += 1
