"""Attitude of a target that moves against its Hill frame: torque-free tumble, or limit cycle of its own control.

The relative motion of such a target is that in its body axes, which take the place of the Hill frame: ``q_HI`` and
``w_HI_H`` of the truth are those of the body. docs/explanation/moving-targets.md
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, quat, stack
from hil.maths.arrays import copy_into
from hil.models.rotating_frame import euler_acceleration

ALIGNED, TUMBLE, LIMIT_CYCLE = range(3)

TARGET_ATTITUDE = np.dtype(
    [
        ("motion", "i8"),  # ALIGNED with the Hill frame, TUMBLE or LIMIT_CYCLE
        ("moments", "f8", 3),  # kg m^2, principal
        ("q_PB", "f8", 4),  # from body to principal axes
        # limit cycle about each axis of H
        ("amplitude", "f8", 3),  # rad
        ("rate", "f8", 3),  # rad/s, between two reversals
        ("acceleration", "f8", 3),  # rad/s^2, of a reversal
        ("phase", "f8", 3),  # at the start of the run, in cycles
    ],
    align=True,
)

_SMALL: Final = 1e-6  # rad^2


@kernel
def _tumble_derivative(moments, y, dy):
    quat.rate_of_change(y[0:4], y[4:7], dy[0:4])
    euler_acceleration(moments, y[4:7], dy[4:7])


@kernel
def tumble(params, dt, q_BI, w_BI_B):
    """Move attitude (4,) and rate (3,), rad/s, of a free body on by ``dt``, in place: one Runge-Kutta step."""
    y, k, trial, total = stack.vector(7), stack.vector(7), stack.vector(7), stack.vector(7)
    back = stack.vector(4)
    quat.multiply_into(params.q_PB, q_BI, y[0:4])
    quat.transform_into(params.q_PB, w_BI_B, y[4:7])
    copy_into(trial, y)
    copy_into(total, y)
    for stage in range(4):
        _tumble_derivative(params.moments, trial, k)
        weight = dt / 6.0 if stage == 0 or stage == 3 else dt / 3.0
        part = dt if stage == 2 else 0.5 * dt
        for i in range(7):
            total[i] += weight * k[i]
            trial[i] = y[i] + part * k[i]
    quat.normalise(total[0:4])
    quat.conjugate_into(params.q_PB, back)
    quat.multiply_into(back, total[0:4], q_BI)
    quat.transform_into(back, total[4:7], w_BI_B)


@kernel
def limit_cycle(amplitude, rate, acceleration, phase, t_s, out):
    """Write angle, rad, and rate, rad/s, of one axis at ``t_s`` into ``out`` (2,).

    The angle drifts at ``rate`` from one end to the other, where a burn of ``acceleration`` reverses it.
    """
    out[0] = out[1] = 0.0
    if amplitude == 0.0 or rate == 0.0:
        return
    reversal = rate / acceleration  # half of its duration
    quarter = (amplitude - 0.5 * rate * reversal) / rate  # drift from the centre to the start of a reversal
    period = 4.0 * (quarter + reversal)
    t = (t_s / period + phase) % 1.0 * period
    sign = 1.0
    if t > 0.5 * period:
        t -= 0.5 * period
        sign = -1.0
    # from the centre upwards, the reversal at the top, and back to the centre
    if t < quarter:
        out[0], out[1] = sign * rate * t, sign * rate
    elif t < quarter + 2.0 * reversal:
        late = t - quarter - reversal
        out[0] = sign * (amplitude - 0.5 * acceleration * late * late)
        out[1] = -sign * acceleration * late
    else:
        out[0], out[1] = sign * rate * (0.5 * period - t), -sign * rate


@kernel
def add_limit_cycle(params, t_s, q_HI, w_HI_H):
    """Rotate attitude (4,) and rate (3,) of the Hill frame at ``t_s`` into the body's, in place."""
    angle, speed, axis = stack.vector(3), stack.vector(3), stack.vector(2)
    for i in range(3):
        limit_cycle(params.amplitude[i], params.rate[i], params.acceleration[i], params.phase[i], t_s, axis)
        angle[i], speed[i] = axis[0], axis[1]
    q, moved = stack.vector(4), stack.vector(4)
    quat.from_rotation_vector_into(angle, q)
    quat.multiply_into(q, q_HI, moved)
    copy_into(q_HI, moved)
    quat.transform_into(q, w_HI_H, w_HI_H)
    # w = J p' of a rotation vector p: J = I - (1 - cos p)/p^2 [p]x + (p - sin p)/p^3 [p]x^2
    square = angle[0] * angle[0] + angle[1] * angle[1] + angle[2] * angle[2]
    if square < _SMALL:
        first, second = 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        size = math.sqrt(square)
        first, second = (1.0 - elementary.cos(size)) / square, (size - elementary.sin(size)) / (square * size)
    product = angle[0] * speed[0] + angle[1] * speed[1] + angle[2] * speed[2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        crossed = angle[j] * speed[k] - angle[k] * speed[j]
        w_HI_H[i] += speed[i] - first * crossed + second * (angle[i] * product - square * speed[i])


@kernel
def move_target_axes(params, dt, t_s, truth, q_hill, w_hill):
    """Write attitude (4,) and rate (3,) of the target's axes at ``t_s``, the end of a step of ``dt``.

    truth: TRUTH, with the attitude of these axes at its start. q_hill, w_hill: those of the Hill frame at the end, in
    place.
    """
    if params.motion == TUMBLE:
        copy_into(q_hill, truth.q_HI)
        copy_into(w_hill, truth.w_HI_H)
        tumble(params, dt, q_hill, w_hill)
    elif params.motion == LIMIT_CYCLE:
        add_limit_cycle(params, t_s, q_hill, w_hill)
