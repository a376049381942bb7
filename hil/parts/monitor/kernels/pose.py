"""Pose of the camera from the measured shifts of edges: Gauss-Newton on d and phi with the exact projection.

More unknowns are those of the camera, each with a prior; one with a prior of 0 is not estimated. The edges' growth, px,
is the displacement common to all borders of parts, outwards from the geometry: cameras and renderers have one
(irradiation, thresholds, rounding), and if neglected it biases the range. A tone curve that is not straight displaces a
blurred edge towards its darker side, in proportion to its step D and to the curve's bend at its middle level m:

    shift = D / 128 * (a + b w + c w^2),  w = 1 - m / 128,  a, b and c in px

The lens displaces the image at (u, v) from the principal point by e (u, v) + (p, q) + k r^2 / R^3 (u, v) + (0, s v):
focal length, principal point, distortion of k px at the corner R, height of the pixels.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import cholesky
from hil.models import docking_view
from hil.parts.monitor.kernels.edges import WHITE

GROWTH, TONE, FOCAL, ASPECT, POINT_U, POINT_V, DISTORTION = 6, 7, 10, 11, 12, 13, 14
UNKNOWNS = 15
"""d, m, phi, rad, then those of the camera: growth and three terms of the tone curve, px, focal length and height of
the pixels, relative, principal point and distortion, px."""
PRIORS = 1 + UNKNOWNS - GROWTH
"""1 sigma of d1/d3 and d2/d3, rad, and of each unknown of the camera; 0: it is not estimated."""
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
def camera_row(lens, sample, u, v, row):
    """Write the derivatives of a sample's shift by the unknowns of the camera to row[6:]; u, v: projection, px."""
    low, high = min(sample.low, WHITE), min(sample.high, WHITE)
    row[GROWTH] = sample.grows
    bend = 1.0 - 0.5 * (low + high) / HALF_SCALE
    row[TONE] = sample.grows * (low - high) / HALF_SCALE
    row[TONE + 1] = row[TONE] * bend
    row[TONE + 2] = row[TONE + 1] * bend
    across, down = u - lens[1], v - lens[2]
    outwards = sample.nu * across + sample.nv * down
    row[FOCAL], row[ASPECT] = outwards, sample.nv * down
    row[POINT_U], row[POINT_V] = sample.nu, sample.nv
    corner = 0.5 * math.hypot(lens[3], lens[4])
    row[DISTORTION] = outwards * (across * across + down * down) / (corner * corner * corner)


@kernel
def displace_samples(lens, samples, count, pose):
    """Move each sample to where the lens of ``pose`` (15,) displaces it."""
    corner = 0.5 * math.hypot(lens[3], lens[4])
    for c in range(count):
        sample = samples[c]
        across, down = sample.u - lens[1], sample.v - lens[2]
        scale = pose[FOCAL] + pose[DISTORTION] * (across * across + down * down) / (corner * corner * corner)
        sample.u += scale * across + pose[POINT_U]
        sample.v += (scale + pose[ASPECT]) * down + pose[POINT_V]


@kernel
def unknowns_of(prior, which):
    """Write the unknowns that are estimated with ``prior`` (PRIORS,) to which (UNKNOWNS,); return how many."""
    size = 0
    for i in range(UNKNOWNS):
        if i < GROWTH or prior[i - GROWTH + 1] > 0.0:
            which[size] = i
            size += 1
    return size


@kernel
def _add_prior(normal, right, x, prior, which, size):
    """Add the prior information (PRIORS,), which matters only for what the edges leave open.

    The passive angles are small, and so are the camera's unknowns.
    """
    for i in range(2):
        weight = 1.0 / (prior[0] * prior[0] * x[2] * x[2])
        normal[i, i] += weight
        right[i] -= weight * x[i]
    for i in range(GROWTH, size):
        sigma = prior[which[i] - GROWTH + 1]
        weight = 1.0 / (sigma * sigma)
        normal[i, i] += weight
        right[i] -= weight * x[which[i]]


@kernel
def fit_pose(lens, samples, count, pose, robust, prior, turns, normal):
    """Improve ``pose`` (15,): d, m, phi, rad, and the camera's unknowns, by the shifts of the samples.

    normal: (15, 15), overwritten by the normal matrix of the edges alone.

    Samples with good = 1 are used. robust: px; above 0, samples have equal weight times Tukey's weight of that
    scale; at 0 the inverse of their variance. Return whether the pose is determined (with the prior).
    """
    a = docking_view.attitude(pose[3:6])
    which = np.empty(UNKNOWNS, np.int64)
    size = unknowns_of(prior, which)
    slopes, row, own = np.empty((3, 3, 3)), np.empty(UNKNOWNS), np.empty(size)
    right, step, part, full = np.empty(size), np.empty(size), np.empty((size, size)), np.empty((size, size))
    for _ in range(turns):
        a = docking_view.attitude(pose[3:6])
        attitude_derivatives(pose[3:6], slopes)
        for i in range(size):
            right[i] = 0.0
            for j in range(size):
                part[i, j] = 0.0
        for c in range(count):
            sample = samples[c]
            if sample.good != 1:
                continue
            u, v = point_row(lens, a, slopes, pose[:3], sample.y1, sample.y2, sample.y3, sample.nu, sample.nv, row)
            camera_row(lens, sample, u, v, row)
            residual = sample.shift - (sample.nu * (u - sample.u) + sample.nv * (v - sample.v))
            for i in range(GROWTH, UNKNOWNS):
                residual -= row[i] * pose[i]
            if not math.isfinite(residual):
                return False
            weight = 1.0 / max(sample.variance, 1e-12)
            if robust > 0.0:
                inside = 1.0 - (residual / robust) ** 2
                weight = inside * inside if inside > 0.0 else 0.0
            for i in range(size):
                own[i] = row[which[i]]
                right[i] += weight * own[i] * residual
                for j in range(i + 1):
                    part[i, j] += weight * own[i] * own[j]
        for i in range(size):
            for j in range(i):
                part[j, i] = part[i, j]
        for i in range(size):
            for j in range(size):
                full[i, j] = part[i, j]
        _add_prior(full, right, pose, prior, which, size)
        if not cholesky.solve_system(full, right, step):
            return False
        for i in range(size):
            pose[which[i]] += step[i]
        if not (pose[2] > 0.01 and abs(step[3]) < 1.0 and abs(step[4]) < 1.0 and abs(step[5]) < 1.0):
            return False
    for i in range(UNKNOWNS):
        for j in range(UNKNOWNS):
            normal[i, j] = 0.0
    for i in range(size):
        for j in range(size):
            normal[which[i], which[j]] = part[i, j]
    return True


@kernel
def residuals(lens, samples, count, pose, out):
    """Write each sample's shift minus the edge's shift under ``pose``, px (nan for samples that are not good)."""
    a = docking_view.attitude(pose[3:6])
    p, row = np.empty(3), np.empty(UNKNOWNS)
    for c in range(count):
        sample = samples[c]
        out[c] = np.nan
        if sample.good == 1:
            p[0], p[1], p[2] = sample.y1, sample.y2, sample.y3
            x = docking_view.to_camera(a, pose[:3], p)
            u, v = docking_view.project_point(lens[0], lens[1], lens[2], x)
            out[c] = sample.shift - (sample.nu * (u - sample.u) + sample.nv * (v - sample.v))
            camera_row(lens, sample, u, v, row)
            for i in range(GROWTH, UNKNOWNS):
                out[c] -= row[i] * pose[i]
