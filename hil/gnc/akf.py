"""The attitude Kalman filter: quaternion and gyro drift, with the error as a small-angle rotation of c.

The states are those of bench paper eq. (4). Their error has six components, not seven: the small-angle
rotation ``theta`` from the estimated to the true c (``q_true = from_rotation_vector(theta) q_est``) and the
drift error. The quaternion keeps unit length and its covariance has no redundant direction
(Lefferts, Markley and Shuster 1982). ``hil.gnc.akf_additive`` has the filter as printed.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill_matrix
from hil.maths.kalman import gain_of_three, joseph

AKF_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("sigma_gyro", "f8"),  # rad/s per sample
        ("sigma_drift", "f8"),  # rad/s^2, eq. (7): drift[k+1] = drift[k] + dt * w
        ("initial_drift", "f8", 3),  # rad/s
        ("initial_drift_sigma", "f8"),  # rad/s
        # error of the known rate of H, in H, which is a part of the drift
        ("rate_sigma", "f8", 3),  # rad/s, initial
        ("rate_noise", "f8", 3),  # rad/s^2, as sigma_drift
        ("gate", "f8"),  # largest NIS that is accepted
    ],
    align=True,
)

AKF_STATE = np.dtype(
    [
        ("x", "f8", 7),  # q_CH, gyro drift in rad/s
        ("p", "f8", (6, 6)),  # of theta, rad, and drift, rad/s
        ("w_CH_C", "f8", 3),  # rad/s
        ("phi", "f8", (6, 6)),  # transition of the error over the last step
        ("keep", "f8", (6, 6)),  # I - K H of the last update
        ("nis", "f8"),
    ],
    align=True,
)


@kernel
def start(params, pose, state):
    """Start from the first pose: its attitude with its covariance, the drift from ``params``."""
    fill_matrix(state.p, 0.0)
    state.nis = np.nan
    copy_into(state.x[0:4], pose.q_CH)
    for i in range(3):
        state.x[4 + i] = params.initial_drift[i]
        state.p[3 + i, 3 + i] = params.initial_drift_sigma**2
        state.w_CH_C[i] = 0.0
        for j in range(3):
            state.p[i, j] = pose.covariance_attitude[i, j]
    add_in_chaser_axes(params.rate_sigma, 1.0, pose.q_CH, state.p[3:6, 3:6])


@kernel
def add_in_chaser_axes(sigma, scale, q, p):
    """Add ``A(q) diag((scale sigma)^2) A(q)^T`` to ``p`` (3, 3); sigma: (3,), in H."""
    unit, column = stack.vector(3), stack.vector(3)
    for k in range(3):
        if sigma[k] != 0.0:
            for i in range(3):
                unit[i] = 0.0
            unit[k] = scale * sigma[k]
            quat.transform_into(q, unit, column)
            for i in range(3):
                for j in range(3):
                    p[i, j] += column[i] * column[j]


@kernel
def transition(rotation, dt, phi):
    """Write the transition (6, 6) of the error over a step in which c rotates by ``rotation`` (3,), rad.

    ``theta' = A(rotation) theta - dt J drift error`` with ``J = I - [rotation]x / 2`` up to second order.
    """
    q = stack.vector(4)
    quat.from_rotation_vector_into(rotation, q)
    _transition_of(q, rotation, dt, phi)


@kernel
def _transition_of(q, rotation, dt, phi):
    """Write ``transition`` of ``rotation``, whose quaternion is ``q`` (4,)."""
    a = stack.matrix(3, 3)
    quat.to_matrix_into(q, a)
    fill_matrix(phi, 0.0)
    for i in range(3):
        phi[3 + i, 3 + i] = 1.0
        phi[i, 3 + i] = -dt
        for j in range(3):
            phi[i, j] = a[i, j]
    phi[0, 4] = -0.5 * dt * rotation[2]
    phi[0, 5] = 0.5 * dt * rotation[1]
    phi[1, 3] = 0.5 * dt * rotation[2]
    phi[1, 5] = -0.5 * dt * rotation[0]
    phi[2, 3] = -0.5 * dt * rotation[1]
    phi[2, 4] = 0.5 * dt * rotation[0]


@kernel
def predict(params, state, measured_rate, hill):
    """Carry the state over one step with the gyro's sample ``measured_rate`` (3,), rad/s, in c (eq. (3)).

    hill: motion of H over the step, HILL_STEP.
    """
    predict_state(params, state, measured_rate, hill)
    predict_covariance(params, state)


@kernel
def predict_state(params, state, measured_rate, hill):
    """Carry the state, without its covariance, over one step; ``state.phi`` is then the transition of its error.

    Arguments as of ``predict``. The quaternion moves by the exact rotation at a constant rate over the step, of c and
    of H.
    """
    dt = params.dt_s
    rotation, hill_rotation = stack.vector(3), stack.vector(3)
    q, of_c, of_h, moved = stack.vector(4), stack.vector(4), stack.vector(4), stack.vector(4)
    for i in range(3):
        hill_rotation[i] = 0.0
        rotation[i] = (measured_rate[i] - state.x[4 + i]) * dt
    hill_rotation[1] = hill.turn  # minus the rotation of H, about -y
    if hill.rotates != 0:
        for i in range(3):
            hill_rotation[i] = -hill.rotation[i]
    quat.from_rotation_vector_into(rotation, of_c)
    quat.from_rotation_vector_into(hill_rotation, of_h)
    quat.multiply_into(state.x[0:4], of_h, moved)
    quat.multiply_into(of_c, moved, q)
    quat.normalise(q)
    copy_into(state.x[0:4], q)
    _transition_of(of_c, rotation, dt, state.phi)
    # the second column of A(q)
    along_y = stack.vector(3)
    quat.second_column_into(q, along_y)
    for i in range(3):
        state.w_CH_C[i] = (measured_rate[i] - state.x[4 + i]) + along_y[i] * hill.rate
    if hill.rotates != 0:
        quat.transform_into(q, hill.rate_after, along_y)
        for i in range(3):
            state.w_CH_C[i] -= along_y[i]
    state.nis = np.nan


@kernel
def predict_covariance(params, state):
    """Carry the covariance over the step of ``predict_state``: ``phi p phi.T`` and noise; below, phi is ``[0 I]``."""
    p, f = state.p, state.phi
    rows = stack.matrix(3, 6)
    for i in range(3):
        for j in range(6):
            rotation = f[i, 0] * p[0, j] + f[i, 1] * p[1, j] + f[i, 2] * p[2, j]
            rows[i, j] = rotation + (f[i, 3] * p[3, j] + f[i, 4] * p[4, j] + f[i, 5] * p[5, j])
    for i in range(3):
        for j in range(i, 3):
            rotation = f[j, 0] * rows[i, 0] + f[j, 1] * rows[i, 1] + f[j, 2] * rows[i, 2]
            total = rotation + (f[j, 3] * rows[i, 3] + f[j, 4] * rows[i, 4] + f[j, 5] * rows[i, 5])
            p[i, j] = total
            p[j, i] = total
        for j in range(3, 6):
            p[i, j] = rows[i, j]
            p[j, i] = rows[i, j]
    gyro = (params.dt_s * params.sigma_gyro) ** 2
    drift = (params.dt_s * params.sigma_drift) ** 2
    for i in range(3):
        p[i, i] += gyro
        p[3 + i, 3 + i] += drift
    add_in_chaser_axes(params.rate_noise, params.dt_s, state.x[0:4], p[3:6, 3:6])


@kernel
def innovate(state, q_measured, covariance, gain, out):
    """Write the innovation (3,), a small-angle rotation in rad, and the gain (6, 3); return the NIS.

    It is nan if the covariance of the innovation is not positive definite.
    """
    rotation, h, s_inverse = stack.vector(3), stack.matrix(3, 6), stack.matrix(3, 3)
    quat.rotation_between(q_measured, state.x[0:4], rotation)
    fill_matrix(h, 0.0)
    for i in range(3):
        h[i, i] = 1.0
        out[i] = rotation[i]
    nis = 0.0 if gain_of_three(state.p, h, covariance, gain, s_inverse) else np.nan
    for i in range(3):
        for j in range(3):
            nis += out[i] * s_inverse[i, j] * out[j]
    return nis


@kernel
def update(state, covariance, gain, innovation):
    """Fuse an accepted innovation; ``state.keep`` is for the filters that are correlated with this one."""
    correction, q, aside = stack.vector(6), stack.vector(4), stack.vector(4)
    h = stack.matrix(3, 6)
    fill_matrix(h, 0.0)
    for i in range(3):
        h[i, i] = 1.0
    for i in range(6):
        correction[i] = 0.0
        for j in range(3):
            correction[i] += gain[i, j] * innovation[j]
            state.keep[i, j] = -gain[i, j]
            state.keep[i, 3 + j] = 0.0
        state.keep[i, i] += 1.0
    quat.from_rotation_vector_into(correction, aside)
    quat.multiply_into(aside, state.x[0:4], q)
    quat.normalise(q)
    copy_into(state.x[0:4], q)
    for i in range(3):
        state.x[4 + i] += correction[3 + i]
    joseph(state.p, h, covariance, gain)


@kernel
def error(state, q_true, drift_true, out):
    """Write the error (6,): small-angle rotation from estimated to true c, rad, and true minus estimated drift."""
    rotation = stack.vector(3)
    quat.rotation_between(q_true, state.x[0:4], rotation)
    for i in range(3):
        out[i] = rotation[i]
        out[3 + i] = drift_true[i] - state.x[4 + i]
