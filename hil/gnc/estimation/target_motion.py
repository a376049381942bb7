"""Rate and moments of a target that tumbles, estimated: states of the navigation that move by Euler's equations.

The rate w of the body's axes, in H, and the logarithms m of its principal moments are parameters of the joint error
state. Poses show the attitude of the chaser against these axes and the gyros its inertial rate, so that the innovations
correct w, and, where the rotation is not about a principal axis, m, of which only differences count. With the errors
``dw``, ``dm``, rotation ``theta`` in c, ``J = dw'/dw`` and ``K = dw'/dm``:

    dw'    = J dw + K dm
    theta' = ... - A dw
    dv'    = ... - 2 dw x v - dw x (w x r) - w x (dw x r) - (J dw + K dm) x r
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.gnc.estimation.error_state import LANES, ROTATION, V
from hil.maths import elementary, quat, stack
from hil.maths.arrays import copy_into, cross_into, fill, fill_matrix
from hil.models.rotating_frame import euler_acceleration, tumble_rate

_WHOLE: Final = 12  # components of velocity, rotation and rate, in whole vector registers


@kernel
def start(orbit, errors, t_s, parameters):
    """Write the rate at ``t_s`` of the run, as it is known at the start, into the estimates of the states.

    orbit: TARGET_ORBIT. errors: ERROR_STATE. parameters: of FILTERS.
    """
    if errors.target_rate != 0:
        tumble_rate(orbit.tumble, t_s, parameters[errors.target_rate : errors.target_rate + 3], stack.vector(3))


@kernel
def _estimated_moments(orbit, errors, filters, moments):
    """Write the principal moments; ``filters`` has those of logarithms that have not changed."""
    for i in range(3):
        moments[i] = orbit.moments[i]
        if errors.target_moments != 0:
            logarithm = filters.parameters[errors.target_moments + i]
            if filters.moments[i] == 0.0 or logarithm != filters.moments_of[i]:
                filters.moments[i], filters.moments_of[i] = moments[i] * elementary.exp(logarithm), logarithm
            moments[i] = filters.moments[i]


@kernel
def _rate_change(orbit, moments, rate, out):
    """Write the rate of change of ``rate`` (3,) in H into ``out`` (3,)."""
    w, dw = stack.vector(3), stack.vector(3)
    quat.transform_into(orbit.q_PB, rate, w)
    euler_acceleration(moments, w, dw)
    quat.transform_back_into(orbit.q_PB, dw, out)


@kernel
def present_rate(params, state, t_s, rate, change):
    """Write rate (3,), rad/s, and its change (3,), rad/s^2, of the axes in H at ``t_s``, the time of the estimate.

    As estimated, otherwise as known. params: FUSION_PARAMS. state: FUSION_STATE.
    """
    errors, parameters = params.errors, state.filters.parameters
    if errors.target_rate == 0 or state.started == 0:
        tumble_rate(params.orbit.tumble, t_s, rate, change)
        return
    moments = stack.vector(3)
    _estimated_moments(params.orbit, errors, state.filters, moments)
    copy_into(rate, parameters[errors.target_rate : errors.target_rate + 3])
    _rate_change(params.orbit, moments, rate, change)


@kernel
def largest_sigma(params, state):
    """Return the largest standard deviation of a component of the rate, rad/s; 0 if it is not to be estimated.

    params: FUSION_PARAMS. state: FUSION_STATE; infinite before the first pose.
    """
    k, p = params.errors.target_rate, state.filters.p
    if k == 0:
        return 0.0
    return math.sqrt(max(p[k, k], p[k + 1, k + 1], p[k + 2, k + 2])) if state.started != 0 else np.inf


@kernel
def move(orbit, errors, dt, filters, hill):
    """Carry the estimated rate over a step of ``dt``, and write the motion of the axes over it into ``hill``.

    hill: HILL_STEP. Midpoint rule: its error is below 1e-10 rad/s in a step of 0.02 s at 5 deg/s.
    """
    k, parameters, moments, change = errors.target_rate, filters.parameters, stack.vector(3), stack.vector(3)
    _estimated_moments(orbit, errors, filters, moments)
    copy_into(hill.rate_before, parameters[k : k + 3])
    _rate_change(orbit, moments, hill.rate_before, change)
    for i in range(3):
        hill.rotation[i] = hill.rate_before[i] + 0.5 * dt * change[i]
    _rate_change(orbit, moments, hill.rotation, change)
    for i in range(3):
        hill.rate_after[i] = hill.rate_before[i] + dt * change[i]
        hill.rotation[i] *= dt
        parameters[k + i] = hill.rate_after[i]


@kernel
def _euler_sensitivity(orbit, moments, rate, out):
    """Write [J, K] (3, 6) of the rate of change of ``rate`` (3,) in H, to the rate and to the moments' logarithms."""
    w, r, of_axes = stack.vector(3), stack.matrix(3, 3), stack.matrix(3, 6)
    quat.transform_into(orbit.q_PB, rate, w)
    quat.to_matrix_into(orbit.q_PB, r)
    fill_matrix(of_axes, 0.0)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        ratio, product = (moments[j] - moments[k]) / moments[i], w[j] * w[k]
        for m in range(3):
            of_axes[i, m] = ratio * (w[k] * r[j, m] + w[j] * r[k, m])
        of_axes[i, 3 + i] = -ratio * product
        of_axes[i, 3 + j] = moments[j] / moments[i] * product
        of_axes[i, 3 + k] = -moments[k] / moments[i] * product
    for i in range(3):
        for m in range(6):
            out[i, m] = r[0, i] * of_axes[0, m] + r[1, i] * of_axes[1, m] + r[2, i] * of_axes[2, m]


@kernel
def _sensitivities(orbit, errors, dt, filters, out):
    """Write what dw and dm add over a step to the errors of velocity, rotation and rate into ``out`` (9, 6)."""
    moments, rate, a = stack.vector(3), stack.vector(3), stack.matrix(3, 3)
    r, v, wr = filters.pkf.x[0:3], filters.pkf.x[3:6], stack.vector(3)
    copy_into(rate, filters.parameters[errors.target_rate : errors.target_rate + 3])
    _estimated_moments(orbit, errors, filters, moments)
    _euler_sensitivity(orbit, moments, rate, out[6:9])
    quat.to_matrix_into(filters.akf.x[0:4], a)
    cross_into(rate, r, wr)
    unit, change, passed = stack.vector(3), stack.vector(3), stack.vector(3)
    first, second, third, aside = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3)
    for i in range(3):
        passed[i] = 2.0 * v[i] + wr[i]
    for m in range(6):
        for i in range(3):
            unit[i] = 1.0 if i == m else 0.0
            change[i] = out[6 + i, m]
        cross_into(passed, unit, first)  # (2 v + w x r) x dw
        cross_into(r, unit, aside)
        cross_into(rate, aside, second)  # w x (r x dw)
        cross_into(r, change, third)  # r x dw'
        for i in range(3):
            out[i, m] = dt * (first[i] + second[i] + third[i])
            out[3 + i, m] = -dt * a[i, m] if m < 3 else 0.0
            out[6 + i, m] *= dt


@kernel
def carry_errors(orbit, errors, dt, filters):
    """Carry velocity, rotation and rate in the covariance of FILTERS over a step by the errors of rate and moments.

    The filters have been carried over the step without these. What they add is taken at its end, to the first order of
    ``dt``.
    """
    f, p, n, k = stack.matrix(9, 6), filters.p, errors.n, errors.target_rate
    _sensitivities(orbit, errors, dt, filters, f)
    size = 3 if errors.target_moments == 0 else 6  # the moments follow the rate
    of_all = stack.matrix(6, LANES)  # a copy, so that the products are vector instructions
    for s in range(size):
        copy_into(of_all[s, : errors.lanes], p[k + s, : errors.lanes])
    for first, rows in ((0, V), (3, ROTATION), (6, k)):
        if size == 3:
            _gain_by_rate(f[first : first + 3], of_all, p[rows : rows + 3], errors.lanes)
        else:
            _gain_by_all(f[first : first + 3], of_all, p[rows : rows + 3], errors.lanes)
    gained, transposed = stack.vector(_WHOLE), stack.matrix(6, _WHOLE)
    for s in range(6):
        for i in range(_WHOLE):
            transposed[s, i] = f[i, s] if i < 9 else 0.0
    for j in range(n):
        if V + 3 <= j < ROTATION or (j >= ROTATION + 3 and not k <= j < k + 3):
            for i in range(3):  # the mirror of a column
                p[j, V + i], p[j, ROTATION + i], p[j, k + i] = p[V + i, j], p[ROTATION + i, j], p[k + i, j]
            continue
        fill(gained, 0.0)
        for s in range(size):
            for i in range(_WHOLE):
                gained[i] += transposed[s, i] * p[j, k + s]
        for i in range(3):
            p[j, V + i] += gained[i]
            p[j, ROTATION + i] += gained[3 + i]
            p[j, k + i] += gained[6 + i]
    if errors.target_walk != 0.0:
        _add_walk(errors, filters)


@kernel
def _gain_by_rate(f, of_rate, out, lanes):
    """Add ``f`` (3, 3) times the rows ``of_rate`` to three rows ``out`` of a covariance, which may be the same."""
    a0, a1, a2, b0, b1, b2 = f[0, 0], f[0, 1], f[0, 2], f[1, 0], f[1, 1], f[1, 2]
    c0, c1, c2 = f[2, 0], f[2, 1], f[2, 2]
    for j in range(lanes):
        x0, x1, x2 = of_rate[0, j], of_rate[1, j], of_rate[2, j]
        out[0, j] += a0 * x0 + a1 * x1 + a2 * x2
        out[1, j] += b0 * x0 + b1 * x1 + b2 * x2
        out[2, j] += c0 * x0 + c1 * x1 + c2 * x2


@kernel
def _gain_by_all(f, of_all, out, lanes):
    """``_gain_by_rate`` by the rows of rate and moments, six."""
    a0, a1, a2, a3, a4, a5 = f[0, 0], f[0, 1], f[0, 2], f[0, 3], f[0, 4], f[0, 5]
    b0, b1, b2, b3, b4, b5 = f[1, 0], f[1, 1], f[1, 2], f[1, 3], f[1, 4], f[1, 5]
    c0, c1, c2, c3, c4, c5 = f[2, 0], f[2, 1], f[2, 2], f[2, 3], f[2, 4], f[2, 5]
    for j in range(lanes):
        x0, x1, x2, x3, x4, x5 = of_all[0, j], of_all[1, j], of_all[2, j], of_all[3, j], of_all[4, j], of_all[5, j]
        out[0, j] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3 + a4 * x4 + a5 * x5
        out[1, j] += b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3 + b4 * x4 + b5 * x5
        out[2, j] += c0 * x0 + c1 * x1 + c2 * x2 + c3 * x3 + c4 * x4 + c5 * x5


@kernel
def _add_walk(errors, filters):
    """Add the random walk of the rate over a step: ``dw``, and the velocity ``r x dw`` that it gives in these axes."""
    p, k = filters.p, errors.target_rate
    unit, moved = stack.vector(3), stack.vector(3)
    for m in range(3):
        for i in range(3):
            unit[i] = 1.0 if i == m else 0.0
        cross_into(filters.pkf.x[0:3], unit, moved)
        p[k + m, k + m] += errors.target_walk
        for i in range(3):
            p[V + i, k + m] += errors.target_walk * moved[i]
            p[k + m, V + i] += errors.target_walk * moved[i]
            for j in range(3):
                p[V + i, V + j] += errors.target_walk * moved[i] * moved[j]
