"""Position Kalman filter: nine states, relative position and velocity in H, accelerometer bias in c.

Bench paper eq. (11) to (16), with ``H = [-R_CH 0 0]`` (the printed "R_c^c" and transpose are misprints).
The transition of Hill's equations is exact; the accelerometer's sample is the mean over the step, so
its noise and the bias act through the same response as the thrust. On an ellipse the state also has the difference
from Hill's equations (``hil.gnc.target_orbit``); the covariance does without it: at e = 0.1 its standard deviations
are wrong by less than a hundredth after minutes without a pose.

The attitude that takes accelerations and poses between c and H is an estimate, and its error persists from
frame to frame: at 10 m a hundredth of a degree is 2 mm. This filter therefore carries its correlation
with the attitude filter's error (Schmidt 1966: considered, not estimated).
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.gnc import joint_covariance
from hil.gnc.target_orbit import add_ellipse
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, copy_matrix, fill_matrix
from hil.maths.kalman import invert_symmetric_3

PKF_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("hill_transition", "f8", (6, 6)),  # of [r, v] over one step
        ("hill_response", "f8", (6, 3)),  # to a constant acceleration in H
        ("sigma_accelerometer", "f8"),  # m/s^2 per sample
        ("sigma_bias", "f8"),  # m/s^3, eq. (15): bias[k+1] = bias[k] + dt * w
        ("initial_velocity_sigma", "f8"),  # m/s
        ("initial_bias", "f8", 3),  # m/s^2
        ("initial_bias_sigma", "f8"),  # m/s^2
        ("gate", "f8"),  # largest NIS that is accepted
    ],
    align=True,
)

PKF_STATE = np.dtype(
    [
        ("x", "f8", 9),
        ("p", "f8", (9, 9)),
        ("c", "f8", (9, 6)),  # covariance with the attitude filter's error
        ("nis", "f8"),
    ],
    align=True,
)


@kernel
def start(params, pose, attitude_p, state):
    """Start from the first pose, at rest, the bias from ``params``; ``attitude_p`` (6, 6): the AKF's at its start.

    ``r = -A.T z``: the position's error holds the measured attitude's error over the distance.
    """
    fill_matrix(state.p, 0.0)
    fill_matrix(state.c, 0.0)
    state.nis = np.nan
    r, a, lever = stack.vector(3), stack.matrix(3, 3), stack.matrix(3, 3)
    quat.transform_back_into(pose.q_CH, pose.z_TC_C, r)
    quat.to_matrix_into(pose.q_CH, a)
    z = pose.z_TC_C
    # dr_H = -A.T (dz + theta x z): lever (3, 3) of theta
    for i in range(3):
        lever[i, 0] = -(a[1, i] * -z[2] + a[2, i] * z[1])
        lever[i, 1] = -(a[0, i] * z[2] + a[2, i] * -z[0])
        lever[i, 2] = -(a[0, i] * -z[1] + a[1, i] * z[0])
    for i in range(3):
        state.x[i] = -r[i]
        state.x[3 + i] = 0.0
        state.x[6 + i] = params.initial_bias[i]
        state.p[3 + i, 3 + i] = params.initial_velocity_sigma**2
        state.p[6 + i, 6 + i] = params.initial_bias_sigma**2
        for j in range(3):
            for m in range(3):
                state.c[i, j] += lever[i, m] * attitude_p[m, j]
                for n in range(3):
                    state.p[i, j] += a[m, i] * pose.covariance_position[m, n] * a[n, j]
                    state.p[i, j] += lever[i, m] * attitude_p[m, n] * lever[j, n]


@kernel
def transition(params, q_CH, phi):
    """Write the transition matrix ``phi`` (9, 9) for the attitude in mid-step ``q_CH``."""
    a = stack.matrix(3, 3)
    quat.to_matrix_into(q_CH, a)
    fill_matrix(phi, 0.0)
    for i in range(6):
        for j in range(6):
            phi[i, j] = params.hill_transition[i, j]
        for j in range(3):
            total = 0.0
            for m in range(3):
                total += params.hill_response[i, m] * a[j, m]
            phi[i, 6 + j] = -total
    for i in range(3):
        phi[6 + i, 6 + i] = 1.0


@kernel
def predict(params, state, measured_force, q_CH, attitude_p, attitude_phi, hill):
    """Carry the state over one step.

    measured_force: accelerometer's sample (3,), m/s^2, in c. q_CH: attitude in mid-step. attitude_p: covariance (6, 6)
    before the step of the attitude filter's error; attitude_phi: its transition over it (6, 6), whose lower rows, of
    a constant drift, are ``[0 I]``. hill: motion of H over the step, HILL_STEP.
    """
    a = stack.matrix(3, 3)
    quat.to_matrix_into(q_CH, a)
    f0, f1, f2 = predict_state(params, state, measured_force, a, hill)
    joint_covariance.propagate(params, state, a, f0, f1, f2, attitude_p, attitude_phi)


@kernel
def predict_state(params, state, measured_force, a, hill):
    """Carry the state, without its covariance, over one step; return the specific force in c, m/s^2.

    a: A(q_CH) (3, 3) in mid-step. The others as of ``predict``.
    """
    x = stack.vector(6)
    h, g = params.hill_transition, params.hill_response
    f0, f1, f2 = measured_force[0] - state.x[6], measured_force[1] - state.x[7], measured_force[2] - state.x[8]
    u0 = a[0, 0] * f0 + a[1, 0] * f1 + a[2, 0] * f2
    u1 = a[0, 1] * f0 + a[1, 1] * f1 + a[2, 1] * f2
    u2 = a[0, 2] * f0 + a[1, 2] * f1 + a[2, 2] * f2
    for i in range(6):
        x[i] = h[i, 0] * state.x[0] + h[i, 1] * state.x[1] + h[i, 2] * state.x[2]
        x[i] += h[i, 3] * state.x[3] + h[i, 4] * state.x[4] + h[i, 5] * state.x[5]
        x[i] += g[i, 0] * u0 + g[i, 1] * u1 + g[i, 2] * u2
    if hill.is_elliptic != 0:
        add_ellipse(hill, params.dt_s, state.x[0:6], x)
    copy_into(state.x[0:6], x)
    state.nis = np.nan
    return f0, f1, f2


@kernel
def follow_attitude_update(state, keep):
    """Carry ``c`` through an update of the attitude filter; keep: its ``I - K H`` (6, 6)."""
    row = stack.vector(6)
    for i in range(9):
        for j in range(6):
            total = 0.0
            for m in range(6):
                total += state.c[i, m] * keep[j, m]
            row[j] = total
        for j in range(6):
            state.c[i, j] = row[j]


@kernel
def innovate(state, z_TC_C, covariance, delta_s, q_CH, attitude_p, h, h_attitude, gain, out):
    """Write the innovation (3,), m, its matrices and the gain (9, 3); return the NIS. The state is not changed.

    The NIS is nan if the covariance of the innovation is not positive definite.
    z_TC_C: measured position (3,), in c at the filter's moment; covariance: (3, 3).
    delta_s: exposure after the filter's moment, a fraction of a step. h: (3, 9). h_attitude: (3, 3), of theta.
    """
    a, expected = stack.matrix(3, 3), stack.vector(3)
    quat.to_matrix_into(q_CH, a)
    for i in range(3):
        expected[i] = state.x[i] + delta_s * state.x[3 + i]
    quat.transform_into(q_CH, expected, expected)
    fill_matrix(h, 0.0)
    fill_matrix(h_attitude, 0.0)
    h_attitude[0, 1], h_attitude[0, 2] = expected[2], -expected[1]
    h_attitude[1, 0], h_attitude[1, 2] = -expected[2], expected[0]
    h_attitude[2, 0], h_attitude[2, 1] = expected[1], -expected[0]
    for i in range(3):
        out[i] = z_TC_C[i] + expected[i]
        for j in range(3):
            h[i, j] = -a[i, j]
            h[i, 3 + j] = -delta_s * a[i, j]
    # with[i, j]: covariance of state i with innovation j; s: of the innovation
    s, s_inverse = stack.matrix(3, 3), stack.matrix(3, 3)
    cross, cross_attitude = stack.matrix(9, 3), stack.matrix(3, 3)
    for i in range(9):
        for j in range(3):
            total = 0.0
            for m in range(6):
                total += state.p[i, m] * h[j, m]
            for m in range(3):
                total += state.c[i, m] * h_attitude[j, m]
            cross[i, j] = total
    for i in range(3):
        for j in range(3):
            total = 0.0
            for m in range(6):
                total += state.c[m, i] * h[j, m]
            for m in range(3):
                total += attitude_p[i, m] * h_attitude[j, m]
            cross_attitude[i, j] = total
    for i in range(3):
        for j in range(3):
            total = covariance[i, j]
            for m in range(6):
                total += h[i, m] * cross[m, j]
            for m in range(3):
                total += h_attitude[i, m] * cross_attitude[m, j]
            s[i, j] = total
    nis = 0.0 if invert_symmetric_3(s, s_inverse) else np.nan
    for i in range(9):
        for j in range(3):
            gain[i, j] = cross[i, 0] * s_inverse[0, j] + cross[i, 1] * s_inverse[1, j] + cross[i, 2] * s_inverse[2, j]
    for i in range(3):
        for j in range(3):
            nis += out[i] * s_inverse[i, j] * out[j]
    return nis


@kernel
def update(state, covariance, attitude_p, h, h_attitude, gain, innovation):
    """Fuse an accepted innovation: Joseph form of the joint covariance, valid for any gain.

    ``p' = L p L.T - L c T.T - T c.T L.T + T attitude_p T.T + K R K.T``, ``c' = L c - T attitude_p`` with
    ``L = I - K h``, ``T = K h_attitude``.
    """
    keep, rotation = stack.matrix(9, 9), stack.matrix(9, 3)
    fill_matrix(keep, 0.0)
    for i in range(9):
        for j in range(6):
            keep[i, j] = -(gain[i, 0] * h[0, j] + gain[i, 1] * h[1, j] + gain[i, 2] * h[2, j])
        keep[i, i] += 1.0
        for j in range(3):
            rotation[i, j] = (
                gain[i, 0] * h_attitude[0, j] + gain[i, 1] * h_attitude[1, j] + gain[i, 2] * h_attitude[2, j]
            )
            state.x[i] += gain[i, j] * innovation[j]
    mixed, half, noise = stack.matrix(9, 6), stack.matrix(9, 9), stack.matrix(9, 9)
    joint_covariance.joint_product(keep, rotation, -1.0, state.p, state.c, attitude_p, mixed, half)
    for i in range(9):
        kr0 = gain[i, 0] * covariance[0, 0] + gain[i, 1] * covariance[1, 0] + gain[i, 2] * covariance[2, 0]
        kr1 = gain[i, 0] * covariance[0, 1] + gain[i, 1] * covariance[1, 1] + gain[i, 2] * covariance[2, 1]
        kr2 = gain[i, 0] * covariance[0, 2] + gain[i, 1] * covariance[1, 2] + gain[i, 2] * covariance[2, 2]
        for j in range(9):
            noise[i, j] = kr0 * gain[j, 0] + kr1 * gain[j, 1] + kr2 * gain[j, 2]
    joint_covariance.close_product(keep, rotation, -1.0, mixed, half, noise, state.p)
    copy_matrix(state.c, mixed)  # L c - T attitude_p


@kernel
def sigma(state, first, out):
    """Write the standard deviations of three states from index ``first`` on."""
    for i in range(3):
        out[i] = math.sqrt(max(0.0, state.p[first + i, first + i]))
