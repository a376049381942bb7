"""Joint filter under an error budget: sizes of the sensors' errors beyond drift and white noise.

The error of both filters, position, velocity, bias, rotation and drift (15), is joined with the parameters of the error
models: constants, which are considered, not estimated (Schmidt 1966), and first-order Gauss-Markov processes, which
are estimated (Bryson and Johansen 1965). One covariance (n, n) holds them all; the filters' own are copies of its
blocks. Gains are optimal in the rows that an update corrects and zero in the others, so that the covariance is that of
any gain, ``P - K G.T - G K.T + K S K.T`` with ``G = P H.T``. The factor of the noise against the reported one is
estimated from the innovations, by Fisher scoring of their likelihood over a window. docs/explanation/error-budget.md
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.gnc.akf import add_in_chaser_axes
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill_matrix
from hil.maths.kalman import invert_symmetric_3

FILTER_ERRORS: Final = 15  # r, v, bias of the position filter; rotation, drift of the attitude filter
JOINT_MAX: Final = 46
_R, _V, _BIAS, _TURN, _DRIFT = 0, 3, 6, 9, 12
_LEAST_WHITE = 1e-4  # of a pose's variance
_LONGEST_STEP = 1.0  # of the logarithm of the noise's factor, per pose

ERROR_BUDGET = np.dtype(
    [
        ("n", "i8"),  # joint errors; 0: without a budget
        # index of the first parameter of each group, 0: the budget has none
        ("misalignment", "i8"),  # (3), rad, of the cameras, about c's axes
        ("bias", "i8"),  # (3), m, of a pose, in c
        ("scale", "i8"),  # relative, of the distance
        ("correlated", "i8"),  # (6), Gauss-Markov processes of unit variance, of position and rotation
        ("gyro_scale", "i8"),  # (3)
        ("gyro_misalignment", "i8"),  # (3), rad
        ("gyro_instability", "i8"),  # (3), rad/s
        ("accelerometer_scale", "i8"),  # (3)
        ("accelerometer_misalignment", "i8"),  # (3), rad
        ("accelerometer_instability", "i8"),  # (3), m/s^2
        ("variance", "f8", JOINT_MAX),  # of the parameters
        ("kept", "f8", JOINT_MAX),  # part of each that is left after a step, 1 of a constant
        ("estimated", "i8", JOINT_MAX),
        ("fraction", "f8"),  # of the noise's variance that is correlated
        ("bench_variance", "f8", 2),  # m^2, rad^2: part of a pose's covariance that is the bench's, all correlated
        ("noise_variance", "f8"),  # of the logarithm of true over reported variance, 0: the reported one is true
        ("noise_window", "f8"),  # poses
        ("camera_position", "f8", 3),  # m, in c
        ("ring_position", "f8", 3),  # m, in H
    ],
    align=True,
)

BUDGET_STATE = np.dtype([("x", "f8", JOINT_MAX), ("p", "f8", (JOINT_MAX, JOINT_MAX))], align=True)
"""x: estimated parameters, from FILTER_ERRORS on. p: joint covariance."""

NOISE_FACTOR = np.dtype([("log", "f8", 2), ("information", "f8", 2)], align=True)
"""Logarithm of true over reported variance of position and attitude, and the information on it."""

INNOVATION = np.dtype(
    [
        ("h", "f8", (3, JOINT_MAX)),
        ("cross", "f8", (JOINT_MAX, 3)),  # covariance of the joint error with the innovation
        ("gain", "f8", (JOINT_MAX, 3)),
        ("s", "f8", (3, 3)),
        ("s_inverse", "f8", (3, 3)),
        ("noise", "f8", (3, 3)),  # white part of s
    ],
    align=True,
)


@kernel
def copy_state(budget, source, target):
    """Copy BUDGET_STATE."""
    for i in range(budget.n):
        target.x[i] = source.x[i]
        for j in range(budget.n):
            target.p[i, j] = source.p[i, j]


@kernel
def publish(state, akf, pkf):
    """Write the blocks of the joint covariance into AKF_STATE and PKF_STATE."""
    for i in range(9):
        for j in range(9):
            pkf.p[i, j] = state.p[i, j]
        for j in range(6):
            pkf.c[i, j] = state.p[i, _TURN + j]
    for i in range(6):
        for j in range(6):
            akf.p[i, j] = state.p[_TURN + i, _TURN + j]


@kernel
def expected_log(budget):
    """Return the logarithm of the expected factor of the noise's variance, before any innovation."""
    return 0.5 * budget.noise_variance


@kernel
def start_noise(budget, noise):
    """Write what is known of NOISE_FACTOR at the start."""
    for k in range(2):
        noise.log[k] = expected_log(budget)
        noise.information[k] = 1.0 / budget.noise_variance if budget.noise_variance > 0.0 else 0.0


@kernel
def _white(budget, covariance, k, noise, out):
    """Write the white part (3, 3) of a pose's ``covariance`` (3, 3); k: 0 position, 1 rotation."""
    factor = math.exp(noise.log[k]) * (1.0 - budget.fraction)
    for i in range(3):
        for j in range(3):
            out[i, j] = factor * covariance[i, j]
        reported = max(covariance[i, i] - budget.bench_variance[k], _LEAST_WHITE * covariance[i, i])
        out[i, i] = factor * reported


@kernel
def _add_correlated(budget, covariance, k, noise, h):
    """Write the sensitivity to the correlated noise, the Cholesky factor of its covariance; k: as of ``_white``."""
    if budget.correlated == 0:
        return
    first, factor = budget.correlated + 3 * k, math.exp(noise.log[k]) * budget.fraction
    for i in range(3):
        for j in range(i + 1):
            total = factor * covariance[i, j]
            if i == j:
                total += (1.0 - factor) * min(budget.bench_variance[k], covariance[i, i])
            for m in range(j):
                total -= h[i, first + m] * h[j, first + m]
            if i == j:
                h[i, first + i] = math.sqrt(max(total, 0.0))
            else:
                h[i, first + j] = total / h[j, first + j] if h[j, first + j] > 0.0 else 0.0


@kernel
def attitude_sensitivity(budget, covariance, noise, h):
    """Write the sensitivity (3, n) of a measured rotation, which a misaligned camera rotates, to the parameters."""
    for i in range(3):
        for j in range(budget.n):
            h[i, j] = 0.0
        if budget.misalignment != 0:
            h[i, budget.misalignment + i] = -1.0
    _add_correlated(budget, covariance, 1, noise, h)


@kernel
def position_sensitivity(budget, expected, q_CH, covariance, noise, h):
    """Write the sensitivity (3, n) of a measured ``z_TC_C`` to the parameters.

    ``dz = misalignment x y + bias + scale (y + A ring)`` with ``y = z - camera_position``. expected: ``-z`` (3,).
    """
    y, ring = stack.vector(3), stack.vector(3)
    for i in range(3):
        y[i] = -expected[i] - budget.camera_position[i]
        for j in range(budget.n):
            h[i, j] = 0.0
    if budget.misalignment != 0:
        _cross_of(y, h, budget.misalignment, 1.0)
    if budget.bias != 0:
        for i in range(3):
            h[i, budget.bias + i] = 1.0
    if budget.scale != 0:
        quat.transform_into(q_CH, budget.ring_position, ring)
        for i in range(3):
            h[i, budget.scale] = y[i] + ring[i]
    _add_correlated(budget, covariance, 0, noise, h)


@kernel
def _cross_of(v, h, first, sign):
    """Write the matrix of ``sign p x v`` for p (3,) into the columns of ``h`` from ``first`` on."""
    h[0, first + 1], h[0, first + 2] = sign * v[2], -sign * v[1]
    h[1, first], h[1, first + 2] = -sign * v[2], sign * v[0]
    h[2, first], h[2, first + 1] = sign * v[1], -sign * v[0]


@kernel
def start(budget, pose, noise, akf, pkf, state):
    """Start the joint covariance; both filters have been started from ``pose`` (POSE).

    The start has the pose's errors: ``theta = -H_a e - n_a``, ``r = A.T (theta x z' + H_z e + n_z)``, ``z' = -z``.
    """
    n = budget.n
    start_noise(budget, noise)
    for i in range(n):
        state.x[i] = 0.0
        for j in range(n):
            state.p[i, j] = 0.0
    for i in range(3):
        state.p[_V + i, _V + i], state.p[_BIAS + i, _BIAS + i] = pkf.p[3 + i, 3 + i], pkf.p[6 + i, 6 + i]
        for j in range(3):
            state.p[_DRIFT + i, _DRIFT + j] = akf.p[3 + i, 3 + j]
    # columns: white noise of rotation and position (6), then as the joint errors
    response = stack.matrix(15, 46)
    h, a, expected = stack.matrix(3, 46), stack.matrix(3, 3), stack.vector(3)
    white_z, white_a = stack.matrix(3, 3), stack.matrix(3, 3)
    fill_matrix(response, 0.0)
    fill_matrix(h, 0.0)
    quat.to_matrix_into(pose.q_CH, a)
    _white(budget, pose.covariance_attitude, 1, noise, white_a)
    _white(budget, pose.covariance_position, 0, noise, white_z)
    attitude_sensitivity(budget, pose.covariance_attitude, noise, h)
    for i in range(3):
        expected[i] = -pose.z_TC_C[i]
        h[i, i] = 1.0
        for j in range(n):
            response[_TURN + i, j] = -h[i, j]
    position_sensitivity(budget, expected, pose.q_CH, pose.covariance_position, noise, h)
    for i in range(3):
        h[i, 3 + i] = 1.0
    for j in range(n):
        t0, t1, t2 = response[_TURN, j], response[_TURN + 1, j], response[_TURN + 2, j]
        in_c0 = h[0, j] + t1 * expected[2] - t2 * expected[1]
        in_c1 = h[1, j] + t2 * expected[0] - t0 * expected[2]
        in_c2 = h[2, j] + t0 * expected[1] - t1 * expected[0]
        for i in range(3):
            response[i, j] = a[0, i] * in_c0 + a[1, i] * in_c1 + a[2, i] * in_c2
    for i in range(15):
        for j in range(15):
            for m in range(3):
                for k in range(3):
                    state.p[i, j] += response[i, m] * white_a[m, k] * response[j, k]
                    state.p[i, j] += response[i, 3 + m] * white_z[m, k] * response[j, 3 + k]
    for i in range(3):
        if budget.accelerometer_instability != 0:
            response[_BIAS + i, budget.accelerometer_instability + i] = 1.0
        if budget.gyro_instability != 0:
            response[_DRIFT + i, budget.gyro_instability + i] = 1.0
    for m in range(FILTER_ERRORS, n):
        variance = budget.variance[m]
        state.p[m, m] = variance
        for i in range(15):
            state.p[i, m] = state.p[m, i] = response[i, m] * variance
            for j in range(15):
                state.p[i, j] += response[i, m] * variance * response[j, m]
    publish(state, akf, pkf)


@kernel
def _transition(budget, params, a, force, rate, attitude_phi, f):
    """Write the upper rows (15, n) of the joint transition; those of the parameters are diagonal.

    params: PKF_PARAMS. a: A(q_CH) (3, 3) in mid-step. force, rate: (3,), in c, without bias and drift.
    """
    for i in range(15):
        for j in range(budget.n):
            f[i, j] = 0.0
        f[i, i] = 1.0
    push, turned = stack.matrix(6, 3), stack.matrix(6, 3)  # response to a force in c, and to a rotation of it
    for i in range(6):
        for j in range(6):
            f[i, j] = params.hill_transition[i, j]
        for j in range(3):
            total = 0.0
            for m in range(3):
                total += params.hill_response[i, m] * a[j, m]
            push[i, j] = total
        turned[i, 0] = -push[i, 1] * force[2] + push[i, 2] * force[1]
        turned[i, 1] = push[i, 0] * force[2] - push[i, 2] * force[0]
        turned[i, 2] = -push[i, 0] * force[1] + push[i, 1] * force[0]
        for j in range(3):
            f[i, _BIAS + j] = -push[i, j]
            f[i, _TURN + j] = turned[i, j]
            if budget.accelerometer_scale != 0:
                f[i, budget.accelerometer_scale + j] = -push[i, j] * force[j]
            if budget.accelerometer_misalignment != 0:
                f[i, budget.accelerometer_misalignment + j] = turned[i, j]
    for i in range(3):
        row = _TURN + i
        for j in range(6):
            f[row, _TURN + j] = attitude_phi[i, j]
        d0, d1, d2 = attitude_phi[i, 3], attitude_phi[i, 4], attitude_phi[i, 5]  # response to a rate
        if budget.gyro_scale != 0:
            f[row, budget.gyro_scale] = d0 * rate[0]
            f[row, budget.gyro_scale + 1] = d1 * rate[1]
            f[row, budget.gyro_scale + 2] = d2 * rate[2]
        if budget.gyro_misalignment != 0:
            f[row, budget.gyro_misalignment] = d1 * rate[2] - d2 * rate[1]
            f[row, budget.gyro_misalignment + 1] = d2 * rate[0] - d0 * rate[2]
            f[row, budget.gyro_misalignment + 2] = d0 * rate[1] - d1 * rate[0]
        if budget.accelerometer_instability != 0:
            k = budget.accelerometer_instability + i
            f[_BIAS + i, k] = budget.kept[k] - 1.0
        if budget.gyro_instability != 0:
            k = budget.gyro_instability + i
            f[_DRIFT + i, k] = budget.kept[k] - 1.0


@kernel
def predict(budget, of_akf, of_pkf, a, force, rate, akf, pkf, state):
    """Carry parameters and joint covariance over the step that has carried the states of both filters.

    of_akf, of_pkf: AKF_PARAMS, PKF_PARAMS. The others as of ``_transition``.
    """
    n = budget.n
    f, half, transposed = stack.matrix(15, 46), stack.matrix(15, 46), stack.matrix(46, 15)
    _transition(budget, of_pkf, a, force, rate, akf.phi, f)
    p = state.p
    for i in range(15):
        for j in range(n):
            half[i, j] = 0.0
        for m in range(n):
            factor = f[i, m]
            if factor != 0.0:
                for j in range(n):
                    half[i, j] += factor * p[m, j]
        for j in range(n):
            transposed[j, i] = half[i, j]
    for j in range(15):
        for i in range(15):
            p[j, i] = 0.0
        for m in range(n):
            factor = f[j, m]
            if factor != 0.0:
                for i in range(15):
                    p[j, i] += factor * transposed[m, i]
    for j in range(15):
        for i in range(j):
            p[j, i] = p[i, j]
    for m in range(FILTER_ERRORS, n):
        kept = budget.kept[m]
        for i in range(15):
            p[i, m] = p[m, i] = half[i, m] * kept
        for k in range(FILTER_ERRORS, n):
            p[m, k] *= kept * budget.kept[k]
        p[m, m] += budget.variance[m] * (1.0 - kept * kept)
    _add_noise(budget, of_akf, of_pkf, akf.x, p)
    for i in range(3):
        k = budget.accelerometer_instability + i
        if budget.accelerometer_instability != 0:
            pkf.x[6 + i] += (budget.kept[k] - 1.0) * state.x[k]
        k = budget.gyro_instability + i
        if budget.gyro_instability != 0:
            akf.x[4 + i] += (budget.kept[k] - 1.0) * state.x[k]
    for m in range(FILTER_ERRORS, n):
        state.x[m] *= budget.kept[m]
    publish(state, akf, pkf)


@kernel
def _add_noise(budget, of_akf, of_pkf, attitude, p):
    """Add the noise of a step: white noise of both sensors, random walks, and the fresh part of the instabilities."""
    add_in_chaser_axes(of_akf.rate_noise, of_akf.dt_s, attitude, p[_DRIFT : _DRIFT + 3, _DRIFT : _DRIFT + 3])
    g = of_pkf.hill_response
    accelerometer = of_pkf.sigma_accelerometer**2
    for i in range(6):
        for j in range(6):
            p[i, j] += accelerometer * (g[i, 0] * g[j, 0] + g[i, 1] * g[j, 1] + g[i, 2] * g[j, 2])
    for i in range(3):
        p[_BIAS + i, _BIAS + i] += (of_pkf.dt_s * of_pkf.sigma_bias) ** 2
        p[_TURN + i, _TURN + i] += (of_akf.dt_s * of_akf.sigma_gyro) ** 2
        p[_DRIFT + i, _DRIFT + i] += (of_akf.dt_s * of_akf.sigma_drift) ** 2
        if budget.accelerometer_instability != 0:
            _add_fresh(budget, _BIAS + i, budget.accelerometer_instability + i, p)
        if budget.gyro_instability != 0:
            _add_fresh(budget, _DRIFT + i, budget.gyro_instability + i, p)


@kernel
def _add_fresh(budget, i, k, p):
    """Add the fresh part of instability ``k`` to the bias or drift ``i``, of which it is a part."""
    fresh = budget.variance[k] * (1.0 - budget.kept[k] ** 2)
    p[i, i] += fresh
    p[i, k] += fresh
    p[k, i] += fresh


@kernel
def innovate_attitude(budget, state, noise, akf, q_measured, covariance, found, gain, out):
    """As ``akf.innovate``, with the parameters; ``found`` (INNOVATION) is kept for the update."""
    rotation = stack.vector(3)
    quat.rotation_between(q_measured, akf.x[0:4], rotation)
    attitude_sensitivity(budget, covariance, noise, found.h)
    for i in range(3):
        found.h[i, _TURN + i] = 1.0
        out[i] = rotation[i]
    _white(budget, covariance, 1, noise, found.noise)
    return _innovate(budget, state, _TURN, 6, found, gain, out)


@kernel
def innovate_position(budget, state, noise, akf, pkf, z_TC_C, covariance, delta_s, found, gain, out):
    """As ``pkf.innovate``, with the parameters; ``found`` (INNOVATION) is kept for the update."""
    a, expected, q_CH = stack.matrix(3, 3), stack.vector(3), stack.vector(4)
    copy_into(q_CH, akf.x[0:4])
    quat.to_matrix_into(q_CH, a)
    for i in range(3):
        expected[i] = pkf.x[i] + delta_s * pkf.x[3 + i]
    quat.transform_into(q_CH, expected, expected)
    position_sensitivity(budget, expected, q_CH, covariance, noise, found.h)
    _cross_of(expected, found.h, _TURN, 1.0)
    for i in range(3):
        out[i] = z_TC_C[i] + expected[i]
        for j in range(3):
            found.h[i, j] = -a[i, j]
            found.h[i, _V + j] = -delta_s * a[i, j]
    _white(budget, covariance, 0, noise, found.noise)
    return _innovate(budget, state, _R, 9, found, gain, out)


@kernel
def _innovate(budget, state, first, rows, found, gain, out):
    """Complete ``found`` from its ``h`` and ``noise``; return the NIS.

    out: innovation (3,), corrected by the estimated parameters. first, rows: of the errors that the update corrects,
    besides the estimated parameters. gain: (rows, 3).
    """
    n, h, cross = budget.n, found.h, found.cross
    for i in range(n):
        c0, c1, c2 = 0.0, 0.0, 0.0
        for m in range(n):
            c0 += state.p[i, m] * h[0, m]
            c1 += state.p[i, m] * h[1, m]
            c2 += state.p[i, m] * h[2, m]
        cross[i, 0], cross[i, 1], cross[i, 2] = c0, c1, c2
    for i in range(3):
        for m in range(FILTER_ERRORS, n):
            out[i] -= h[i, m] * state.x[m]
        for j in range(3):
            total = found.noise[i, j]
            for m in range(n):
                total += h[i, m] * cross[m, j]
            found.s[i, j] = total
    nis = 0.0 if invert_symmetric_3(found.s, found.s_inverse) else np.nan
    for i in range(n):
        corrected = first <= i < first + rows or (i >= FILTER_ERRORS and budget.estimated[i] != 0)
        for j in range(3):
            total = 0.0
            if corrected:
                for m in range(3):
                    total += cross[i, m] * found.s_inverse[m, j]
            found.gain[i, j] = total
    for i in range(rows):
        for j in range(3):
            gain[i, j] = found.gain[first + i, j]
    for i in range(3):
        for j in range(3):
            nis += out[i] * found.s_inverse[i, j] * out[j]
    return nis


@kernel
def update(budget, state, found, innovation, akf, pkf):
    """Fuse an accepted innovation (3,): correct parameters and both filters by the gain of ``found`` (INNOVATION)."""
    n, gain = budget.n, found.gain
    correction = stack.vector(46)
    # P - K G.T - G K.T + K S K.T = P - K U.T - U K.T with U = G - K S / 2
    u = stack.matrix(46, 3)
    for i in range(n):
        correction[i] = gain[i, 0] * innovation[0] + gain[i, 1] * innovation[1] + gain[i, 2] * innovation[2]
        for j in range(3):
            ks = gain[i, 0] * found.s[0, j] + gain[i, 1] * found.s[1, j] + gain[i, 2] * found.s[2, j]
            u[i, j] = found.cross[i, j] - 0.5 * ks
    for i in range(n):
        for j in range(i, n):
            total = state.p[i, j]
            for m in range(3):
                total -= gain[i, m] * u[j, m] + u[i, m] * gain[j, m]
            state.p[i, j] = state.p[j, i] = total
    aside, q = stack.vector(4), stack.vector(4)
    quat.from_rotation_vector_into(correction[_TURN : _TURN + 3], aside)
    quat.multiply_into(aside, akf.x[0:4], q)
    quat.normalise(q)
    copy_into(akf.x[0:4], q)
    for i in range(3):
        akf.x[4 + i] += correction[_DRIFT + i]
    for i in range(9):
        pkf.x[i] += correction[i]
    for i in range(FILTER_ERRORS, n):
        state.x[i] += correction[i]
    publish(state, akf, pkf)


@kernel
def adapt(budget, noise, k, found, innovation):
    """Take an accepted innovation (3,) into the factor of the noise's variance; k: 0 position, 1 attitude.

    With ``V`` the noise in ``S``: score ``(v.T S^-1 V S^-1 v - tr S^-1 V) / 2``, information ``tr (S^-1 V)^2 / 2``.
    """
    if budget.noise_variance == 0.0:
        return
    w, y = stack.matrix(3, 3), stack.vector(3)
    for i in range(3):
        y[i] = 0.0
        for j in range(3):
            y[i] += found.s_inverse[i, j] * innovation[j]
            w[i, j] = 0.0
            for m in range(3):
                w[i, j] += found.s_inverse[i, m] * found.noise[m, j]
    score, information = 0.0, 0.0
    for i in range(3):
        score -= 0.5 * w[i, i]
        for j in range(3):
            score += 0.5 * y[i] * found.noise[i, j] * y[j]
            information += 0.5 * w[i, j] * w[j, i]
    noise.information[k] += information
    noise.information[k] = min(noise.information[k], budget.noise_window * information)
    noise.log[k] += min(_LONGEST_STEP, max(-_LONGEST_STEP, score / noise.information[k]))
