"""Position and attitude control that ends in on/off demands: a phase plane for each of six axes.

The switching function of an axis is

    s = e + tau * e_dot + e_dot |e_dot| / (2 a)

with the error ``e``, its rate, a lead time ``tau`` and the acceleration ``a`` that the axis has. Its
last term is the parabola on which a full-thrust braking ends at rest, so large errors are taken with
one burst each way; ``tau`` damps and leads lag and noise. Outside the dead band the axis is pushed
against s, until s is back within ``release`` times the dead band; inside nothing fires.
"""

from __future__ import annotations

import numpy as np

from hil.maths import quat
from hil.maths.jit import kernel

CONTROL_PARAMS = np.dtype(
    [
        ("position_deadband", "f8"),  # m
        ("position_lead", "f8"),  # s
        ("attitude_deadband", "f8"),  # rad
        ("attitude_lead", "f8"),  # s
        ("release", "f8"),  # 0..1 of the dead band
        ("acceleration", "f8", 3),  # m/s^2 of a force demand along x, y, z
        ("angular_acceleration", "f8", 3),  # rad/s^2 of a torque demand about x, y, z
    ],
    align=True,
)


@kernel
def demand(error, rate, acceleration, deadband, lead, release, before):
    """Return -1, 0 or 1 for one axis; ``before`` is the demand of the cycle before."""
    s = error + lead * rate + rate * abs(rate) / (2.0 * acceleration)
    if s > deadband or (before < 0 and s > release * deadband):
        return -1
    if s < -deadband or (before > 0 and s < -release * deadband):
        return 1
    return 0


@kernel
def control(params, navigation, reference, command):
    """Write the six demands of ``command`` (COMMAND), which holds those of the cycle before.

    navigation: NAVIGATION; while it is not valid nothing is demanded. reference: REFERENCE.
    """
    if navigation.valid == 0:
        command.force[:] = 0
        command.torque[:] = 0
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
        command.force[i] = demand(
            error_c[i],
            rate_c[i],
            params.acceleration[i],
            params.position_deadband,
            params.position_lead,
            params.release,
            command.force[i],
        )
        command.torque[i] = demand(
            turn[i],
            navigation.w_CH_C[i],
            params.angular_acceleration[i],
            params.attitude_deadband,
            params.attitude_lead,
            params.release,
            command.torque[i],
        )
