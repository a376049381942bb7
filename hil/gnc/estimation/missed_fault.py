"""Error to which the largest fault of a sensor leads that its monitors miss."""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel


@kernel
def largest_missed(params, gain, gain_speed, n, limit, kind, most):
    """Return the largest error to which a fault leads until it is found, and the size of that fault.

    In standard deviations of an innovation. params: ``mean_shift`` of the CUSUM, ``gate`` of a component. gain,
    gain_speed: of position and velocity per measurement. kind: 0 a step, 1 a ramp of so much per measurement. limit: of
    the CUSUM. n: measurements. most: largest fault.
    Position and velocity follow the fault by the gains, and the innovations fade as they do; it is found when its
    normalised innovations have passed the gate or summed up to the limit.
    """
    r, v, total, missed, largest = 0.0, 0.0, 0.0, np.inf, 0.0
    for j in range(1, int(n) + 1):
        fault = 1.0 if kind == 0 else float(j)
        r += v
        innovation = fault - r
        r += gain * innovation
        v += gain_speed * innovation
        total += innovation
        size = (params.mean_shift * j + limit) / total if total > 0.0 else np.inf
        if innovation > 0.0:
            size = min(size, params.gate / innovation)
        if size < missed or most < missed:  # one that was found before has ended
            missed = min(missed, size)
            largest = max(largest, min(size, most) * abs(r))
    return largest, min(missed, most)
