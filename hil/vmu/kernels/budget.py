"""Error budget of a pose: generalised least squares on all spots of both cameras, with errors that spots share.

The residuals of a fit (pixel minus projection, two per spot) have the covariance

    S = N + f^2 I + B P B.T

N: noise of the spots. P: covariance of the considered parameters, which are not estimated (lens of each camera,
rotation and position of the right one, positions of the LEDs), B the residuals' derivatives with respect to them. An
error of a camera thus moves all of its spots alike. f: floor for all that no tolerance covers, the same for all spots
and estimated from the residuals by restricted maximum likelihood, at least that of the scene.

    x = C J.T S^-1 residual,  C = (J.T S^-1 J)^-1

C is the covariance of the pose, and K N K.T with K = C J.T S^-1 the part of it that is independent between images. The
logarithm of the likelihood of all spots, integrated over the pose, is the score of a hypothesis.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.jit import kernel
from hil.core.messages import Array
from hil.maths import cholesky
from hil.maths.arrays import copy_into, copy_matrix
from hil.maths.record_view import copy_record
from hil.vmu.kernels.lens import in_image, lens_slopes, project
from hil.vmu.kernels.match import assign, chi_square_limit, count, keep_assigned
from hil.vmu.kernels.records import MAX_LEDS, SHARED
from hil.vmu.kernels.refine import jacobian, place_when_seen, rotate

_STEPS = 20
_SMALL = 1e-6  # square of a step in sigmas, at convergence
_FITS = 4  # twice with the least floor, twice with an estimated one
_NEAR = 0.01  # change of range up to which the shared part of the weights stays
_ROUNDS = 5
_MOST_REMOVED = 3  # spots
_UNSEEN_COST = 3.0  # ln of the odds that an LED in view is lit and detected
_EDGE_PX = 4.0  # an LED nearer to the image's edge may not be detected
_LOG_2PI = math.log(2.0 * math.pi)
_SHIFT_PX = 3.0
_HOPELESS = 20.0  # of the score
_BEHIND = 100.0  # of the score: more than outliers that are removed cost, as the floor then is larger
_UNDETERMINED = 1e4  # m^2 or rad^2
_USUAL_SIGMA = 1.0  # chi-square up to this above its mean needs no other floor
_FIRST_RIGHT, _FIRST_STEREO = 9, 18


class Equations(NamedTuple):
    """Equations of a pose by the m spots of a hypothesis.

    which: (m, 2), camera and LED of each spot. residual: (2 m,), px. jacobian: (2 m, 6), of the projections by the
    pose. shared: (2 m, 2 m), ``B P B.T``. low: (2 m, 2 m), lower Cholesky factor L of S. white_residual and
    white_jacobian: ``L^-1`` times both. normal: (6, 6), ``J.T S^-1 J``. gradient: (6,), ``J.T S^-1 residual``.
    low6: (6, 6), lower Cholesky factor of ``normal``.
    """

    which: npt.NDArray[np.int64]
    residual: Array
    jacobian: Array
    shared: Array
    low: Array
    white_residual: Array
    white_jacobian: Array
    normal: Array
    gradient: Array
    low6: Array


@kernel
def equations(which):
    """Return the equations for ``which`` (m, 2), not yet set up."""
    n = 2 * which.shape[0]
    return Equations(
        which, np.empty(n), np.empty((n, 6)), np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty((n, 6)),
        np.empty((6, 6)), np.empty(6), np.empty((6, 6)),
    )  # fmt: skip


@kernel
def equations_of(fit, n_leds):
    """Return the equations for the spots of ``fit``, not yet set up."""
    which = np.empty((2 * n_leds, 2), np.int64)
    m = 0
    for c in range(2):
        for n in range(n_leds):
            if fit.spot[c, n] >= 0:
                which[m, 0], which[m, 1] = c, n
                m += 1
    return equations(which[:m])


@kernel
def linearise(scene, view, spot, r, t, eq):
    """Write residuals and Jacobian at a pose; return False if an LED in use is not in front of a camera."""
    arm, point, slopes = np.empty(3), np.empty(3), np.empty((2, 3))
    for k in range(eq.which.shape[0]):
        c, n = eq.which[k, 0], eq.which[k, 1]
        place_when_seen(scene, c, scene.leds[n], r, t, arm, point)
        u, v = project(scene.lens[c], point[0], point[1], point[2])
        if not (math.isfinite(u) and math.isfinite(v)):
            return False
        measured = view.spots[c, spot[c, n]]
        eq.residual[2 * k], eq.residual[2 * k + 1] = measured.u - u, measured.v - v
        jacobian(scene.lens[c], scene.rotation[c], arm, point, slopes, eq.jacobian[2 * k : 2 * k + 2])
    return True


@kernel
def columns_of(c, n, columns):
    """Write the considered parameters on which LED n in camera c depends to columns; return how many."""
    k = 0
    for a in range(_FIRST_RIGHT * c, _FIRST_RIGHT * (c + 1)):
        columns[k] = a
        k += 1
    if c == 1:
        for a in range(_FIRST_STEREO, SHARED):
            columns[k] = a
            k += 1
    for a in range(3):
        columns[k] = SHARED + 3 * n + a
        k += 1
    return k


@kernel
def shared_slopes(scene, r, t, c, n, out):
    """Write the derivatives of LED n's pixel in camera c by the parameters of ``columns_of`` to out (2, 18).

    The right camera's rotation is by a small rotation about its own axes.
    """
    arm, point = np.empty(3), np.empty(3)
    slopes, j, inner = np.empty((2, 3)), np.empty((2, 6)), np.empty((2, 9))
    place_when_seen(scene, c, scene.leds[n], r, t, arm, point)
    lens_slopes(scene.lens[c], point[0] / point[2], point[1] / point[2], inner)
    jacobian(scene.lens[c], scene.rotation[c], arm, point, slopes, j)
    for i in range(2):
        for a in range(9):
            out[i, a] = inner[i, a]
        k = 9
        if c == 1:  # p_right = exp([-e]x) R.T (p_v - baseline)
            out[i, k] = slopes[i, 1] * point[2] - slopes[i, 2] * point[1]
            out[i, k + 1] = slopes[i, 2] * point[0] - slopes[i, 0] * point[2]
            out[i, k + 2] = slopes[i, 0] * point[1] - slopes[i, 1] * point[0]
            for a in range(3):
                out[i, k + 3 + a] = -j[i, a]
            k += 6
        for a in range(3):
            out[i, k + a] = j[i, 0] * r[0, a] + j[i, 1] * r[1, a] + j[i, 2] * r[2, a]


@kernel
def motion_slopes(scene, r, t, c, n, out):
    """Write the derivatives of LED n's pixel in camera c by the target's rates, through its row, to out (2, 6)."""
    arm, point, slopes = np.empty(3), np.empty(3), np.empty((2, 3))
    later = place_when_seen(scene, c, scene.leds[n], r, t, arm, point)
    jacobian(scene.lens[c], scene.rotation[c], arm, point, slopes, out)
    for i in range(2):
        for a in range(6):
            out[i, a] *= later


@kernel
def add_motion(scene, r, t, eq):
    """Add to ``shared`` that the rates are uncertain with which the LEDs move between the rows of a rolling shutter."""
    m = eq.which.shape[0]
    moved, row = np.empty((2 * m, 6)), np.empty(6)
    for k in range(m):
        motion_slopes(scene, r, t, eq.which[k, 0], eq.which[k, 1], moved[2 * k : 2 * k + 2])
    for k in range(2 * m):
        for b in range(6):
            row[b] = 0.0
            for a in range(6):
                row[b] += moved[k, a] * scene.motion[1 + a, b]
        for q in range(k + 1):
            total = 0.0
            for a in range(6):
                total += row[a] * moved[q, a]
            eq.shared[k, q] += total
            if q < k:
                eq.shared[q, k] += total


@kernel
def fill_shared(scene, r, t, eq):
    """Write ``B P B.T`` of the spots at a pose."""
    m, p = eq.which.shape[0], scene.tolerance.shape[0]
    slopes, widths = np.empty((m, 2, 18)), np.empty(m, np.int64)
    columns = np.empty((m, 18), np.int64)
    row = np.empty(p)
    for k in range(m):
        widths[k] = columns_of(eq.which[k, 0], eq.which[k, 1], columns[k])
        shared_slopes(scene, r, t, eq.which[k, 0], eq.which[k, 1], slopes[k])
    for k in range(m):
        for i in range(2):
            for b in range(p):
                row[b] = 0.0
            for a in range(widths[k]):
                slope, at = slopes[k, i, a], columns[k, a]
                if slope != 0.0:
                    for b in range(p):
                        row[b] += slope * scene.tolerance[at, b]
            for q in range(k + 1):
                for j in range(2):
                    total = 0.0
                    for a in range(widths[q]):
                        total += row[columns[q, a]] * slopes[q, j, a]
                    eq.shared[2 * k + i, 2 * q + j] = total
                    eq.shared[2 * q + j, 2 * k + i] = total
    if scene.lens[0].row_s != 0.0 or scene.lens[1].row_s != 0.0:
        add_motion(scene, r, t, eq)


@kernel
def fill_weights(view, spot, shared, floor, eq):
    """Write the Cholesky factor of S; return the logarithm of its determinant, NaN if there is none.

    shared: (2 m, 2 m), in place of the covariance in ``eq``.
    """
    low, n = eq.low, eq.residual.shape[0]
    for k in range(n):
        for q in range(k + 1):
            low[k, q] = shared[k, q]
    for k in range(n // 2):
        measured = view.spots[eq.which[k, 0], spot[eq.which[k, 0], eq.which[k, 1]]]
        low[2 * k, 2 * k] += measured.noise_uu + floor * floor
        low[2 * k + 1, 2 * k] += measured.noise_uv
        low[2 * k + 1, 2 * k + 1] += measured.noise_vv + floor * floor
    if not cholesky.factor(low, n, low):
        return np.nan
    total = 0.0
    for k in range(n):
        total += 2.0 * math.log(low[k, k])
    return total


@kernel
def weighted_square(eq):
    """Return ``residual.T S^-1 residual``."""
    n, total = eq.residual.shape[0], 0.0
    cholesky.forward(eq.low, n, eq.residual, eq.white_residual)
    for k in range(n):
        total += eq.white_residual[k] * eq.white_residual[k]
    return total


@kernel
def normal_equations(eq):
    """Write the residuals and the Jacobian times ``L^-1``, and the normal equations; return as ``weighted_square``."""
    n, total = eq.residual.shape[0], weighted_square(eq)
    for a in range(6):
        cholesky.forward(eq.low, n, eq.jacobian[:, a], eq.white_jacobian[:, a])
        eq.gradient[a] = 0.0
        for b in range(6):
            eq.normal[a, b] = 0.0
    for k in range(n):
        for a in range(6):
            eq.gradient[a] += eq.white_jacobian[k, a] * eq.white_residual[k]
            for b in range(a + 1):
                eq.normal[a, b] += eq.white_jacobian[k, a] * eq.white_jacobian[k, b]
    for a in range(6):
        for b in range(a):
            eq.normal[b, a] = eq.normal[a, b]
    return total


@kernel
def minimise(scene, view, fit, eq):
    """Minimise the weighted sum of squares over the pose of ``fit`` for fixed weights; return it, inf on failure.

    Gauss-Newton with Levenberg's damping. The equations are those at the minimum.
    """
    low, step = np.empty((6, 6)), np.empty(6)
    r_new, t_new = np.empty((3, 3)), np.empty(3)
    cost = normal_equations(eq)
    damping = 1e-6
    for _ in range(_STEPS):
        if not math.isfinite(cost) or not cholesky.solve_damped(eq.normal, damping, eq.gradient, low, step):
            return np.inf
        size = 0.0
        for a in range(6):
            size += step[a] * eq.gradient[a]
        if abs(size) < _SMALL or damping > 1e8:
            break
        for a in range(3):
            t_new[a] = fit.t[a] + step[a]
        rotate(fit.r, step[3:6], r_new)
        new_cost = weighted_square(eq) if linearise(scene, view, fit.spot, r_new, t_new, eq) else np.inf
        if new_cost <= cost + 1e-12:
            copy_into(fit.t, t_new)
            copy_matrix(fit.r, r_new)
            damping *= 0.1
        else:
            linearise(scene, view, fit.spot, fit.r, fit.t, eq)
            damping = max(10.0 * damping, 1e-4)
        cost = normal_equations(eq)
    return cost


@kernel
def log_likelihood(log_det, cost, eq):
    """Return the logarithm of the restricted likelihood of all residuals, up to a constant of their number.

    The pose is integrated out: it is at the minimum of the quadratic with ``normal`` and ``gradient``.
    """
    if not cholesky.factor(eq.normal, 6, eq.low6):
        return -np.inf
    step, pose_det, gain = np.empty(6), 0.0, 0.0
    cholesky.solve(eq.low6, 6, eq.gradient, step)
    for a in range(6):
        pose_det += 2.0 * math.log(eq.low6[a, a])
        gain += step[a] * eq.gradient[a]
    return -0.5 * (log_det + pose_det + cost - gain)


@kernel
def estimate_floor(scene, view, fit, eq):
    """Return the most likely floor, px, at the pose of ``fit``, whatever the shift of the right image as a whole.

    Else a floor would hide two images that do not belong together.
    """
    best, floor = -np.inf, scene.floors[0]
    free = eq.shared.copy()
    for k in range(free.shape[0]):
        for q in range(k % 2, free.shape[0], 2):
            if eq.which[k // 2, 0] == 1 and eq.which[q // 2, 0] == 1:
                free[k, q] += _SHIFT_PX * _SHIFT_PX
    for k in range(scene.floors.shape[0]):
        log_det = fill_weights(view, fit.spot, free, scene.floors[k], eq)
        if not math.isfinite(log_det):
            continue
        cost = normal_equations(eq)
        value = log_likelihood(log_det, cost, eq) - (1.0 if k > 0 else 0.0)
        if value > best:
            best, floor = value, scene.floors[k]
    return floor


@kernel
def distance_of(t):
    """Return the length of ``t`` (3,)."""
    return math.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])


@kernel
def weigh(scene, view, density, clean, fit):
    """Fit the pose of ``fit`` to its spots within the error budget: pose, covariances, chi-square, floor and score.

    density: (2,), px^-2, of stray lights in each image. clean: spots of another hypothesis that passes its test: one
    that explains no more and needs a much larger scale of its errors is not valid.
    """
    fit.valid = 0
    count(fit, scene.leds.shape[0])
    eq = equations_of(fit, scene.leds.shape[0])
    m = eq.which.shape[0]
    if m < 3 or not linearise(scene, view, fit.spot, fit.r, fit.t, eq):
        return
    fit.floor = scene.floors[0]
    degrees = 2.0 * m - 6.0
    away = 0.0
    for turn in range(_FITS):
        fill_shared(scene, fit.r, fit.t, eq)
        if turn > 1:
            fit.floor = estimate_floor(scene, view, fit, eq)
        log_det = fill_weights(view, fit.spot, eq.shared, fit.floor, eq)
        if not math.isfinite(log_det):
            return
        distance = distance_of(fit.t)
        cost = minimise(scene, view, fit, eq)
        if not math.isfinite(cost):
            return
        away = abs(distance_of(fit.t) / distance - 1.0)
        if scene.lens[0].row_s != 0.0 or scene.lens[1].row_s != 0.0:
            away = _NEAR  # a large part of the residuals is shared, by the tilt too
        if turn < 2:
            fit.misfit = cost
            usual = degrees <= 0.0 or cost <= degrees + _USUAL_SIGMA * math.sqrt(2.0 * degrees)
            if usual and (turn == 1 or away < _NEAR):
                break
            if turn == 1 and m <= clean and 0.5 * degrees * math.log(cost / degrees) > _HOPELESS:
                return
    likelihood = log_likelihood(log_det, cost, eq)
    if not math.isfinite(likelihood):
        return
    cholesky.invert(eq.low6, fit.covariance)
    fit.chi2 = cost
    write_noise(scene, view, fit, eq)
    write_shift(view, fit, eq)
    fit.score = likelihood - (m - 3.0) * _LOG_2PI
    add_lights(scene, view, density, fit)
    for a in range(6):
        if not 0.0 < fit.covariance[a, a] < _UNDETERMINED:
            return
    fit.valid = 1


@kernel
def write_noise(scene, view, fit, eq):
    """Write the part of the pose's covariance that noise and vibration cause, ``K N K.T``."""
    m, which = eq.which.shape[0], eq.which
    gain, part = np.empty((2 * m, 6)), np.zeros((6, 6))
    for a in range(6):  # S^-1 J = L^-T (L^-1 J)
        cholesky.backward(eq.low, 2 * m, eq.white_jacobian[:, a], gain[:, a])
    for k in range(m):
        measured = view.spots[which[k, 0], fit.spot[which[k, 0], which[k, 1]]]
        for a in range(6):
            x = measured.noise_uu * gain[2 * k, a] + measured.noise_uv * gain[2 * k + 1, a]
            y = measured.noise_uv * gain[2 * k, a] + measured.noise_vv * gain[2 * k + 1, a]
            for b in range(6):
                part[a, b] += x * gain[2 * k, b] + y * gain[2 * k + 1, b]
    if scene.vibration > 0.0:
        add_vibration(scene, fit, eq, gain, part)
    for a in range(6):
        for b in range(6):
            total = 0.0
            for i in range(6):
                for j in range(6):
                    total += fit.covariance[a, i] * part[i, j] * fit.covariance[j, b]
            fit.noise[a, b] = total


@kernel
def add_vibration(scene, fit, eq, gain, part):
    """Add to ``part`` (6, 6) what the vibration of the right camera causes. gain: (2 m, 6), ``S^-1 J``."""
    slopes, pull = np.empty((2, 18)), np.zeros((2, 6))
    for k in range(eq.which.shape[0]):
        if eq.which[k, 0] == 1:
            shared_slopes(scene, fit.r, fit.t, 1, eq.which[k, 1], slopes)
            for e in range(2):
                for a in range(6):
                    pull[e, a] += slopes[0, 9 + e] * gain[2 * k, a] + slopes[1, 9 + e] * gain[2 * k + 1, a]
    for e in range(2):
        for a in range(6):
            for b in range(6):
                part[a, b] += scene.vibration * pull[e, a] * pull[e, b]


@kernel
def write_shift(view, fit, eq):
    """Write the shift of the right image against the left one, along u and v, over its standard deviation.

    The mean residual of the right image minus that of the left one: large if the images are not of one moment, or the
    cameras are not those of the calibration. Zero with fewer than two spots in one image.
    """
    m, which = eq.which.shape[0], eq.which
    side = np.empty(m)
    totals = np.zeros(2)
    for k in range(m):
        totals[which[k, 0]] += 1.0
    fit.shift[0] = fit.shift[1] = fit.shift_px = fit.shift_noise = 0.0
    if min(totals[0], totals[1]) < 2.0:
        return
    for k in range(m):
        side[k] = 1.0 / totals[1] if which[k, 0] == 1 else -1.0 / totals[0]
    along = np.empty(6)
    for i in range(2):
        mean, variance, noise = 0.0, 0.0, 0.0
        for a in range(6):
            along[a] = 0.0
        for k in range(m):
            measured = view.spots[which[k, 0], fit.spot[which[k, 0], which[k, 1]]]
            own = (measured.noise_uu if i == 0 else measured.noise_vv) + fit.floor * fit.floor
            noise += side[k] * side[k] * own
            mean += side[k] * eq.residual[2 * k + i]
            for q in range(m):
                variance += side[k] * side[q] * eq.shared[2 * k + i, 2 * q + i]
            for a in range(6):
                along[a] += side[k] * eq.jacobian[2 * k + i, a]
        variance += noise
        total = variance
        for a in range(6):
            for b in range(6):
                variance -= along[a] * fit.covariance[a, b] * along[b]
        if variance > 1e-6 * total:
            fit.shift[i] = mean / math.sqrt(variance)
    fit.shift_px, fit.shift_noise = mean, noise


@kernel
def add_lights(scene, view, density, fit):
    """Add to the score of ``fit`` that each spot is no stray light, and a cost per LED in view without a spot."""
    arm, point = np.empty(3), np.empty(3)
    fit.unseen = 0
    for c in range(2):
        if view.counts[c] == 0:
            continue
        for n in range(scene.leds.shape[0]):
            if fit.spot[c, n] >= 0:
                fit.score -= math.log(density[c])
                continue
            place_when_seen(scene, c, scene.leds[n], fit.r, fit.t, arm, point)
            u, v = project(scene.lens[c], point[0], point[1], point[2])
            if in_image(scene.lens[c], u, v, _EDGE_PX):
                fit.unseen += 1
                fit.score -= _UNSEEN_COST


@kernel
def worst_spot(scene, view, fit, where):
    """Write camera and LED of the spot whose removal lowers chi-square most to where (2,); return by how much."""
    eq = equations_of(fit, scene.leds.shape[0])
    m = eq.which.shape[0]
    if m < 3 or not linearise(scene, view, fit.spot, fit.r, fit.t, eq):
        return 0.0
    fill_shared(scene, fit.r, fit.t, eq)
    if not math.isfinite(fill_weights(view, fit.spot, eq.shared, scene.floors[0], eq)):
        return 0.0
    # rows of L^-1, then S^-1 - S^-1 J C J.T S^-1 by pairs of residuals
    inverse, covariance = np.zeros((2 * m, 2 * m)), np.empty((6, 6))
    cholesky.invert_factor(eq.low, inverse)
    normal_equations(eq)
    if not cholesky.factor(eq.normal, 6, eq.low6):
        return 0.0
    cholesky.invert(eq.low6, covariance)
    most = 0.0
    gain, pull, block = np.empty((2, 6)), np.empty(2), np.empty((2, 2))
    for k in range(m):
        for i in range(2):
            pull[i] = 0.0
            for q in range(2 * m):
                pull[i] += inverse[q, 2 * k + i] * eq.white_residual[q]
            for a in range(6):
                gain[i, a] = 0.0
                for q in range(2 * m):
                    gain[i, a] += inverse[q, 2 * k + i] * eq.white_jacobian[q, a]
        for i in range(2):
            for j in range(2):
                block[i, j] = 0.0
                for q in range(2 * m):
                    block[i, j] += inverse[q, 2 * k + i] * inverse[q, 2 * k + j]
                for a in range(6):
                    for b in range(6):
                        block[i, j] -= gain[i, a] * covariance[a, b] * gain[j, b]
        for a in range(6):
            for b in range(6):
                for i in range(2):
                    pull[i] -= gain[i, a] * covariance[a, b] * eq.gradient[b]
        det = block[0, 0] * block[1, 1] - block[0, 1] * block[0, 1]
        if not det > 1e-9 * block[0, 0] * block[1, 1]:
            continue
        square = (
            block[1, 1] * pull[0] * pull[0] - 2.0 * block[0, 1] * pull[0] * pull[1] + block[0, 0] * pull[1] * pull[1]
        ) / det
        if square > most:
            most = square
            where[0], where[1] = eq.which[k, 0], eq.which[k, 1]
    return most


@kernel
def without(scene, view, density, fit, where, trial):
    """Write ``fit`` without the spot of one camera and LED, ``where`` (2,), to trial; camera -1: of both cameras."""
    copy_record(fit, trial)
    for c in range(2):
        if where[0] in (c, -1):
            trial.spot[c, where[1]] = -1
    weigh(scene, view, density, 0, trial)
    trial.removed = fit.removed + fit.points - trial.points


@kernel
def best_without(scene, view, density, fit, trial, best):
    """Write to ``best`` the most likely hypothesis that lacks one spot of ``fit``, or one LED; valid 0 without one.

    A light near a dark LED is visible to both cameras: neither of its spots alone is an outlier.
    """
    where = np.zeros(2, np.int64)
    best.valid = 0
    least = 2 * fit.points - 8
    if least >= 2 + 2 * fit.removed and worst_spot(scene, view, fit, where) > 0.0:
        without(scene, view, density, fit, where, best)
    where[0] = -1
    for n in range(scene.leds.shape[0]):
        if fit.spot[0, n] < 0 or fit.spot[1, n] < 0 or not least - 2 >= 2 + 2 * fit.removed:
            continue
        where[1] = n
        without(scene, view, density, fit, where, trial)
        if trial.valid == 1 and (best.valid == 0 or trial.score > best.score):
            copy_record(trial, best)


@kernel
def passes(fit):
    """Return whether a fit needs no floor and lacks none of the spots in its gates."""
    return fit.misfit <= chi_square_limit(2 * fit.points - 6) and fit.removed == 0


@kernel
def settle(scene, view, density, reach_px, clean, best, fit, rival):
    """Extend ``fit`` to all spots that match within the error budget, and remove outliers if that is more likely.

    Spots are removed only if the score without them, of which they then no longer are a part, exceeds that with them.
    clean: as in ``weigh``. best: the highest score of another hypothesis: one that is far below it is left as it is.
    rival: FIT, the best hypothesis that lacks more of the spots, with its own score; valid 0 if
    the spots agree.
    """
    previous = np.empty((2, MAX_LEDS), np.int64)
    trial = np.empty_like(rival)
    n_leds = scene.leds.shape[0]
    fit.removed = 0
    rival[0].valid = 0
    for _ in range(_ROUNDS):
        weigh(scene, view, density, clean, fit)
        if fit.valid == 0:
            return
        copy_matrix(previous, fit.spot)
        assign(scene, view, fit.r, fit.t, fit.covariance, reach_px, fit.spot)
        if not keep_assigned(previous, n_leds, fit.spot):
            break
        count(fit, n_leds)
        if fit.points < 3:
            fit.valid = 0
            return
    if fit.score < best - _BEHIND:
        return
    while fit.points > clean and fit.removed < _MOST_REMOVED and fit.misfit > chi_square_limit(2 * fit.points - 6):
        best_without(scene, view, density, fit, trial[0], rival[0])
        if rival[0].valid == 0 or not rival[0].score > fit.score:
            return
        copy_record(rival[0], fit)
        rival[0].valid = 0


@kernel
def chi_square_growth(scene, view, fit, direction, sigmas):
    """Return the growth of chi-square at ``sigmas`` sigmas from ``fit`` along ``direction``, over the expected growth.

    direction: (6,), one sigma of the pose along an axis of its covariance. 1 if the problem is linear up to there, so
    that the covariance is valid.
    """
    eq = equations_of(fit, scene.leds.shape[0])
    r, t, e = np.empty((3, 3)), np.empty(3), np.empty(3)
    for i in range(3):
        t[i] = fit.t[i] + sigmas * direction[i]
        e[i] = sigmas * direction[3 + i]
    rotate(fit.r, e, r)
    if eq.which.shape[0] < 3 or not linearise(scene, view, fit.spot, fit.r, fit.t, eq):
        return np.inf
    fill_shared(scene, fit.r, fit.t, eq)
    if not math.isfinite(fill_weights(view, fit.spot, eq.shared, fit.floor, eq)):
        return np.inf
    if not linearise(scene, view, fit.spot, r, t, eq):
        return np.inf
    return (weighted_square(eq) - fit.chi2) / (sigmas * sigmas)
