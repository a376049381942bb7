"""The reference line: straight from the start to the ready point with a trapezoidal speed, then a hold."""

from __future__ import annotations

import math

import numpy as np

from hil.maths.jit import kernel
from hil.maths.profile import along_line

GUIDANCE_PARAMS = np.dtype(
    [
        ("start", "f8", 3),  # m, in H
        ("ready", "f8", 3),  # m, in H
        ("speed", "f8"),  # m/s
        ("acceleration", "f8"),  # m/s^2
        ("deceleration", "f8"),  # m/s^2
    ],
    align=True,
)


@kernel
def reference(params, t_s, out):
    """Write ``out`` (REFERENCE) for ``t_s`` after the start of the approach; the attitude is that of H."""
    length = 0.0
    for i in range(3):
        length += (params.ready[i] - params.start[i]) ** 2
    length = math.sqrt(length)
    along = np.empty(3)
    along_line(length, params.speed, params.acceleration, params.deceleration, t_s, along)
    for i in range(3):
        unit = (params.ready[i] - params.start[i]) / length if length > 0.0 else 0.0
        out.r_CT_H[i] = params.start[i] + along[0] * unit
        out.v_CT_H[i] = along[1] * unit
        out.a_CT_H[i] = along[2] * unit
        out.q_CH[i] = 0.0
    out.q_CH[3] = 1.0
