"""Observer with fixed gains as a backend of navigation: the IMU integrated, each pose corrects a fixed fraction.

hil run scheme-1 --set 'gnc.navigation.backend="examples/backends/observer.py:observer"'

observer.c is the same in C, with the same bits.
"""

import math

import numpy as np
from numba import njit

import hil

SETTINGS = (
    hil.Setting("position_gain", 0.04, "1", 0.0, 1.0, "fraction of a pose's position error that is corrected"),
    hil.Setting("velocity_gain_per_s", 0.003, "1/s", 0.0, 5.0, "of it that corrects the velocity"),
    hil.Setting("bias_gain_per_s2", 0.0001, "1/s^2", 0.0, 1.0, "of it that corrects the accelerometer's bias"),
    hil.Setting("attitude_gain", 0.01, "1", 0.0, 1.0, "fraction of a pose's attitude error that is corrected"),
)
MEMORY = [("started", "i8"), ("r", "f8", 3), ("v", "f8", 3), ("q", "f8", 4), ("w", "f8", 3), ("bias", "f8", 3)]


@njit
def to_matrix(q, a):
    """Write A(q), from H to c, into ``a`` (3, 3)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    a[0, 0], a[0, 1], a[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)
    a[1, 0], a[1, 1], a[1, 2] = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)
    a[2, 0], a[2, 1], a[2, 2] = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)


@njit
def turn(q, e):
    """Turn the frame of ``q`` by the small angles ``e`` (3,), rad."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    a, b, c = 0.5 * e[0], 0.5 * e[1], 0.5 * e[2]
    q[0] = x + (w * a - z * b + y * c)
    q[1] = y + (z * a + w * b - x * c)
    q[2] = z + (-y * a + x * b + w * c)
    q[3] = w - (x * a + y * b + z * c)
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] /= length


@hil.kernel_backend(settings=SETTINGS, memory=MEMORY)
def observer(settings, inp, out, memory):
    """Write the estimate of one cycle."""
    m, n, a = memory, inp.setup.mean_motion_radps, np.empty((3, 3))
    e, f = np.empty(3), np.empty(3)
    for k in range(inp.n_samples if m.started != 0 else 0):
        dt = inp.setup.step_s / inp.n_samples
        to_matrix(m.q, a)
        for i in range(3):
            f[i] = inp.samples[k].force_mps2[i] - m.bias[i]
            m.w[i] = inp.samples[k].rate_radps[i] + n * a[i, 1]
            e[i] = dt * m.w[i]
        for i in range(3):
            m.r[i] += dt * m.v[i]
            m.v[i] += dt * (a[0, i] * f[0] + a[1, i] * f[1] + a[2, i] * f[2])
        m.v[0] += dt * (2.0 * n * m.v[2])
        m.v[1] += dt * (-n * n * m.r[1])
        m.v[2] += dt * (3.0 * n * n * m.r[2] - 2.0 * n * m.v[0])
        turn(m.q, e)
    for k in range(inp.n_poses):
        pose = inp.poses[k]
        if m.started == 0:
            m.started = 1
            for i in range(4):
                m.q[i] = pose.q_CH[i]
            to_matrix(m.q, a)
            for i in range(3):
                z = pose.r_TC_C_m
                m.r[i] = -(a[0, i] * z[0] + a[1, i] * z[1] + a[2, i] * z[2])
                m.bias[i] = 3e-4
        to_matrix(pose.q_CH, a)
        for i in range(3):
            z = pose.r_TC_C_m
            e[i] = -(a[0, i] * z[0] + a[1, i] * z[1] + a[2, i] * z[2]) - m.r[i]
        for i in range(3):
            m.r[i] += settings.position_gain * e[i]
            m.v[i] += settings.velocity_gain_per_s * e[i]
            m.bias[i] -= settings.bias_gain_per_s2 * (a[i, 0] * e[0] + a[i, 1] * e[1] + a[i, 2] * e[2])
        p, q = pose.q_CH, m.q
        side = 2.0 if p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3] >= 0.0 else -2.0
        for i in range(3):
            j, k3 = (i + 1) % 3, (i + 2) % 3
            e[i] = side * settings.attitude_gain * (q[3] * p[i] - p[3] * q[i] + p[j] * q[k3] - p[k3] * q[j])
        turn(m.q, e)
    out.valid = m.started
    for i in range(3):
        out.r_CT_H[i], out.v_CT_H[i], out.w_CH_C[i] = m.r[i], m.v[i], m.w[i]
        out.sigma_r_m[i], out.sigma_v_mps[i] = 0.0015, 0.0007
        out.bias_mps2[i], out.bias_sigma_mps2[i] = m.bias[i], 1e-3
    for i in range(4):
        out.q_CH[i] = m.q[i]
