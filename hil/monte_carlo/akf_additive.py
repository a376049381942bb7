"""Attitude Kalman filter as printed: seven additive states (bench paper eq. (3) to (10)), evidence in ``hil fusion``.

The quaternion is propagated by the exact transition at a constant rate over the step, which is
linear in the quaternion, so its Jacobian is the transition itself. The measurement is the three
3-2-1 angles of eq. (9), whose third line is corrected to ``atan2(2 (q3 q4 + q1 q2), ...)``.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.gnc.akf import add_in_chaser_axes
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill, fill_matrix
from hil.maths.kalman import propagate_covariance, update_three

AKF_ADDITIVE_STATE = np.dtype(
    [
        ("x", "f8", 7),  # q_CH, gyro drift in rad/s
        ("p", "f8", (7, 7)),
        ("w_CH_C", "f8", 3),  # rad/s
        ("nis", "f8"),
    ],
    align=True,
)


@kernel
def rotation_response(q, out):
    """Write Xi(q) (4, 3): a small-angle rotation phi of c changes q by ``Xi phi / 2`` (eq. (6): F12 = -Xi / 2)."""
    out[0, 0], out[0, 1], out[0, 2] = q[3], -q[2], q[1]
    out[1, 0], out[1, 1], out[1, 2] = q[2], q[3], -q[0]
    out[2, 0], out[2, 1], out[2, 2] = -q[1], q[0], q[3]
    out[3, 0], out[3, 1], out[3, 2] = -q[0], -q[1], -q[2]


@kernel
def angles_into(q, theta):
    """Write theta (3,), rad: eq. (9) with its third line corrected."""
    theta[0] = math.atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), -q[0] * q[0] - q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    theta[1] = math.asin(min(1.0, max(-1.0, 2.0 * (q[1] * q[3] - q[0] * q[2]))))
    theta[2] = math.atan2(2.0 * (q[2] * q[3] + q[0] * q[1]), q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3])


@kernel
def angle_jacobian(q, h):
    """Write d(theta)/d(q) into ``h[:, 0:4]``, (3, 4): each component of q taken as free."""
    n1 = 2.0 * (q[0] * q[3] + q[1] * q[2])
    d1 = -q[0] * q[0] - q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    n3 = 2.0 * (q[2] * q[3] + q[0] * q[1])
    d3 = q[0] * q[0] - q[1] * q[1] - q[2] * q[2] + q[3] * q[3]
    s1 = n1 * n1 + d1 * d1
    s3 = n3 * n3 + d3 * d3
    h[0, 0] = (d1 * 2.0 * q[3] + n1 * 2.0 * q[0]) / s1
    h[0, 1] = (d1 * 2.0 * q[2] + n1 * 2.0 * q[1]) / s1
    h[0, 2] = (d1 * 2.0 * q[1] - n1 * 2.0 * q[2]) / s1
    h[0, 3] = (d1 * 2.0 * q[0] - n1 * 2.0 * q[3]) / s1
    sine = 2.0 * (q[1] * q[3] - q[0] * q[2])
    cosine = math.sqrt(max(1e-12, 1.0 - sine * sine))
    h[1, 0] = -2.0 * q[2] / cosine
    h[1, 1] = 2.0 * q[3] / cosine
    h[1, 2] = -2.0 * q[0] / cosine
    h[1, 3] = 2.0 * q[1] / cosine
    h[2, 0] = (d3 * 2.0 * q[1] - n3 * 2.0 * q[0]) / s3
    h[2, 1] = (d3 * 2.0 * q[0] + n3 * 2.0 * q[1]) / s3
    h[2, 2] = (d3 * 2.0 * q[3] + n3 * 2.0 * q[2]) / s3
    h[2, 3] = (d3 * 2.0 * q[2] - n3 * 2.0 * q[3]) / s3


@kernel
def angle_covariance(q, covariance_rotation, out):
    """Write the covariance (3, 3) of theta for a covariance (3, 3), rad^2, of the small-angle rotation of c."""
    h, xi, e = stack.matrix(3, 4), stack.matrix(4, 3), stack.matrix(3, 3)
    angle_jacobian(q, h)
    rotation_response(q, xi)
    fill_matrix(e, 0.0)
    for i in range(3):
        for j in range(3):
            for m in range(4):
                e[i, j] += 0.5 * h[i, m] * xi[m, j]
    for i in range(3):
        for j in range(3):
            total = 0.0
            for m in range(3):
                for n in range(3):
                    total += e[i, m] * covariance_rotation[m, n] * e[j, n]
            out[i, j] = total


@kernel
def from_multiplicative(x, p, state):
    """Start from the state ``x`` (7,) of the multiplicative filter and its covariance ``p`` (6, 6)."""
    copy_into(state.x, x)
    state.nis = np.nan
    xi, t = stack.matrix(4, 3), stack.matrix(7, 6)
    rotation_response(x, xi)
    fill_matrix(t, 0.0)
    for i in range(3):
        for j in range(4):
            t[j, i] = 0.5 * xi[j, i]
        t[4 + i, 3 + i] = 1.0
        state.w_CH_C[i] = 0.0
    for i in range(7):
        for j in range(7):
            total = 0.0
            for m in range(6):
                for n in range(6):
                    total += t[i, m] * p[m, n] * t[j, n]
            state.p[i, j] = total


@kernel
def start(params, pose, state):
    """Start from the first pose: its attitude with its covariance, the drift from ``params`` (AKF_PARAMS)."""
    x, p = stack.vector(7), stack.matrix(6, 6)
    fill_matrix(p, 0.0)
    copy_into(x[0:4], pose.q_CH)
    for i in range(3):
        x[4 + i] = params.initial_drift[i]
        p[3 + i, 3 + i] = params.initial_drift_sigma**2
        for j in range(3):
            p[i, j] = pose.covariance_attitude[i, j]
    add_in_chaser_axes(params.rate_sigma, 1.0, pose.q_CH, 3, p)
    from_multiplicative(x, p, state)


@kernel
def transition(params, x, measured_rate, hill, q_next, phi):
    """Write the quaternion after the step, (4,), and the transition matrix ``phi`` (7, 7)."""
    dt = params.dt_s
    rotation, hill_rotation, xi = stack.vector(3), stack.vector(3), stack.matrix(4, 3)
    dq_c, dq_h = stack.vector(4), stack.vector(4)
    unit, before, column = stack.vector(4), stack.vector(4), stack.vector(4)
    for i in range(3):
        rotation[i] = (measured_rate[i] - x[4 + i]) * dt
        hill_rotation[i] = 0.0
    hill_rotation[1] = hill.turn  # minus the rotation of H, about -y
    quat.from_rotation_vector_into(rotation, dq_c)
    quat.from_rotation_vector_into(hill_rotation, dq_h)
    fill_matrix(phi, 0.0)
    for j in range(4):
        fill(unit, 0.0)
        unit[j] = 1.0
        quat.multiply_into(unit, dq_h, before)
        quat.multiply_into(dq_c, before, column)
        for i in range(4):
            phi[i, j] = column[i]
    quat.multiply_into(x[0:4], dq_h, before)
    quat.multiply_into(dq_c, before, q_next)
    rotation_response(q_next, xi)
    for i in range(3):
        phi[4 + i, 4 + i] = 1.0
        for j in range(4):
            phi[j, 4 + i] = -0.5 * dt * xi[j, i]


@kernel
def predict(params, state, measured_rate, hill):
    """Carry the state over one step; arguments as of ``akf.predict``."""
    q_next, along_y = stack.vector(4), stack.vector(3)
    phi, noise = stack.matrix(7, 7), stack.matrix(7, 7)
    transition(params, state.x, measured_rate, hill, q_next, phi)
    copy_into(state.x[0:4], q_next)
    quat.normalise(state.x[0:4])
    fill_matrix(noise, 0.0)
    gyro = (0.5 * params.dt_s * params.sigma_gyro) ** 2
    for i in range(4):
        for j in range(4):
            # Xi Xi.T = I - q q.T for a unit quaternion
            noise[i, j] = -gyro * q_next[i] * q_next[j]
        noise[i, i] += gyro
    for i in range(3):
        noise[4 + i, 4 + i] = (params.dt_s * params.sigma_drift) ** 2
    add_in_chaser_axes(params.rate_noise, params.dt_s, state.x[0:4], 4, noise)
    propagate_covariance(state.p, phi, noise)
    quat.second_column_into(state.x[0:4], along_y)
    for i in range(3):
        state.w_CH_C[i] = measured_rate[i] - state.x[4 + i] + along_y[i] * hill.rate
    state.nis = np.nan


@kernel
def update(state, q_measured, covariance):
    """Fuse a measured attitude; covariance: (3, 3), rad^2, of its small-angle rotation, in c."""
    q, expected, measured, innovation = stack.vector(4), stack.vector(3), stack.vector(3), stack.vector(3)
    h, r = stack.matrix(3, 7), stack.matrix(3, 3)
    copy_into(q, state.x[0:4])
    angles_into(q, expected)
    angles_into(q_measured, measured)
    for i in range(3):
        difference = measured[i] - expected[i]
        innovation[i] = difference - 2.0 * math.pi * math.floor(difference / (2.0 * math.pi) + 0.5)
    fill_matrix(h, 0.0)
    angle_jacobian(q, h)
    angle_covariance(q, covariance, r)
    state.nis = update_three(state.x, state.p, h, r, innovation)
    quat.normalise(state.x[0:4])


@kernel
def error_covariance(state, out):
    """Write the covariance (6, 6) of the small-angle rotation of c, rad, and the drift, from the additive one."""
    # t takes the seven additive errors to the six: rotation = 2 Xi.T dq
    xi, t = stack.matrix(4, 3), stack.matrix(6, 7)
    rotation_response(state.x[0:4], xi)
    fill_matrix(t, 0.0)
    for i in range(3):
        for j in range(4):
            t[i, j] = 2.0 * xi[j, i]
        t[3 + i, 4 + i] = 1.0
    for i in range(6):
        for j in range(6):
            total = 0.0
            for m in range(7):
                for n in range(7):
                    total += t[i, m] * state.p[m, n] * t[j, n]
            out[i, j] = total
