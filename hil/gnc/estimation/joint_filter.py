"""One prediction and one update of the covariance of all errors of the navigation.

The covariance is symmetric and held in both triangles, so that a product with it runs along rows. Gains are optimal in
the rows that an update corrects and zero in the others: the covariance of any gain, ``P - K G.T - G K.T + K S K.T``
with ``G = P H.T`` (Schmidt 1966; Bryson and Johansen 1965), is ``P - G S^-1 G.T`` but for the others among themselves.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.gnc.estimation import akf, pkf, thrust_model
from hil.gnc.estimation.error_motion import add_part, carry_filters, decay
from hil.gnc.estimation.error_state import BIAS, DRIFT, FILTER_ERRORS, LANES, ROTATION
from hil.maths import quat, stack
from hil.maths.arrays import copy_into
from hil.maths.kalman import inverse_root_3, invert_symmetric_3


@kernel
def predict(params, filters, step):
    """Carry all estimates and the covariance over one step.

    params: FUSION_PARAMS. step: STEP, with its inputs and the motion of H.
    """
    errors, of_akf, of_pkf = params.errors, params.akf, params.pkf
    middle, a, phi = stack.vector(4), stack.matrix(3, 3), stack.matrix(3, 6)
    moved = filters.input
    thrust_model.write_input(params.thrust, of_pkf, errors, filters, step)
    copy_into(middle, filters.akf.x[0:4])
    akf.predict_state(of_akf, filters.akf, step.rate_C, step.hill, phi)
    for i in range(4):
        middle[i] = 0.5 * (middle[i] + filters.akf.x[i])
    quat.normalise(middle)
    quat.to_matrix_into(middle, a)
    pkf.predict_state(of_pkf, filters.pkf, moved.force, a, step.hill)
    if errors.lanes == 16:
        _carry_filters_16(errors, of_pkf, a, moved, phi, filters)
    elif errors.lanes == 24:
        _carry_filters_24(errors, of_pkf, a, moved, phi, filters)
    elif errors.lanes == 32:
        _carry_filters_32(errors, of_pkf, a, moved, phi, filters)
    elif errors.lanes == 40:
        _carry_filters_40(errors, of_pkf, a, moved, phi, filters)
    else:
        _carry_filters(errors, of_pkf, a, moved, phi, filters)
    if errors.moves != 0:
        _predict_processes(errors, filters)
    _add_noise(params, step.rate_variance, filters.akf.x, filters.p)


@kernel
def _predict_processes(errors, filters):
    """Carry the Gauss-Markov processes, and bias and drift with those that are parts of them."""
    for first, part, x in (
        (BIAS, errors.accelerometer_instability, filters.pkf.x[6:9]),
        (DRIFT, errors.gyro_instability, filters.akf.x[4:7]),
    ):
        if part != 0:
            for i in range(3):
                x[i] += (errors.kept[part + i] - 1.0) * filters.parameters[part + i]
            add_part(errors, first, part, filters.p)
    for k in range(FILTER_ERRORS, errors.n):
        filters.parameters[k] *= errors.kept[k]
    decay(errors, filters.p)


@kernel
def _carry_filters_16(errors, of_pkf, a, moved, phi, filters):
    carry_filters(errors, of_pkf, a, moved, phi, filters.p, 16)


@kernel
def _carry_filters_24(errors, of_pkf, a, moved, phi, filters):
    carry_filters(errors, of_pkf, a, moved, phi, filters.p, 24)


@kernel
def _carry_filters_32(errors, of_pkf, a, moved, phi, filters):
    carry_filters(errors, of_pkf, a, moved, phi, filters.p, 32)


@kernel
def _carry_filters_40(errors, of_pkf, a, moved, phi, filters):
    carry_filters(errors, of_pkf, a, moved, phi, filters.p, 40)


@kernel
def _carry_filters(errors, of_pkf, a, moved, phi, filters):
    carry_filters(errors, of_pkf, a, moved, phi, filters.p, LANES)


@kernel
def _add_noise(params, rate_variance, attitude, p):
    """Add the noise of a step: white noise of the gyro, random walks, and the fresh part of the instabilities.

    rate_variance: (rad/s)^2, of the drift beyond its random walk.
    """
    errors, of_akf, of_pkf, d = params.errors, params.akf, params.pkf, params.errors.disturbance
    akf.add_in_chaser_axes(of_akf.rate_noise, of_akf.dt_s, attitude, DRIFT, p)
    for i in range(3):
        p[BIAS + i, BIAS + i] += (of_pkf.dt_s * of_pkf.sigma_bias) ** 2
        p[ROTATION + i, ROTATION + i] += (of_akf.dt_s * of_akf.sigma_gyro) ** 2
        p[DRIFT + i, DRIFT + i] += (of_akf.dt_s * of_akf.sigma_drift) ** 2 + rate_variance
        if d != 0:
            p[d + i, d + i] += params.thrust.walk**2
        if errors.accelerometer_instability != 0:
            _add_fresh(errors, BIAS + i, errors.accelerometer_instability + i, p)
        if errors.gyro_instability != 0:
            _add_fresh(errors, DRIFT + i, errors.gyro_instability + i, p)


@kernel
def _add_fresh(errors, i, k, p):
    """Add the fresh part of instability ``k`` to the bias or drift ``i``, of which it is a part."""
    fresh = errors.variance[k] * (1.0 - errors.kept[k] ** 2)
    p[i, i] += fresh
    p[i, k] += fresh
    p[k, i] += fresh


@kernel
def innovate(errors, filters, first, rows, innovation):
    """Complete ``innovation`` (INNOVATION) from its value, ``h`` and ``noise``; return the NIS.

    The NIS is nan if the covariance of the innovation is not positive definite. first, rows: errors of the filter that
    the update corrects, besides the estimated parameters. The value is corrected by the estimated parameters.
    """
    n, lanes, h = errors.n, errors.lanes, innovation.h
    cross, gain = stack.matrix(3, LANES), stack.matrix(3, LANES)
    for j in range(lanes):
        cross[0, j] = cross[1, j] = cross[2, j] = 0.0
    for m in range(n):
        h0, h1, h2 = h[0, m], h[1, m], h[2, m]
        if h0 != 0.0 or h1 != 0.0 or h2 != 0.0:
            for j in range(lanes):
                value = filters.p[m, j]
                cross[0, j] += h0 * value
                cross[1, j] += h1 * value
                cross[2, j] += h2 * value
    for i in range(3):
        for j in range(3):
            innovation.s[i, j] = innovation.noise[i, j]
    for m in range(n):
        if h[0, m] != 0.0 or h[1, m] != 0.0 or h[2, m] != 0.0:
            for i in range(3):
                if m >= FILTER_ERRORS:
                    innovation.value[i] -= h[i, m] * filters.parameters[m]
                for j in range(i + 1):
                    innovation.s[i, j] += h[i, m] * cross[j, m]
    for i in range(3):
        for j in range(i):
            innovation.s[j, i] = innovation.s[i, j]
    nis = 0.0 if invert_symmetric_3(innovation.s, innovation.s_inverse) else np.nan
    for k in range(3):
        i0, i1, i2 = innovation.s_inverse[0, k], innovation.s_inverse[1, k], innovation.s_inverse[2, k]
        for j in range(lanes):
            gain[k, j] = cross[0, j] * i0 + cross[1, j] * i1 + cross[2, j] * i2
    for j in range(n):
        if not (first <= j < first + rows or (j >= FILTER_ERRORS and errors.estimated[j] != 0)):
            gain[0, j] = gain[1, j] = gain[2, j] = 0.0
    for k in range(3):
        for j in range(lanes):
            innovation.cross[k, j], innovation.gain[k, j] = cross[k, j], gain[k, j]
    for i in range(3):
        for j in range(3):
            nis += innovation.value[i] * innovation.s_inverse[i, j] * innovation.value[j]
    return nis


@kernel
def update(errors, filters, innovation):
    """Fuse an accepted innovation (INNOVATION, of ``innovate``): correct all estimates and the covariance."""
    n, lanes, w = errors.n, errors.lanes, stack.matrix(3, 3)
    part, of_corrected, correction = stack.matrix(3, LANES), stack.matrix(3, LANES), stack.vector(LANES)
    # in rows or columns that are corrected, K S K.T = G S^-1 G.T = (W G).T (W G), the same for (i, j) and (j, i)
    inverse_root_3(innovation.s, w)
    for j in range(lanes):
        k0, k1, k2 = innovation.gain[0, j], innovation.gain[1, j], innovation.gain[2, j]
        g0, g1, g2 = innovation.cross[0, j], innovation.cross[1, j], innovation.cross[2, j]
        correction[j] = k0 * innovation.value[0] + k1 * innovation.value[1] + k2 * innovation.value[2]
        corrected = 1.0 if k0 != 0.0 or k1 != 0.0 or k2 != 0.0 else 0.0
        part[0, j], part[1, j] = w[0, 0] * g0, w[1, 0] * g0 + w[1, 1] * g1
        part[2, j] = w[2, 0] * g0 + w[2, 1] * g1 + w[2, 2] * g2
        for i in range(3):
            of_corrected[i, j] = corrected * part[i, j]
    for i in range(n):
        p0, p1, p2 = part[0, i], part[1, i], part[2, i]
        if innovation.gain[0, i] == 0.0 and innovation.gain[1, i] == 0.0 and innovation.gain[2, i] == 0.0:
            for j in range(lanes):
                filters.p[i, j] -= p0 * of_corrected[0, j] + p1 * of_corrected[1, j] + p2 * of_corrected[2, j]
        else:
            for j in range(lanes):
                filters.p[i, j] -= p0 * part[0, j] + p1 * part[1, j] + p2 * part[2, j]
    akf.correct(filters.akf, correction[ROTATION:FILTER_ERRORS])
    for i in range(9):
        filters.pkf.x[i] += correction[i]
    for i in range(FILTER_ERRORS, n):
        filters.parameters[i] += correction[i]


@kernel
def sigma(filters, first, out):
    """Write the standard deviations of three errors from index ``first`` on."""
    for i in range(3):
        out[i] = math.sqrt(max(0.0, filters.p[first + i, first + i]))


@kernel
def copy_block(filters, first, out):
    """Write the covariance of the errors from index ``first`` on into ``out`` (m, m)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = filters.p[first + i, first + j]
