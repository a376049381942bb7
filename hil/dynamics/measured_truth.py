"""Rates of a vehicle by its measured poses: the slopes of least squares lines."""

from __future__ import annotations

from hil.core.jit import entry
from hil.maths import quat, stack
from hil.maths.arrays import fill


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
