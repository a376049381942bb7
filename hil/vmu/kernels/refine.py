"""Least-squares pose of all spots of both cameras: Gauss-Newton with Levenberg's damping.

Unknowns: t (m) and a small-angle rotation e about v's axes, ``R <- exp([e]x) R``. A residual is a spot's pixel minus
the LED's projection; its weight is the inverse of the spot's covariance. The inverse of the normal matrix at the
end is the covariance of (t, e), which is also the Cramer-Rao bound of Gaussian spots.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import cholesky, quat
from hil.maths.arrays import copy_into, copy_matrix
from hil.vmu.kernels.lens import project, project_slopes

_STEPS, _FEW_STEPS = 15, 3
_ROW_STEPS = 3
_SMALL = 1e-5  # square of a step in sigmas, at convergence: `budget` fits what remains


@kernel
def rotate(r, e, out):
    """Write ``exp([e]x) r`` (3, 3), orthonormalised."""
    back = np.empty(3)
    back[0], back[1], back[2] = -e[0], -e[1], -e[2]
    q = quat.multiply(quat.from_rotation_vector(back), quat.from_matrix(r))
    quat.normalise(q)
    copy_matrix(out, quat.to_matrix(q))


@kernel
def place(rotation, translation, r, t, led, arm, point):
    """Write ``r led`` to arm and the LED in the camera's axes to point, both (3,), m."""
    for i in range(3):
        arm[i] = r[i, 0] * led[0] + r[i, 1] * led[1] + r[i, 2] * led[2]
    x, y, z = arm[0] + t[0], arm[1] + t[1], arm[2] + t[2]
    for i in range(3):
        point[i] = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z + translation[i]


@kernel
def place_in_row(scene, c, t, arm, point):
    """Move the LED at ``point`` (3,), with ``arm``, to where it is as its row is exposed; return how much later, s."""
    later, moved, w = 0.0, np.empty(3), scene.motion[0]
    for _ in range(_ROW_STEPS):
        _, v = project(scene.lens[c], point[0], point[1], point[2])
        if not math.isfinite(v):
            return later
        later = scene.lens[c].row_s * (v - 0.5 * (scene.lens[c].height - 1.0))
        moved[0] = arm[0] + t[0] + later * (w[0] + w[4] * arm[2] - w[5] * arm[1])
        moved[1] = arm[1] + t[1] + later * (w[1] + w[5] * arm[0] - w[3] * arm[2])
        moved[2] = arm[2] + t[2] + later * (w[2] + w[3] * arm[1] - w[4] * arm[0])
        for i in range(3):
            point[i] = scene.translation[c, i]
            for j in range(3):
                point[i] += scene.rotation[c, i, j] * moved[j]
    return later


@kernel
def place_when_seen(scene, c, led, r, t, arm, point):
    """Write as ``place`` for camera ``c`` with the LED where it is as its row is exposed; return how much later, s.

    Later than the image. With a rolling shutter row and motion depend on each other: three steps leave 1e-5 px.
    """
    place(scene.rotation[c], scene.translation[c], r, t, led, arm, point)
    return 0.0 if scene.lens[c].row_s == 0.0 else place_in_row(scene, c, t, arm, point)


@kernel
def jacobian(lens, rotation, arm, point, slopes, out):
    """Write the derivative of an LED's pixel with respect to (t, e) to out (2, 6). slopes: (2, 3), scratch."""
    project_slopes(lens, point[0], point[1], point[2], slopes)
    for i in range(2):
        for j in range(3):
            out[i, j] = slopes[i, 0] * rotation[0, j] + slopes[i, 1] * rotation[1, j] + slopes[i, 2] * rotation[2, j]
        out[i, 3] = arm[1] * out[i, 2] - arm[2] * out[i, 1]
        out[i, 4] = arm[2] * out[i, 0] - arm[0] * out[i, 2]
        out[i, 5] = arm[0] * out[i, 1] - arm[1] * out[i, 0]


@kernel
def accumulate(scene, view, spot, r, t, normal, gradient):
    """Write the normal matrix (6, 6) and J.T W residual (6,); return chi-square, inf if an LED is not in front."""
    arm, point = np.empty(3), np.empty(3)
    slopes, j = np.empty((2, 3)), np.empty((2, 6))
    for a in range(6):
        gradient[a] = 0.0
        for b in range(6):
            normal[a, b] = 0.0
    total = 0.0
    for c in range(2):
        for n in range(scene.leds.shape[0]):
            k = spot[c, n]
            if k < 0:
                continue
            measured = view.spots[c, k]
            place_when_seen(scene, c, scene.leds[n], r, t, arm, point)
            u, v = project(scene.lens[c], point[0], point[1], point[2])
            du, dv = measured.u - u, measured.v - v
            if not (math.isfinite(du) and math.isfinite(dv)):
                return np.inf
            jacobian(scene.lens[c], scene.rotation[c], arm, point, slopes, j)
            wu = measured.w_uu * du + measured.w_uv * dv
            wv = measured.w_uv * du + measured.w_vv * dv
            total += wu * du + wv * dv
            for a in range(6):
                gradient[a] += j[0, a] * wu + j[1, a] * wv
                ja = measured.w_uu * j[0, a] + measured.w_uv * j[1, a]
                jb = measured.w_uv * j[0, a] + measured.w_vv * j[1, a]
                for b in range(a + 1):
                    normal[a, b] += ja * j[0, b] + jb * j[1, b]
    for a in range(6):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return total


@kernel
def chi_square(scene, view, spot, r, t):
    """Return the weighted sum of squared residuals of a pose; inf if an LED in use is not in front."""
    arm, point = np.empty(3), np.empty(3)
    total = 0.0
    for c in range(2):
        for n in range(scene.leds.shape[0]):
            k = spot[c, n]
            if k < 0:
                continue
            measured = view.spots[c, k]
            place_when_seen(scene, c, scene.leds[n], r, t, arm, point)
            u, v = project(scene.lens[c], point[0], point[1], point[2])
            du, dv = measured.u - u, measured.v - v
            if not (math.isfinite(du) and math.isfinite(dv)):
                return np.inf
            total += measured.w_uu * du * du + 2.0 * measured.w_uv * du * dv + measured.w_vv * dv * dv
    return total


@kernel
def refine(scene, view, hopeless, fit):
    """Minimise chi-square of the spots of ``fit`` (FIT) over the pose; write covariance, chi2 and valid.

    hopeless: chi-square, above which a fit is not valid, and after a few steps not continued.
    """
    normal, low, gradient, step = np.empty((6, 6)), np.zeros((6, 6)), np.empty(6), np.empty(6)
    r_new, t_new = np.empty((3, 3)), np.empty(3)
    fit.valid = 0
    cost = accumulate(scene, view, fit.spot, fit.r, fit.t, normal, gradient)
    damping = 1e-4
    for k in range(_STEPS):
        if not math.isfinite(cost) or (k >= _FEW_STEPS and cost > hopeless):
            return
        if not cholesky.solve_damped(normal, damping, gradient, low, step):
            return
        for a in range(3):
            t_new[a] = fit.t[a] + step[a]
        rotate(fit.r, step[3:6], r_new)
        new_cost = chi_square(scene, view, fit.spot, r_new, t_new)
        size = 0.0
        for a in range(6):
            size += step[a] * gradient[a]
        if new_cost <= cost + 1e-12:
            copy_into(fit.t, t_new)
            copy_matrix(fit.r, r_new)
            cost = accumulate(scene, view, fit.spot, fit.r, fit.t, normal, gradient)
            damping *= 0.1
        else:
            damping = max(10.0 * damping, 1e-4)
        if abs(size) < _SMALL:
            break
        if damping > 1e8:
            break
    if not cholesky.factor(normal, 6, low):
        return
    cholesky.invert(low, fit.covariance)
    fit.chi2 = cost
    if cost > hopeless:
        return
    for a in range(6):
        if not (math.isfinite(fit.covariance[a, a]) and fit.covariance[a, a] > 0.0):
            return
    fit.valid = 1
