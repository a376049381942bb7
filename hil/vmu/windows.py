"""Where in the images the LEDs of a predicted pose are to be looked for."""

from __future__ import annotations

import math

import numpy as np

from hil.messages import Array
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.records import Scene
from hil.vmu.kernels.refine import jacobian, place

_SIGMAS = 4.5
_SPOT_M = 0.012  # about the largest LED, with its halo
_MARGIN_PX = 8.0


def windows(scene: Scene, r: Array, t: Array, covariance: Array) -> tuple[Array, Array]:
    """Return for each camera the windows (k, 4), px, of the LEDs: u and v of the first pixel and past the last."""
    found: list[list[tuple[int, int, int, int]]] = [[], []]
    arm, point, slopes, j = np.empty(3), np.empty(3), np.empty((2, 3)), np.empty((2, 6))
    for c in range(2):
        lens = scene.lens[c]
        width, height = int(lens["width"]), int(lens["height"])
        for led in scene.leds:
            place(scene.rotation[c], scene.translation[c], r, t, led, arm, point)
            u, v = project(lens, point[0], point[1], point[2])
            if not math.isfinite(u + v):
                continue
            jacobian(lens, scene.rotation[c], arm, point, slopes, j)
            spread = np.sqrt(np.diag(j @ covariance @ j.T))
            half = _SIGMAS * spread + _MARGIN_PX + lens["fx"] * _SPOT_M / point[2]
            first = max(math.floor(u - half[0]), 0), max(math.floor(v - half[1]), 0)
            last = min(math.ceil(u + half[0]) + 1, width), min(math.ceil(v + half[1]) + 1, height)
            if first[0] < last[0] and first[1] < last[1]:
                found[c].append((*first, *last))
    left, right = (np.array(rows, dtype=float).reshape(-1, 4) for rows in found)
    return left, right
