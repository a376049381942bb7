"""Position Kalman filter: nine states, relative position and velocity in H, accelerometer bias in c.

Bench paper eq. (11) to (16), with ``H = [-R_CH 0 0]`` (the printed "R_c^c" and transpose are misprints).
The transition of Hill's equations is exact; the accelerometer's sample is the mean over the step, so
its noise and the bias act through the same response as the thrust. On an ellipse the state also has the difference
from Hill's equations (``hil.gnc.estimation.target_orbit``); the covariance does without it: at e = 0.1 its standard
deviations are wrong by less than a hundredth after minutes without a pose.

The attitude that takes accelerations and poses between c and H is an estimate, and its error persists from
frame to frame: at 10 m a hundredth of a degree is 2 mm. Its gain therefore takes the correlation with the attitude
filter's error into account, which it does not correct (Schmidt 1966: considered, not estimated). Its error is a block
of the joint error state, ``hil.gnc.estimation.error_state``, which has the covariance.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.gnc.estimation.target_orbit import add_ellipse
from hil.maths import stack
from hil.maths.arrays import copy_into

PKF_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("hill_transition", "f8", (6, 6)),  # transition of [r, v] over one step
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

PKF_STATE = np.dtype([("x", "f8", 9)], align=True)
"""x: relative position, m, and velocity, m/s, in H, accelerometer bias, m/s^2, in c."""


@kernel
def start(params, r_CT_H, state):
    """Start from a measured position (3,), m, in H, at rest, the bias from ``params``."""
    for i in range(3):
        state.x[i] = r_CT_H[i]
        state.x[3 + i] = 0.0
        state.x[6 + i] = params.initial_bias[i]


@kernel
def predict_state(params, state, force, a, hill):
    """Carry the state over one step.

    force: specific force (3,), m/s^2, in c, without the bias. a: A(q_CH) (3, 3) in mid-step. hill: motion of H over the
    step, HILL_STEP.
    """
    x = stack.vector(6)
    h, g = params.hill_transition, params.hill_response
    f0, f1, f2 = force[0], force[1], force[2]
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
