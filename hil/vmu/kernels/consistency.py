"""Information of a pose's residuals about the parameters that the pose considers, not estimates.

The residuals of a fit are ``B p + J x + n``: p, the considered parameters (``budget``), x the error of the pose, n the
noise. With the pose eliminated, ``M = W - W J (J.T W J)^-1 J.T W`` and ``W`` the inverse of the noise's covariance, the
information about p is ``B.T M B``, and ``B.T M residual`` its product with the estimate.
With a rolling shutter the rates of the target are eliminated with its pose.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths.arrays import copy_matrix
from hil.vmu.kernels.budget import columns_of, equations_of, linearise, motion_slopes, shared_slopes

_DEPENDENT = 1e-9  # of a column's square


@kernel
def add_information(scene, view, fit, floor_square, information, product):
    """Add pose ``fit`` (FIT) to information (p, p) and product (p,); return the number of residuals.

    floor_square: px^2, variance of each coordinate of a spot beyond its noise.
    """
    columns, slopes = np.empty(18, np.int64), np.empty((2, 18))
    nuisance = 12 if scene.lens[0].row_s != 0.0 or scene.lens[1].row_s != 0.0 else 6
    eq = equations_of(fit, scene.leds.shape[0])
    which, residual, m = eq.which, eq.residual, eq.which.shape[0]
    if m < 4 or not linearise(scene, view, fit.spot, fit.r, fit.t, eq):
        return 0
    jac = np.empty((2 * m, 12))
    copy_matrix(jac[:, :6], eq.jacobian)
    p = information.shape[0]
    rows = np.zeros((2 * m, p))
    for k in range(m):
        c, n = which[k, 0], which[k, 1]
        width = columns_of(c, n, columns)
        shared_slopes(scene, fit.r, fit.t, c, n, slopes)
        spot = view.spots[c, fit.spot[c, n]]
        first = math.sqrt(spot.noise_uu + floor_square)  # whitened by the Cholesky factor of the spot's covariance
        below = spot.noise_uv / first
        second = math.sqrt(spot.noise_vv + floor_square - below * below)
        for a in range(width):
            rows[2 * k, columns[a]] = slopes[0, a] / first
            rows[2 * k + 1, columns[a]] = (slopes[1, a] - below * rows[2 * k, columns[a]]) / second
        if nuisance > 6:
            motion_slopes(scene, fit.r, fit.t, c, n, jac[2 * k : 2 * k + 2, 6:])
        residual[2 * k] /= first
        residual[2 * k + 1] = (residual[2 * k + 1] - below * residual[2 * k]) / second
        for a in range(nuisance):
            jac[2 * k, a] /= first
            jac[2 * k + 1, a] = (jac[2 * k + 1, a] - below * jac[2 * k, a]) / second
    for a in range(nuisance):  # the columns of J, orthonormal, are taken out of all others
        diagonal = 0.0
        for k in range(2 * m):
            diagonal += jac[k, a] * jac[k, a]
        for b in range(a):
            along = 0.0
            for k in range(2 * m):
                along += jac[k, b] * jac[k, a]
            for k in range(2 * m):
                jac[k, a] -= along * jac[k, b]
        size = 0.0
        for k in range(2 * m):
            size += jac[k, a] * jac[k, a]
        scale = 1.0 / math.sqrt(size) if size > _DEPENDENT * diagonal else 0.0
        for k in range(2 * m):
            jac[k, a] *= scale
        along = 0.0
        for k in range(2 * m):
            along += jac[k, a] * residual[k]
        for k in range(2 * m):
            residual[k] -= along * jac[k, a]
        for i in range(p):
            along = 0.0
            for k in range(2 * m):
                along += jac[k, a] * rows[k, i]
            if along != 0.0:
                for k in range(2 * m):
                    rows[k, i] -= along * jac[k, a]
    for i in range(p):
        for k in range(2 * m):
            product[i] += rows[k, i] * residual[k]
        for j in range(i + 1):
            total = 0.0
            for k in range(2 * m):
                total += rows[k, i] * rows[k, j]
            information[i, j] += total
            if i != j:
                information[j, i] += total
    return 2 * m
