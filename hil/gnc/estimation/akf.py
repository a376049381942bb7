"""The attitude Kalman filter: quaternion and gyro drift, with the error as a small-angle rotation of c.

The states are those of bench paper eq. (4). Their error has six components, not seven: the small-angle
rotation ``theta`` from the estimated to the true c (``q_true = from_rotation_vector(theta) q_est``) and the
drift error. The quaternion keeps unit length and its covariance has no redundant direction
(Lefferts, Markley and Shuster 1982). Its error is a block of the joint error state,
``hil.gnc.estimation.error_state``, which has the covariance.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill_matrix

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
        ("w_CH_C", "f8", 3),  # rad/s
    ],
    align=True,
)


@kernel
def start(params, q_CH, state):
    """Start from a measured attitude (4,), the drift from ``params``."""
    copy_into(state.x[0:4], q_CH)
    for i in range(3):
        state.x[4 + i] = params.initial_drift[i]
        state.w_CH_C[i] = 0.0


@kernel
def add_in_chaser_axes(sigma, scale, q, first, p):
    """Add ``A(q) diag((scale sigma)^2) A(q)^T`` to the block of ``p`` from index ``first`` on; sigma: (3,), in H."""
    unit, column = stack.vector(3), stack.vector(3)
    for k in range(3):
        if sigma[k] != 0.0:
            for i in range(3):
                unit[i] = 0.0
            unit[k] = scale * sigma[k]
            quat.transform_into(q, unit, column)
            for i in range(3):
                for j in range(3):
                    p[first + i, first + j] += column[i] * column[j]


@kernel
def transition(rotation, dt, phi):
    """Write the transition (3, 6) of ``theta`` over a step in which c rotates by ``rotation`` (3,), rad.

    ``theta' = A(rotation) theta - dt J drift error`` with ``J = I - [rotation]x / 2`` up to second order. The drift
    is constant.
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
def predict_state(params, state, measured_rate, hill, phi):
    """Carry the state over one step with the gyro's sample ``measured_rate`` (3,), rad/s, in c (eq. (3)).

    hill: motion of H over the step, HILL_STEP. phi: (3, 6), for the ``transition`` of its error. The quaternion moves
    by the exact rotation at a constant rate over the step, of c and of H.
    """
    dt = params.dt_s
    rotation, hill_rotation = stack.vector(3), stack.vector(3)
    q, of_c, of_h, moved = stack.vector(4), stack.vector(4), stack.vector(4), stack.vector(4)
    for i in range(3):
        hill_rotation[i] = 0.0
        rotation[i] = (measured_rate[i] - state.x[4 + i]) * dt
    hill_rotation[1] = hill.turn  # minus the rotation of H, about -y
    if hill.swings != 0:
        for i in range(3):
            hill_rotation[i] -= hill.rotation[i]
    quat.from_rotation_vector_into(rotation, of_c)
    quat.from_rotation_vector_into(hill_rotation, of_h)
    quat.multiply_into(state.x[0:4], of_h, moved)
    quat.multiply_into(of_c, moved, q)
    quat.normalise(q)
    copy_into(state.x[0:4], q)
    _transition_of(of_c, rotation, dt, phi)
    # the second column of A(q)
    along_y = stack.vector(3)
    quat.second_column_into(q, along_y)
    for i in range(3):
        state.w_CH_C[i] = (measured_rate[i] - state.x[4 + i]) + along_y[i] * hill.rate
    if hill.swings != 0:
        quat.transform_into(q, hill.rate_after, along_y)
        for i in range(3):
            state.w_CH_C[i] -= along_y[i]


@kernel
def correct(state, correction):
    """Correct attitude and drift by ``correction`` (6,) of their errors."""
    q, aside = stack.vector(4), stack.vector(4)
    quat.from_rotation_vector_into(correction, aside)
    quat.multiply_into(aside, state.x[0:4], q)
    quat.normalise(q)
    copy_into(state.x[0:4], q)
    for i in range(3):
        state.x[4 + i] += correction[3 + i]


@kernel
def error(state, q_true, drift_true, out):
    """Write the error (6,): small-angle rotation from estimated to true c, rad, and true minus estimated drift."""
    rotation = stack.vector(3)
    quat.rotation_between(q_true, state.x[0:4], rotation)
    for i in range(3):
        out[i] = rotation[i]
        out[3 + i] = drift_true[i] - state.x[4 + i]
