"""The attitude Kalman filter: quaternion and gyro drift, with the error as a small turn of c.

The states are those of bench paper eq. (4). Their error is taken with six components, not seven: the
small turn ``theta`` from the estimated to the true c (``q_true = from_rotation_vector(theta) q_est``) and the
drift error. The quaternion then stays a unit one and its covariance has no direction that means nothing
(Lefferts, Markley and Shuster 1982). ``hil.gnc.akf_additive`` has the filter as printed.
"""

from __future__ import annotations

import numpy as np

from hil.maths import local, quat
from hil.maths.arrays import copy_into, fill_matrix
from hil.maths.jit import kernel
from hil.maths.kalman import gain_of_three, joseph, propagate_covariance

AKF_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("orbit_rate", "f8"),  # rad/s
        ("sigma_gyro", "f8"),  # rad/s a sample
        ("sigma_drift", "f8"),  # rad/s^2, eq. (7): drift[k+1] = drift[k] + dt * w
        ("initial_drift", "f8", 3),  # rad/s
        ("initial_drift_sigma", "f8"),  # rad/s
        ("gate", "f8"),  # largest NIS that is let in
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


@kernel
def transition(turn, dt, phi):
    """Write the transition (6, 6) of the error over a step in which c turned by ``turn`` (3,), rad.

    ``theta' = A(turn) theta - dt J drift error`` with ``J = I - [turn]x / 2`` up to second order.
    """
    q, a = local.vector(4), local.matrix(3, 3)
    quat.from_rotation_vector_into(turn, q)
    quat.to_matrix_into(q, a)
    fill_matrix(phi, 0.0)
    for i in range(3):
        phi[3 + i, 3 + i] = 1.0
        phi[i, 3 + i] = -dt
        for j in range(3):
            phi[i, j] = a[i, j]
    phi[0, 4] = -0.5 * dt * turn[2]
    phi[0, 5] = 0.5 * dt * turn[1]
    phi[1, 3] = 0.5 * dt * turn[2]
    phi[1, 5] = -0.5 * dt * turn[0]
    phi[2, 3] = -0.5 * dt * turn[1]
    phi[2, 4] = 0.5 * dt * turn[0]


@kernel
def predict(params, state, measured_rate):
    """Carry the state over one step with the gyro's sample ``measured_rate`` (3,), rad/s, in c (eq. (3)).

    The quaternion moves by the exact turn of a constant rate over the step, of c and of H.
    """
    dt = params.dt_s
    turn, hill_turn, a = local.vector(3), local.vector(3), local.matrix(3, 3)
    q, of_c, of_h, moved = local.vector(4), local.vector(4), local.vector(4), local.vector(4)
    for i in range(3):
        hill_turn[i] = 0.0
        turn[i] = (measured_rate[i] - state.x[4 + i]) * dt
    hill_turn[1] = params.orbit_rate * dt  # minus the turn of H, which is -w0 dt about y
    quat.from_rotation_vector_into(turn, of_c)
    quat.from_rotation_vector_into(hill_turn, of_h)
    quat.multiply_into(state.x[0:4], of_h, moved)
    quat.multiply_into(of_c, moved, q)
    quat.normalise(q)
    copy_into(state.x[0:4], q)
    transition(turn, dt, state.phi)
    noise = local.matrix(6, 6)
    fill_matrix(noise, 0.0)
    for i in range(3):
        noise[i, i] = (dt * params.sigma_gyro) ** 2
        noise[3 + i, 3 + i] = (dt * params.sigma_drift) ** 2
    propagate_covariance(state.p, state.phi, noise)
    quat.to_matrix_into(q, a)
    for i in range(3):
        state.w_CH_C[i] = turn[i] / dt + a[i, 1] * params.orbit_rate
    state.nis = np.nan


@kernel
def innovate(state, q_measured, covariance, gain, out):
    """Write the innovation (3,), a small turn in rad, and the gain (6, 3); return the NIS. Nothing is changed."""
    turn, h, s_inverse = local.vector(3), local.matrix(3, 6), local.matrix(3, 3)
    quat.turn_between(q_measured, state.x[0:4], turn)
    fill_matrix(h, 0.0)
    for i in range(3):
        h[i, i] = 1.0
        out[i] = turn[i]
    gain_of_three(state.p, h, covariance, gain, s_inverse)
    nis = 0.0
    for i in range(3):
        for j in range(3):
            nis += out[i] * s_inverse[i, j] * out[j]
    return nis


@kernel
def update(state, covariance, gain, innovation):
    """Fuse an innovation that was let in; ``state.keep`` is left for whoever is correlated with this filter."""
    correction, q, aside = local.vector(6), local.vector(4), local.vector(4)
    h = local.matrix(3, 6)
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
    """Write the error (6,): small turn from the estimated to the true c, rad, and true minus estimated drift."""
    turn = local.vector(3)
    quat.turn_between(q_true, state.x[0:4], turn)
    for i in range(3):
        out[i] = turn[i]
        out[3 + i] = drift_true[i] - state.x[4 + i]
