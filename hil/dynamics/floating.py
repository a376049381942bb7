"""Vehicle that floats on a level floor: its motion, and its truth by measured poses."""

from __future__ import annotations

import math

from hil.core.jit import entry
from hil.dynamics.truth import hold_in_plane, step
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill


@entry
def step_on_floor(params, field, memory, truth, on, pull, friction):
    """``truth.step`` by ``params.dt_s`` and what the floor adds: a pull (3,), m/s^2, in H, and ``friction``, m/s^2."""
    step(params, field, memory, truth, on)
    dt, square = params.dt_s, 0.0
    for i in range(3):
        square += (truth.v_CT_H[i] + dt * pull[i]) ** 2
    lost = min(1.0, dt * friction / math.sqrt(square)) if square > 0.0 else 0.0
    for i in range(3):
        change = dt * pull[i] - lost * (truth.v_CT_H[i] + dt * pull[i])
        truth.r_CT_H[i] += 0.5 * dt * change
        truth.v_CT_H[i] += change


@entry
def carry_on(r_CT_H, q_CH, v_CT_H, w_CH_C, ahead_s, truth):
    """Write the pose of ``truth`` (TRUTH), in the plane, ``ahead_s`` after the measured one, and its rates.

    r_CT_H (3,), m, q_CH (4,): measured; v_CT_H (3,), m/s, w_CH_C (3,), rad/s: see ``fit_rates``.
    """
    turn, turned, w_frame = stack.vector(3), stack.vector(4), stack.vector(3)
    for i in range(3):
        truth.r_CT_H[i] = r_CT_H[i] + ahead_s * v_CT_H[i]
        truth.v_CT_H[i] = v_CT_H[i]
        turn[i] = ahead_s * w_CH_C[i]
        truth.mean_force_C[i] = 0.0
    quat.from_rotation_vector_into(turn, turned)
    quat.multiply_into(turned, q_CH, truth.q_CH)
    quat.transform_into(truth.q_CH, truth.w_HI_H, w_frame)
    for i in range(3):
        truth.w_CI_C[i] = w_CH_C[i] + w_frame[i]
    copy_into(truth.mean_rate_C, truth.w_CI_C)
    hold_in_plane(2, truth)


@entry
def fit_rates(t_s, r_CT_H, q_CH, n, v_CT_H, w_CH_C):
    """Write velocity (3,), m/s, in H, and rate (3,), rad/s, in c, of the first ``n`` poses; zero for less than two.

    t_s (N,), r_CT_H (N, 3), m, q_CH (N, 4): poses, the newest first. The attitude turns by less than half a revolution
    over them; w_CH_C is that of the newest axes c.
    """
    fill(v_CT_H, 0.0)
    fill(w_CH_C, 0.0)
    turn, mean_s, square = stack.vector(3), 0.0, 0.0
    for k in range(n):
        mean_s += (t_s[k] - t_s[0]) / n
    for k in range(n):
        x = t_s[k] - t_s[0] - mean_s
        square += x * x
        quat.rotation_between(q_CH[k], q_CH[0], turn)
        for i in range(3):
            v_CT_H[i] += x * (r_CT_H[k, i] - r_CT_H[0, i])
            w_CH_C[i] += x * turn[i]
    if square == 0.0:
        return
    for i in range(3):
        v_CT_H[i] /= square
        w_CH_C[i] /= square
