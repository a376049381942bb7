"""Ephemeris of the Hill frame H of a perturbed orbit: a table over the time of a run, and its interpolation."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import fill

ROWS_MAX: Final = 1024
FRAME_COLUMNS: Final = 7
"""Of a row: rates of H about -y and about z, rad/s, GM/r^3, 1/s^2, and q_HI (4,)."""
INTERPOLATED: Final = 6  # rows: Lagrange's polynomial of the fifth degree

EPHEMERIS = np.dtype(
    [
        ("n", "i8"),  # rows, 0: the orbit is that of elements, about a point mass; at least INTERPOLATED
        ("interval_s", "f8"),  # the first row is the start of the run
        ("row", "f8", (ROWS_MAX, FRAME_COLUMNS)),
    ],
    align=True,
)


@kernel
def frame_of_ephemeris(ephemeris, t_s, out):
    """Write the rates of H about -y and z, rad/s, and GM/r^3, 1/s^2, at ``t_s`` of the run into ``out`` (3,)."""
    at = t_s / ephemeris.interval_s
    first = min(max(int(at) - INTERPOLATED // 2 + 1, 0), ephemeris.n - INTERPOLATED)
    at -= first
    fill(out, 0.0)
    for j in range(INTERPOLATED):
        weight = 1.0
        for k in range(INTERPOLATED):
            if k != j:
                weight *= (at - k) / (j - k)
        for i in range(3):
            out[i] += weight * ephemeris.row[first + j, i]


@kernel
def attitude_of_ephemeris(ephemeris, t_s, q_HI):
    """Write ``q_HI`` (4,) at ``t_s`` of the run from the row before; the mean rate in between is by Simpson's rule."""
    turn, frame, rotation = stack.vector(3), stack.vector(3), stack.vector(4)
    k = min(max(int(t_s / ephemeris.interval_s), 0), ephemeris.n - 1)
    since_s = t_s - k * ephemeris.interval_s
    fill(turn, 0.0)
    for part in range(3):
        frame_of_ephemeris(ephemeris, t_s - 0.5 * part * since_s, frame)
        weight = since_s * (4.0 if part == 1 else 1.0) / 6.0
        turn[1] -= weight * frame[0]
        turn[2] += weight * frame[1]
    quat.from_rotation_vector_into(turn, rotation)
    quat.multiply_into(rotation, ephemeris.row[k, 3:7], q_HI)
