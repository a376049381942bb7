"""Pose as a measurement: what its attitude and its position have of each error, its noise, and the start from it.

With ``y = z - camera_position``, misalignment ``mu``, bias ``beta``, scale ``sigma`` and processes of unit variance
``g_a``, ``g_z`` of the correlated noise, ``L L.T`` the correlated part of a pose's covariance:

    innovation of the attitude = theta - mu + L_a g_a + white
    innovation of the position = -A dr + theta x A r + mu x y + beta + sigma (y + A ring) + L_z g_z + white

The factor of the noise against the reported one is estimated from the innovations, by Fisher scoring of their
likelihood over a window. docs/explanation/error-budget.md
"""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.gnc.estimation import akf, joint_filter, pkf, plane, target_motion
from hil.gnc.estimation.error_state import BIAS, DRIFT, FILTER_ERRORS, LANES, ROTATION, R, V
from hil.maths import elementary, quat, stack
from hil.maths.arrays import copy_into, fill_matrix
from hil.sensors.vision_unit.pose import position_in_h

_LEAST_WHITE = 1e-4  # fraction of a pose's variance
_LONGEST_STEP = 1.0  # step of the logarithm of the noise factor, per pose
_LEAST_FACTOR = 3.0  # standard deviations of the logarithm as it was known, below the reported noise


@kernel
def start_noise(errors, noise):
    """Write what is known of NOISE_FACTOR at the start: a lognormal distribution of the factor."""
    for k in range(2):
        noise.log[k] = 0.5 * errors.noise_variance
        noise.information[k] = 1.0 / errors.noise_variance if errors.noise_variance > 0.0 else 0.0


@kernel
def _white(errors, covariance, k, noise, out):
    """Write the white part (3, 3) of a pose's ``covariance`` (3, 3); k: 0 position, 1 rotation."""
    factor = elementary.exp(noise.log[k]) * (1.0 - errors.fraction)
    for i in range(3):
        for j in range(3):
            out[i, j] = factor * covariance[i, j]
        reported = max(covariance[i, i] - errors.bench_variance[k], _LEAST_WHITE * covariance[i, i])
        out[i, i] = factor * reported


@kernel
def _add_correlated(errors, covariance, k, noise, h):
    """Write the sensitivity to the correlated noise, the Cholesky factor of its covariance; k: see ``_white``."""
    if errors.correlated == 0:
        return
    first, factor = errors.correlated + 3 * k, elementary.exp(noise.log[k]) * errors.fraction
    for i in range(3):
        for j in range(i + 1):
            total = factor * covariance[i, j]
            if i == j:
                total += (1.0 - factor) * min(errors.bench_variance[k], covariance[i, i])
            for m in range(j):
                total -= h[i, first + m] * h[j, first + m]
            if i == j:
                h[i, first + i] = math.sqrt(max(total, 0.0))
            else:
                h[i, first + j] = total / h[j, first + j] if h[j, first + j] > 0.0 else 0.0


@kernel
def attitude_sensitivity(errors, covariance, noise, h):
    """Write the sensitivity (3, n) of a measured rotation, which a misaligned camera rotates, to the parameters."""
    fill_matrix(h, 0.0)
    for i in range(3):
        if errors.misalignment != 0:
            h[i, errors.misalignment + i] = -1.0
    _add_correlated(errors, covariance, 1, noise, h)


@kernel
def position_sensitivity(errors, expected, q_CH, covariance, noise, h):
    """Write the sensitivity (3, n) of a measured ``z_TC_C`` to the parameters.

    ``dz = misalignment x y + bias + scale (y + A ring)`` with ``y = z - camera_position``. expected: ``-z`` (3,).
    """
    y, ring = stack.vector(3), stack.vector(3)
    fill_matrix(h, 0.0)
    for i in range(3):
        y[i] = -expected[i] - errors.camera_position[i]
    if errors.misalignment != 0:
        _cross_of(y, h, errors.misalignment, 1.0)
    if errors.bias != 0:
        for i in range(3):
            h[i, errors.bias + i] = 1.0
    if errors.scale != 0:
        quat.transform_into(q_CH, errors.ring_position, ring)
        for i in range(3):
            h[i, errors.scale] = y[i] + ring[i]
    _add_correlated(errors, covariance, 0, noise, h)


@kernel
def _cross_of(v, h, first, sign):
    """Write the matrix of ``sign p x v`` for p (3,) into the columns of ``h`` from ``first`` on."""
    h[0, first + 1], h[0, first + 2] = sign * v[2], -sign * v[1]
    h[1, first], h[1, first + 2] = -sign * v[2], sign * v[0]
    h[2, first], h[2, first + 1] = sign * v[1], -sign * v[0]


@kernel
def start(params, pose, noise, filters):
    """Start all estimates and the covariance from the first pose.

    params: FUSION_PARAMS. noise: NOISE_FACTOR. The start has the pose's errors: ``theta = -H_a e - n_a``,
    ``r = A.T (theta x z' + H_z e + n_z)``, ``z' = -z``.
    """
    errors, of_akf, of_pkf, p = params.errors, params.akf, params.pkf, filters.p
    n, expected = errors.n, stack.vector(3)
    akf.start(of_akf, pose.q_CH, filters.akf)
    position_in_h(pose, expected)
    pkf.start(of_pkf, expected, filters.pkf)
    start_noise(errors, noise)
    fill_matrix(p, 0.0)
    for i in range(FILTER_ERRORS, n):
        filters.parameters[i] = 0.0
    target_motion.start(params.orbit, errors, pose.t_s, filters.parameters)
    for i in range(3):
        p[V + i, V + i], p[BIAS + i, BIAS + i] = of_pkf.initial_velocity_sigma**2, of_pkf.initial_bias_sigma**2
        p[DRIFT + i, DRIFT + i] = of_akf.initial_drift_sigma**2
    akf.add_in_chaser_axes(of_akf.rate_sigma, 1.0, pose.q_CH, DRIFT, p)
    # columns: white noise of rotation and position (6), then as the joint errors
    response = stack.matrix(FILTER_ERRORS, LANES)
    h, a = stack.matrix(3, LANES), stack.matrix(3, 3)
    white_z, white_a = stack.matrix(3, 3), stack.matrix(3, 3)
    fill_matrix(response, 0.0)
    quat.to_matrix_into(pose.q_CH, a)
    _white(errors, pose.covariance_attitude, 1, noise, white_a)
    _white(errors, pose.covariance_position, 0, noise, white_z)
    attitude_sensitivity(errors, pose.covariance_attitude, noise, h)
    for i in range(3):
        expected[i] = -pose.z_TC_C[i]
        h[i, i] = 1.0
        for j in range(n):
            response[ROTATION + i, j] = -h[i, j]
    position_sensitivity(errors, expected, pose.q_CH, pose.covariance_position, noise, h)
    for i in range(3):
        h[i, 3 + i] = 1.0
    for j in range(n):
        t0, t1, t2 = response[ROTATION, j], response[ROTATION + 1, j], response[ROTATION + 2, j]
        in_c0 = h[0, j] + t1 * expected[2] - t2 * expected[1]
        in_c1 = h[1, j] + t2 * expected[0] - t0 * expected[2]
        in_c2 = h[2, j] + t0 * expected[1] - t1 * expected[0]
        for i in range(3):
            response[R + i, j] = a[0, i] * in_c0 + a[1, i] * in_c1 + a[2, i] * in_c2
    for i in range(FILTER_ERRORS):
        for j in range(FILTER_ERRORS):
            for m in range(3):
                for k in range(3):
                    p[i, j] += response[i, m] * white_a[m, k] * response[j, k]
                    p[i, j] += response[i, 3 + m] * white_z[m, k] * response[j, 3 + k]
    for i in range(3):
        if errors.accelerometer_instability != 0:
            response[BIAS + i, errors.accelerometer_instability + i] = 1.0
        if errors.gyro_instability != 0:
            response[DRIFT + i, errors.gyro_instability + i] = 1.0
    for m in range(FILTER_ERRORS, n):
        variance = errors.variance[m]
        p[m, m] = variance
        for i in range(FILTER_ERRORS):
            p[i, m] = p[m, i] = response[i, m] * variance
            for j in range(FILTER_ERRORS):
                p[i, j] += response[i, m] * variance * response[j, m]
    if params.held != 0:
        plane.hold(params.held, errors, filters)


@kernel
def innovate_attitude(errors, filters, noise, q_measured, covariance, innovation):
    """Write innovation, a rotation in rad, and gain of a measured attitude into ``innovation``; return the NIS.

    errors: ERROR_STATE. filters: FILTERS, not changed. noise: NOISE_FACTOR. covariance: (3, 3), rad^2, in c.
    innovation: INNOVATION. The NIS is nan if the covariance of the innovation is not positive definite.
    """
    quat.rotation_between(q_measured, filters.akf.x[0:4], innovation.value)
    attitude_sensitivity(errors, covariance, noise, innovation.h)
    for i in range(3):
        innovation.h[i, ROTATION + i] = 1.0
    _white(errors, covariance, 1, noise, innovation.noise)
    return joint_filter.innovate(errors, filters, ROTATION, 6, innovation)


@kernel
def innovate_position(errors, filters, noise, z_TC_C, covariance, delta_s, innovation):
    """As ``innovate_attitude``, of a measured position (3,), m, in c at the filter's moment.

    covariance: (3, 3), m^2. delta_s: exposure after the filter's moment, a fraction of a step.
    """
    a, expected, q_CH = stack.matrix(3, 3), stack.vector(3), stack.vector(4)
    copy_into(q_CH, filters.akf.x[0:4])
    quat.to_matrix_into(q_CH, a)
    for i in range(3):
        expected[i] = filters.pkf.x[i] + delta_s * filters.pkf.x[3 + i]
    quat.transform_into(q_CH, expected, expected)
    position_sensitivity(errors, expected, q_CH, covariance, noise, innovation.h)
    _cross_of(expected, innovation.h, ROTATION, 1.0)
    for i in range(3):
        innovation.value[i] = z_TC_C[i] + expected[i]
        for j in range(3):
            innovation.h[i, R + j] = -a[i, j]
            innovation.h[i, V + j] = -delta_s * a[i, j]
    _white(errors, covariance, 0, noise, innovation.noise)
    return joint_filter.innovate(errors, filters, R, 9, innovation)


@kernel
def adapt(errors, noise, k, innovation):
    """Take an accepted innovation (INNOVATION) into the factor of the noise's variance; k: 0 position, 1 attitude.

    With ``V`` the noise in ``S``: score ``(v.T S^-1 V S^-1 v - tr S^-1 V) / 2``, information ``tr (S^-1 V)^2 / 2``.
    """
    if errors.noise_variance == 0.0:
        return
    w, y = stack.matrix(3, 3), stack.vector(3)
    for i in range(3):
        y[i] = 0.0
        for j in range(3):
            y[i] += innovation.s_inverse[i, j] * innovation.value[j]
            w[i, j] = 0.0
            for m in range(3):
                w[i, j] += innovation.s_inverse[i, m] * innovation.noise[m, j]
    score, information = 0.0, 0.0
    for i in range(3):
        score -= 0.5 * w[i, i]
        for j in range(3):
            score += 0.5 * y[i] * innovation.noise[i, j] * y[j]
            information += 0.5 * w[i, j] * w[j, i]
    noise.information[k] += information
    noise.information[k] = min(noise.information[k], errors.noise_window * information)
    noise.log[k] += min(_LONGEST_STEP, max(-_LONGEST_STEP, score / noise.information[k]))
    noise.log[k] = max(noise.log[k], -_LEAST_FACTOR * math.sqrt(errors.noise_variance))
