"""Pose of the camera from the measured shifts of edges: Gauss-Newton on d and phi with the exact projection.

A seventh unknown is the edges' growth, px: the displacement common to all borders of parts, outwards from the
geometry. Cameras and renderers have one (irradiation, thresholds, rounding); if neglected it biases the range.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import cholesky
from hil.models import docking_view
from hil.monitor.kernels.edge_samples import STEP

UNKNOWNS = 7

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
def _add_prior(normal, right, x, prior):
    """Add the prior information, which matters only for what the edges leave open.

    prior: (2,), 1 sigma of d1/d3 and d2/d3, rad (the passive angles are small), and of the growth, px.
    """
    for i in range(2):
        weight = 1.0 / (prior[0] * prior[0] * x[2] * x[2])
        normal[i, i] += weight
        right[i] -= weight * x[i]
    weight = 1.0 / (prior[1] * prior[1])
    normal[6, 6] += weight
    right[6] -= weight * x[6]


@kernel
def fit_pose(lens, samples, count, pose, robust, prior, turns, normal):
    """Improve ``pose`` (7,): d, m, phi, rad, growth, px, by the shifts of the samples.

    normal: (7, 7), overwritten by the normal matrix of the edges alone.

    Samples with good = 1 are used. robust: px; above 0, samples have equal weight times Tukey's weight of that
    scale; at 0 the inverse of their variance. Return whether the pose is determined (with the prior).
    """
    a = docking_view.attitude(pose[3:6])
    slopes, row = np.empty((3, 3, 3)), np.empty(UNKNOWNS)
    right, step, full = np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.empty((UNKNOWNS, UNKNOWNS))
    for _ in range(turns):
        a = docking_view.attitude(pose[3:6])
        attitude_derivatives(pose[3:6], slopes)
        for i in range(UNKNOWNS):
            right[i] = 0.0
            for j in range(UNKNOWNS):
                normal[i, j] = 0.0
        for c in range(count):
            sample = samples[c]
            if sample.good != 1:
                continue
            u, v = point_row(lens, a, slopes, pose[:3], sample.y1, sample.y2, sample.y3, sample.nu, sample.nv, row)
            row[6] = 1.0 if sample.kind == STEP else 0.0
            left = sample.shift - (sample.nu * (u - sample.u) + sample.nv * (v - sample.v)) - row[6] * pose[6]
            if not math.isfinite(left):
                return False
            weight = 1.0 / max(sample.variance, 1e-12)
            if robust > 0.0:
                inside = 1.0 - (left / robust) ** 2
                weight = inside * inside if inside > 0.0 else 0.0
            for i in range(UNKNOWNS):
                right[i] += weight * row[i] * left
                for j in range(i + 1):
                    normal[i, j] += weight * row[i] * row[j]
        for i in range(UNKNOWNS):
            for j in range(i):
                normal[j, i] = normal[i, j]
        for i in range(UNKNOWNS):
            for j in range(UNKNOWNS):
                full[i, j] = normal[i, j]
        _add_prior(full, right, pose, prior)
        if not cholesky.solve_system(full, right, step):
            return False
        for i in range(UNKNOWNS):
            pose[i] += step[i]
        if not (pose[2] > 0.01 and abs(step[3]) < 1.0 and abs(step[4]) < 1.0 and abs(step[5]) < 1.0):
            return False
    return True


@kernel
def residuals(lens, samples, count, pose, left):
    """Write each sample's shift minus the edge's shift under ``pose``, px (nan for samples that are not good)."""
    a = docking_view.attitude(pose[3:6])
    p = np.empty(3)
    for c in range(count):
        sample = samples[c]
        left[c] = np.nan
        if sample.good == 1:
            p[0], p[1], p[2] = sample.y1, sample.y2, sample.y3
            x = docking_view.to_camera(a, pose[:3], p)
            u, v = docking_view.project_point(lens[0], lens[1], lens[2], x)
            left[c] = sample.shift - (sample.nu * (u - sample.u) + sample.nv * (v - sample.v))
            if sample.kind == STEP:
                left[c] -= pose[6]
