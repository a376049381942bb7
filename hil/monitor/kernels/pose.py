"""Pose of the camera from the measured shifts of edges: Gauss-Newton on d and phi with the exact projection.

Three more unknowns are those of the camera. The edges' growth, px, is the displacement common to all borders of parts,
outwards from the geometry: cameras and renderers have one (irradiation, thresholds, rounding), and if neglected it biases
the range. A tone curve T that is not straight displaces a blurred edge towards its darker side, in proportion to its
step D and to the curve's bend at its middle level m; the bend of a gamma or an S-curve is about linear in m:

    shift = D / 128 * (a + b (1 - m / 128)),  a and b in px
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import cholesky
from hil.models import docking_view
from hil.monitor.kernels.edges import WHITE

UNKNOWNS = 9
"""d, m, phi, rad, growth, px, and both terms of the tone curve, px."""
PRIORS = 4
"""1 sigma of d1/d3 and d2/d3, rad, of the growth, px, and of both terms of the tone curve, px; 0: no such term."""
_WITHOUT_TONE = 7
HALF_SCALE = 128.0

_TURN = 1e-5  # rad, half step of the difference quotients of the attitude: error 1e-10


@kernel
def attitude_derivatives(phi, out):
    """Write the derivatives (3, 3, 3) of the attitude A with respect to phi: out[k] = dA / dphi_k."""
    turned = np.empty(3)
    for k in range(3):
        for i in range(3):
            turned[i] = phi[i]
        turned[k] = phi[k] + _TURN
        ahead = docking_view.attitude(turned)
        turned[k] = phi[k] - _TURN
        behind = docking_view.attitude(turned)
        for i in range(3):
            for j in range(3):
                out[k, i, j] = (ahead[i, j] - behind[i, j]) / (2.0 * _TURN)


@kernel
def point_row(lens, a, slopes, d, y1, y2, y3, nu, nv, row):
    """Write the derivatives (6,) of ``nu u + nv v`` of a point of C by (d, phi); return u, v (nan behind the camera).

    a: (3, 3), slopes: (3, 3, 3) from ``attitude_derivatives``.
    """
    r1, r2, r3 = y1 - d[0], y2 - d[1], y3 - d[2]
    x1 = a[0, 0] * r1 + a[1, 0] * r2 + a[2, 0] * r3
    x2 = a[0, 1] * r1 + a[1, 1] * r2 + a[2, 1] * r3
    x3 = a[0, 2] * r1 + a[1, 2] * r2 + a[2, 2] * r3
    if x3 < 1e-3:
        return np.nan, np.nan
    scale = lens[0] / x3
    g1, g2 = nu * scale, -nv * scale
    g3 = -(g1 * x1 + g2 * x2) / x3
    for i in range(3):
        row[i] = -(g1 * a[i, 0] + g2 * a[i, 1] + g3 * a[i, 2])
        s = slopes[i]
        row[3 + i] = (
            g1 * (s[0, 0] * r1 + s[1, 0] * r2 + s[2, 0] * r3)
            + g2 * (s[0, 1] * r1 + s[1, 1] * r2 + s[2, 1] * r3)
            + g3 * (s[0, 2] * r1 + s[1, 2] * r2 + s[2, 2] * r3)
        )
    return lens[1] + scale * x1, lens[2] - scale * x2


@kernel
def camera_row(sample, row):
    """Write the derivatives of a sample's shift by the camera's three unknowns to row[6:]."""
    low, high = min(sample.low, WHITE), min(sample.high, WHITE)
    row[6] = sample.grows
    row[7] = sample.grows * (low - high) / HALF_SCALE
    row[8] = row[7] * (1.0 - 0.5 * (low + high) / HALF_SCALE)


@kernel
def unknowns_of(prior):
    """Return the number of unknowns that ``prior`` (PRIORS,) leaves to be estimated."""
    return UNKNOWNS if prior[2] > 0.0 else _WITHOUT_TONE


@kernel
def _add_prior(normal, right, x, prior):
    """Add the prior information (PRIORS,), which matters only for what the edges leave open.

    The passive angles, the growth and the terms of the tone curve are small.
    """
    for i in range(2):
        weight = 1.0 / (prior[0] * prior[0] * x[2] * x[2])
        normal[i, i] += weight
        right[i] -= weight * x[i]
    for i in range(6, unknowns_of(prior)):
        sigma = prior[min(i - 5, PRIORS - 1)]
        weight = 1.0 / (sigma * sigma)
        normal[i, i] += weight
        right[i] -= weight * x[i]


@kernel
def fit_pose(lens, samples, count, pose, robust, prior, turns, normal):
    """Improve ``pose`` (9,): d, m, phi, rad, growth and tone, px, by the shifts of the samples.

    normal: (9, 9), overwritten by the normal matrix of the edges alone.

    Samples with good = 1 are used. robust: px; above 0, samples have equal weight times Tukey's weight of that
    scale; at 0 the inverse of their variance. Return whether the pose is determined (with the prior).
    """
    a = docking_view.attitude(pose[3:6])
    known = unknowns_of(prior)
    slopes, row = np.empty((3, 3, 3)), np.empty(UNKNOWNS)
    right, step, full = np.empty(known), np.empty(known), np.empty((known, known))
    for _ in range(turns):
        a = docking_view.attitude(pose[3:6])
        attitude_derivatives(pose[3:6], slopes)
        for i in range(known):
            right[i] = 0.0
        for i in range(UNKNOWNS):
            for j in range(UNKNOWNS):
                normal[i, j] = 0.0
        for c in range(count):
            sample = samples[c]
            if sample.good != 1:
                continue
            u, v = point_row(lens, a, slopes, pose[:3], sample.y1, sample.y2, sample.y3, sample.nu, sample.nv, row)
            camera_row(sample, row)
            left = sample.shift - (sample.nu * (u - sample.u) + sample.nv * (v - sample.v))
            for i in range(6, UNKNOWNS):
                left -= row[i] * pose[i]
            if not math.isfinite(left):
                return False
            weight = 1.0 / max(sample.variance, 1e-12)
            if robust > 0.0:
                inside = 1.0 - (left / robust) ** 2
                weight = inside * inside if inside > 0.0 else 0.0
            for i in range(known):
                right[i] += weight * row[i] * left
                for j in range(i + 1):
                    normal[i, j] += weight * row[i] * row[j]
        for i in range(known):
            for j in range(i):
                normal[j, i] = normal[i, j]
        for i in range(known):
            for j in range(known):
                full[i, j] = normal[i, j]
        _add_prior(full, right, pose, prior)
        if not cholesky.solve_system(full, right, step):
            return False
        for i in range(known):
            pose[i] += step[i]
        if not (pose[2] > 0.01 and abs(step[3]) < 1.0 and abs(step[4]) < 1.0 and abs(step[5]) < 1.0):
            return False
    return True


@kernel
def residuals(lens, samples, count, pose, left):
    """Write each sample's shift minus the edge's shift under ``pose``, px (nan for samples that are not good)."""
    a = docking_view.attitude(pose[3:6])
    p, row = np.empty(3), np.empty(UNKNOWNS)
    for c in range(count):
        sample = samples[c]
        left[c] = np.nan
        if sample.good == 1:
            p[0], p[1], p[2] = sample.y1, sample.y2, sample.y3
            x = docking_view.to_camera(a, pose[:3], p)
            u, v = docking_view.project_point(lens[0], lens[1], lens[2], x)
            left[c] = sample.shift - (sample.nu * (u - sample.u) + sample.nv * (v - sample.v))
            camera_row(sample, row)
            for i in range(6, UNKNOWNS):
                left[c] -= row[i] * pose[i]
