"""Offset of the centre of mass from the reference point.

The truth integrates the centre of mass; the relative state, the cameras and the IMU belong to the vehicle's
reference point, the origin of c. Both coincide if the offset is zero.
"""

from __future__ import annotations

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import cross_into


@kernel
def shift(q, offset_C, w_C, sign, r, v):
    """Add ``sign`` times the offset to ``r`` (3,), m, and ``v`` (3,), m/s, of a point, in place.

    q: quaternion from the frame F of r and v to c. offset_C: (3,), m, in c. w_C: (3,), rad/s, of c against F, in c.
    sign: 1.0 from the reference point to the centre of mass, -1.0 back.
    """
    offset_F, velocity_F = stack.vector(3), stack.vector(3)
    cross_into(w_C, offset_C, velocity_F)
    quat.transform_back_into(q, offset_C, offset_F)
    quat.transform_back_into(q, velocity_F, velocity_F)
    for i in range(3):
        r[i] += sign * offset_F[i]
        v[i] += sign * velocity_F[i]


@kernel
def add_lever_terms(offset_C, w_before, w_after, w_mean, dt, force):
    """Add to ``force`` (3,), m/s^2, the acceleration of the reference point relative to the centre of mass.

    The mean over a step of ``-(dw/dt x d + w x (w x d))``, d the offset (3,), m, in c. w_before, w_after, w_mean: (3,),
    rad/s, inertial rate at both ends and its mean. The first term is exact, the second to the change of w in a step.
    """
    gained, turned, across, drawn = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3)
    for i in range(3):
        gained[i] = (w_after[i] - w_before[i]) / dt
    cross_into(gained, offset_C, turned)
    cross_into(w_mean, offset_C, across)
    cross_into(w_mean, across, drawn)
    for i in range(3):
        force[i] -= turned[i] + drawn[i]
