"""Pose hypotheses: mirror image, pose difference, duplicates, test of the residuals."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.match import chi_square_limit

_SAME_SQUARE = 1.0  # Mahalanobis distance of two poses that count as one
_CLOSE = 1e-7  # and m or rad below which they do in any case


@kernel
def mirror(r, t, normal, centre, r_out, t_out):
    """Write the pose with the target's tilt reversed: the other solution of a flat target.

    Depths along the line of sight to ``centre`` (3,), m, in t, change sign. normal: (3,), of the plane, in t.
    Oberkampf, DeMenthon, Davis, "Iterative pose estimation using coplanar feature points", CVIU 63 (1996).
    """
    c, n, sight = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        c[i] = t[i] + r[i, 0] * centre[0] + r[i, 1] * centre[1] + r[i, 2] * centre[2]
    away = math.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    for i in range(3):
        sight[i] = c[i] / away
    for i in range(3):  # r (I - 2 n n.T): its normal changes sign
        n[i] = r[i, 0] * normal[0] + r[i, 1] * normal[1] + r[i, 2] * normal[2]
    for j in range(3):
        along = 0.0
        for i in range(3):
            along += sight[i] * (r[i, j] - 2.0 * n[i] * normal[j])
        for i in range(3):
            r_out[i, j] = r[i, j] - 2.0 * n[i] * normal[j] - 2.0 * sight[i] * along
    for i in range(3):
        t_out[i] = c[i] - (r_out[i, 0] * centre[0] + r_out[i, 1] * centre[1] + r_out[i, 2] * centre[2])


@kernel
def difference(r_a, t_a, r_b, t_b, out):
    """Write pose a minus pose b to out (6,): t_a - t_b, m, and the small rotation e, rad, with r_a = exp([e]x) r_b."""
    trace = 0.0
    for i in range(3):
        out[i] = t_a[i] - t_b[i]
        for j in range(3):
            trace += r_a[i, j] * r_b[i, j]
    x = y = z = 0.0
    for j in range(3):
        x += r_a[2, j] * r_b[1, j] - r_a[1, j] * r_b[2, j]
        y += r_a[0, j] * r_b[2, j] - r_a[2, j] * r_b[0, j]
        z += r_a[1, j] * r_b[0, j] - r_a[0, j] * r_b[1, j]
    size = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(0.5 * size, 0.5 * (trace - 1.0))
    if size > 1e-9:
        scale = angle / size
    elif trace > 0.0:
        scale = 0.5
    else:
        x, y, z, scale = math.pi, 0.0, 0.0, 1.0  # 180 deg: the axis is arbitrary, no caller depends on it
    out[3], out[4], out[5] = x * scale, y * scale, z * scale


@kernel
def same_pose(a, b, d):
    """Return whether two converged hypotheses are one pose. d: (6,), scratch."""
    difference(a.r, a.t, b.r, b.t, d)
    for i in range(6):
        least = min(a.covariance[i, i], b.covariance[i, i])
        if abs(d[i]) > _CLOSE and d[i] * d[i] > _SAME_SQUARE * least:
            return False
    return True


@kernel
def acceptable(fit):
    """Return whether a converged hypothesis passes the test of its residuals."""
    return fit.valid == 1 and fit.points >= 3 and fit.chi2 <= chi_square_limit(2 * fit.points - 6)


@kernel
def is_known(fits, count, fit, d):
    """Return whether one of the first ``count`` is the same pose; replace it by ``fit`` if that uses more spots.

    d: (6,), scratch.
    """
    for k in range(count):
        if same_pose(fits[k], fit, d):
            if fit.points > fits[k].points:
                fits[k] = fit
            return True
    return False
