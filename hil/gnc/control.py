"""Position and attitude control that ends in on/off demands: a phase plane for each of six axes.

The switching function of an axis is

    s = e + tau * e_dot + e_dot |e_dot| / (2 a)

with the error ``e``, its rate, a lead time ``tau`` and the acceleration ``a`` that the axis has. Its
last term is the parabola on which a full-thrust braking ends at rest, so large errors are taken with
one burst each way; ``tau`` damps and leads lag and noise. Inside the dead band nothing fires.

An axis decides once a period. Outside the dead band it then fires against s for as long as takes s
to zero, ``|s| / (tau a)``, at least one cycle and at most the period. With a period of one cycle, for
rates that are known without lag, that is plain switching; where rates come late, a period longer
than their lag keeps the axis from firing again before it can see what it did.
"""

from __future__ import annotations

import numpy as np

from hil.maths import quat
from hil.maths.arrays import fill
from hil.maths.jit import kernel

CONTROL_PARAMS = np.dtype(
    [
        ("position_deadband", "f8"),  # m
        ("position_lead", "f8"),  # s
        ("attitude_deadband", "f8"),  # rad
        ("attitude_lead", "f8"),  # s
        ("dt_s", "f8"),
        ("position_period", "i8"),  # cycles
        ("attitude_period", "i8"),  # cycles
        ("acceleration", "f8", 3),  # m/s^2 of a force demand along x, y, z
        ("angular_acceleration", "f8", 3),  # rad/s^2 of a torque demand about x, y, z
    ],
    align=True,
)


@kernel
def burn(error, rate, acceleration, deadband, lead, period, dt):
    """Return how many cycles to fire, at most ``period``, negative against a positive s; 0 in the dead band."""
    s = error + lead * rate + rate * abs(rate) / (2.0 * acceleration)
    if abs(s) <= deadband:
        return 0
    cycles = min(period, max(1, int(abs(s) / (lead * acceleration * dt))))
    return -cycles if s > 0.0 else cycles


@kernel
def _decide(axis, error, rate, acceleration, deadband, lead, period, dt, command):
    """Keep up one of the six axes: go on with what it does, or decide anew when its period is over."""
    if command.until_decision[axis] <= 0:
        command.cycles_left[axis] = burn(error, rate, acceleration, deadband, lead, period, dt)
        command.until_decision[axis] = period
    command.until_decision[axis] -= 1
    left = command.cycles_left[axis]
    demand = 0
    if left > 0:
        demand = 1
    elif left < 0:
        demand = -1
    command.cycles_left[axis] -= demand
    if axis < 3:
        command.force[axis] = demand
    else:
        command.torque[axis - 3] = demand


@kernel
def control(params, navigation, reference, command):
    """Write the six demands of ``command`` (COMMAND), which holds what the axes are about.

    navigation: NAVIGATION; while it is not valid nothing is demanded. reference: REFERENCE.
    """
    if navigation.valid == 0:
        fill(command.force, 0)
        fill(command.torque, 0)
        fill(command.cycles_left, 0)
        fill(command.until_decision, 0)
        return
    error_h = np.empty(3)
    rate_h = np.empty(3)
    for i in range(3):
        error_h[i] = navigation.r_CT_H[i] - reference.r_CT_H[i]
        rate_h[i] = navigation.v_CT_H[i] - reference.v_CT_H[i]
    error_c = quat.transform(navigation.q_CH, error_h)
    rate_c = quat.transform(navigation.q_CH, rate_h)
    turn = quat.to_rotation_vector(quat.multiply(navigation.q_CH, quat.conjugate(reference.q_CH)))
    for i in range(3):
        _decide(
            i,
            error_c[i],
            rate_c[i],
            params.acceleration[i],
            params.position_deadband,
            params.position_lead,
            params.position_period,
            params.dt_s,
            command,
        )
        _decide(
            3 + i,
            turn[i],
            navigation.w_CH_C[i],
            params.angular_acceleration[i],
            params.attitude_deadband,
            params.attitude_lead,
            params.attitude_period,
            params.dt_s,
            command,
        )
