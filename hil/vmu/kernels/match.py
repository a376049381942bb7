"""Assignment of spots to LEDs for an approximate pose, and search windows."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths.arrays import copy_matrix
from hil.vmu.kernels.lens import project, undistort
from hil.vmu.kernels.records import CELLS, MAX_LEDS
from hil.vmu.kernels.refine import jacobian, place_when_seen, refine

_GATE = 20.0  # chi-square of two components that one true spot in 22000 exceeds
_ROUNDS = 10
_HOPELESS = 10.0  # times its limit, above which no other spots reduce chi-square enough
_LIMIT_SIGMA = 4.9  # of the sum of squares: one good fit in two million exceeds it
_WINDOW_SIGMAS = 4.5
_SPOT_M = 0.012  # largest LED, with its halo
_WINDOW_MARGIN_PX = 8.0


@kernel
def fill_spot_ray(lens, slack, spot, measured):
    """Write SPOT ``spot`` as SPOT_RAY. slack: px^2, variance that gates and search add."""
    measured.u, measured.v = spot.u, spot.v
    measured.noise_uu, measured.noise_vv, measured.noise_uv = spot.var_u, spot.var_v, spot.cov_uv
    var_u, var_v = spot.var_u + slack, spot.var_v + slack
    measured.var_u, measured.var_v, measured.cov_uv = var_u, var_v, spot.cov_uv
    det = var_u * var_v - spot.cov_uv * spot.cov_uv
    measured.w_uu, measured.w_vv, measured.w_uv = var_v / det, var_u / det, -spot.cov_uv / det
    measured.flux = spot.flux
    measured.shape[0], measured.shape[1] = spot.elongation[0], spot.elongation[1]
    measured.shape[2] = spot.size * spot.size
    measured.shape_sigma[0], measured.shape_sigma[1] = spot.shape_sigma[0], spot.shape_sigma[1]
    x, y = undistort(lens, spot.u, spot.v)
    size = 1.0 / math.sqrt(x * x + y * y + 1.0)
    measured.ray[0], measured.ray[1], measured.ray[2] = x * size, y * size, size


@kernel
def cell_of(lens, u, v):
    """Return row and column of the cell of a pixel, and the size of a cell, px."""
    size = max(lens.width, lens.height) / CELLS
    i, j = int(min(max(v / size, 0.0), CELLS - 1.0)), int(min(max(u / size, 0.0), CELLS - 1.0))
    return i, j, size


@kernel
def fill_view(lens, slack, spots, chosen, rays, near):
    """Write ``spots`` (SPOT) with the indices ``chosen`` as SPOT_RAY; set the cells next to them in ``near``."""
    for k in range(chosen.shape[0]):
        fill_spot_ray(lens, slack, spots[chosen[k]], rays[k])
        i, j, _ = cell_of(lens, rays[k].u, rays[k].v)
        near[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = 1


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
def assign(scene, view, r, t, covariance, reach_px, spot):
    """Write the spot of each camera and LED to spot (2, MAX_LEDS): nearest by Mahalanobis distance, mutual, gated.

    covariance: of the pose, (6, 6). reach_px: largest distance of a spot. Return the number of gates that contain more
    than one spot or share one.
    """
    arm, point, slopes, j, s = np.empty(3), np.empty(3), np.empty((2, 3)), np.empty((2, 6)), np.empty(3)
    distance = np.empty(scene.leds.shape[0])
    contested = 0
    for c in range(2):
        for n in range(scene.leds.shape[0]):
            spot[c, n] = -1
            distance[n] = np.inf
        for n in range(scene.leds.shape[0]):
            place_when_seen(scene, c, scene.leds[n], r, t, arm, point)
            u, v = project(scene.lens[c], point[0], point[1], point[2])
            if not math.isfinite(u):
                continue
            jacobian(scene.lens[c], scene.rotation[c], arm, point, slopes, j)
            within = 0
            for k in range(view.counts[c]):
                du, dv = view.spots[c, k].u - u, view.spots[c, k].v - v
                if not du * du + dv * dv < reach_px * reach_px:
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
def count(fit, n_leds):
    """Write the number of spots that ``fit`` uses."""
    fit.points = 0
    for c in range(2):
        for n in range(n_leds):
            if fit.spot[c, n] >= 0:
                fit.points += 1


@kernel
def keep_assigned(previous, n_leds, spot):
    """Give LEDs of ``spot`` (2, MAX_LEDS) that lost their spot the one in ``previous``; return whether any changed."""
    changed = False
    for c in range(2):
        for n in range(n_leds):
            if previous[c, n] >= 0 and spot[c, n] < 0:
                spot[c, n] = previous[c, n]
                for m in range(n_leds):
                    if m != n and spot[c, m] == spot[c, n]:
                        spot[c, n] = -1
                        break
            changed = changed or spot[c, n] != previous[c, n]
    return changed


@kernel
def converge(scene, view, reach_px, fit):
    """Extend a start pose and first spots in ``fit`` to all matching spots, with equal weights.

    Alternates between refinement and assignment within the gates of the refined pose.
    """
    previous = np.empty((2, MAX_LEDS), np.int64)
    fit.removed = 0
    count(fit, scene.leds.shape[0])
    for _ in range(_ROUNDS):
        refine(scene, view, _HOPELESS * chi_square_limit(2 * fit.points - 6), fit)
        if fit.valid == 0:
            return
        copy_matrix(previous, fit.spot)
        assign(scene, view, fit.r, fit.t, fit.covariance, reach_px, fit.spot)
        changed = keep_assigned(previous, scene.leds.shape[0], fit.spot)
        count(fit, scene.leds.shape[0])
        if fit.points < 3:
            fit.valid = 0
            return
        if not changed:
            return


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
            place_when_seen(scene, c, scene.leds[n], r, t, arm, point)
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
