"""Where in the images the LEDs of a predicted pose are to be looked for."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.lens import project
from hil.vmu.kernels.refine import jacobian, place

_SIGMAS = 4.5
_SPOT_M = 0.012  # about the largest LED, with its halo
_MARGIN_PX = 8.0


@kernel
def led_windows(scene, r, t, covariance, out, counts):
    """Write to out (2, n, 4) the windows, px, of each camera: u and v of the first pixel and past the last.

    covariance: (6, 6), of the pose. counts: (2,), how many windows each camera has; LEDs out of view have none.
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
            halo = _MARGIN_PX + lens.fx * _SPOT_M / point[2]
            row = out[c, counts[c]]
            for i in range(2):
                variance = 0.0
                for a in range(6):
                    for b in range(6):
                        variance += j[i, a] * covariance[a, b] * j[i, b]
                half = _SIGMAS * math.sqrt(variance) + halo
                centre, end = (u, lens.width) if i == 0 else (v, lens.height)
                row[i] = max(math.floor(centre - half), 0.0)
                row[2 + i] = min(math.ceil(centre + half) + 1.0, end)
            if row[0] < row[2] and row[1] < row[3]:
                counts[c] += 1
