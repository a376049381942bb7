"""Range, rate, passive angles and line of sight from the motion, with their covariance."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.core.jit import kernel
from hil.models import docking_view
from hil.monitor.results import QUANTITIES

Floats = NDArray[np.float64]

_STEP: Final = 1e-6


@kernel
def quantities(w, out):
    """Write QUANTITIES (12,), SI, for the motion ``w`` (12,): d1, d1', d2, d2', d3, d3', phi1, phi1', ... (3.2).

    Passive pitch atan2(d2, hypot(d1, d3)), passive yaw atan2(d1, d3); line of sight of the disc's centre in S:
    atan2(x1, x3) to the right, atan2(x2, x3) up.
    """
    d, phi, origin = np.empty(3), np.empty(3), np.zeros(3)
    along, square = 0.0, 0.0
    for i in range(3):
        d[i], phi[i] = w[2 * i], w[6 + 2 * i]
        out[i], out[3 + i] = d[i], phi[i]
        square += d[i] * d[i]
        along += d[i] * w[2 * i + 1]
    out[6] = math.sqrt(square)
    out[7] = along / out[6]
    out[8] = math.atan2(d[1], math.hypot(d[0], d[2]))
    out[9] = math.atan2(d[0], d[2])
    x = docking_view.to_camera(docking_view.attitude(phi), d, origin)
    out[10] = math.atan2(x[0], x[2])
    out[11] = math.atan2(x[1], x[2])


def derive(w: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return QUANTITIES and their sigmas, (12,) each, SI, for the motion (12,) and its covariance (12, 12)."""
    n = len(QUANTITIES)
    values, ahead, behind = np.empty(n), np.empty(n), np.empty(n)
    quantities(w, values)
    slopes = np.empty((n, 12))
    for k in range(12):
        moved = w.copy()
        moved[k] = w[k] + _STEP
        quantities(moved, ahead)
        moved[k] = w[k] - _STEP
        quantities(moved, behind)
        slopes[:, k] = (ahead - behind) / (2.0 * _STEP)
    variances = np.einsum("ij,jk,ik->i", slopes, covariance, slopes)
    return values, np.sqrt(np.maximum(variances, 0.0))
