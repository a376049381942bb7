"""The position Kalman filter: nine states, relative position and velocity in H, accelerometer bias in c.

Bench paper eq. (11) to (16), with ``H = [-R_CH 0 0]`` (the printed "R_c^c" and transpose are
misprints). The transition of Hill's equations is exact; the accelerometer's sample is the mean over
the step, so its noise and the bias act through the same response as the thrust.
"""

from __future__ import annotations

import math

import numpy as np

from hil.maths import quat
from hil.maths.arrays import fill_matrix
from hil.maths.jit import kernel
from hil.maths.kalman import propagate_covariance, update_three

PKF_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("hill_transition", "f8", (6, 6)),  # of [r, v] over one step
        ("hill_response", "f8", (6, 3)),  # to a constant acceleration in H
        ("sigma_accelerometer", "f8"),  # m/s^2 a sample
        ("sigma_bias", "f8"),  # m/s^3, eq. (15): bias[k+1] = bias[k] + dt * w
        ("initial_velocity_sigma", "f8"),  # m/s
        ("initial_bias", "f8", 3),  # m/s^2
        ("initial_bias_sigma", "f8"),  # m/s^2
    ],
    align=True,
)

PKF_STATE = np.dtype(
    [
        ("x", "f8", 9),
        ("p", "f8", (9, 9)),
        ("nis", "f8"),
    ],
    align=True,
)


@kernel
def start(params, pose, state):
    """Start from the first pose, at rest, the bias from ``params``."""
    fill_matrix(state.p, 0.0)
    state.nis = np.nan
    r = quat.transform_back(pose.q_CH, pose.z_TC_C)
    a = quat.to_matrix(pose.q_CH)
    for i in range(3):
        state.x[i] = -r[i]
        state.x[3 + i] = 0.0
        state.x[6 + i] = params.initial_bias[i]
        state.p[3 + i, 3 + i] = params.initial_velocity_sigma**2
        state.p[6 + i, 6 + i] = params.initial_bias_sigma**2
        for j in range(3):
            for m in range(3):
                for n in range(3):
                    state.p[i, j] += a[m, i] * pose.covariance_position[m, n] * a[n, j]


@kernel
def transition(params, q_CH, phi):
    """Write the transition matrix ``phi`` (9, 9) for the attitude in mid-step ``q_CH``."""
    a = quat.to_matrix(q_CH)
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
def predict(params, state, measured_force, q_CH):
    """Carry the state over one step.

    measured_force: accelerometer's sample (3,), m/s^2, in c. q_CH: attitude in mid-step.
    """
    phi = np.empty((9, 9))
    transition(params, q_CH, phi)
    # phi's bias columns are minus the response to a force in c
    x = np.zeros(9)
    for i in range(9):
        for j in range(9):
            x[i] += phi[i, j] * state.x[j]
        if i < 6:
            for j in range(3):
                x[i] -= phi[i, 6 + j] * measured_force[j]
    noise = np.zeros((9, 9))
    accelerometer = params.sigma_accelerometer**2
    for i in range(6):
        for j in range(6):
            for m in range(3):
                noise[i, j] += accelerometer * phi[i, 6 + m] * phi[j, 6 + m]
    for i in range(3):
        noise[6 + i, 6 + i] = (params.dt_s * params.sigma_bias) ** 2
    propagate_covariance(state.p, phi, noise)
    for i in range(9):
        state.x[i] = x[i]
    state.nis = np.nan


@kernel
def update(state, pose, q_CH, attitude_covariance):
    """Fuse the position of ``pose`` (POSE), measured in c.

    q_CH: estimated attitude. attitude_covariance: (3, 3), rad^2, of its small turn: at a distance it
    moves the expected position by ``turn x r`` and so adds to the measurement's covariance.
    """
    expected = quat.transform(q_CH, state.x[0:3])
    a = quat.to_matrix(q_CH)
    arm = np.zeros((3, 3))
    arm[0, 1], arm[0, 2] = -expected[2], expected[1]
    arm[1, 0], arm[1, 2] = expected[2], -expected[0]
    arm[2, 0], arm[2, 1] = -expected[1], expected[0]
    h = np.zeros((3, 9))
    r = np.empty((3, 3))
    innovation = np.empty(3)
    for i in range(3):
        innovation[i] = pose.z_TC_C[i] + expected[i]
        for j in range(3):
            h[i, j] = -a[i, j]
            r[i, j] = pose.covariance_position[i, j]
            for m in range(3):
                for n in range(3):
                    r[i, j] += arm[i, m] * attitude_covariance[m, n] * arm[j, n]
    state.nis = update_three(state.x, state.p, h, r, innovation)


@kernel
def sigma(state, first, out):
    """Write the standard deviations of three states from index ``first`` on."""
    for i in range(3):
        out[i] = math.sqrt(max(0.0, state.p[first + i, first + i]))
