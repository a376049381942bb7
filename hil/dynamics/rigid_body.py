"""Attitude of a rigid body, and the offset of its centre of mass from the reference point.

The truth integrates the centre of mass; the relative state, the cameras and the IMU belong to the vehicle's reference
point, the origin of c. Both coincide if the offset is zero.
"""

from __future__ import annotations

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import cross_into


@kernel
def angular_acceleration(inertia, inertia_inverse, w, torque, out):
    """Write dw/dt (3,), rad/s^2, in body axes: ``J^-1 (torque - w x J w)``.

    inertia, inertia_inverse: (3, 3), kg m^2 and its inverse. w: inertial rate, rad/s. torque: N m.
    """
    h0 = inertia[0, 0] * w[0] + inertia[0, 1] * w[1] + inertia[0, 2] * w[2]
    h1 = inertia[1, 0] * w[0] + inertia[1, 1] * w[1] + inertia[1, 2] * w[2]
    h2 = inertia[2, 0] * w[0] + inertia[2, 1] * w[1] + inertia[2, 2] * w[2]
    m0 = torque[0] - (w[1] * h2 - w[2] * h1)
    m1 = torque[1] - (w[2] * h0 - w[0] * h2)
    m2 = torque[2] - (w[0] * h1 - w[1] * h0)
    for i in range(3):
        out[i] = inertia_inverse[i, 0] * m0 + inertia_inverse[i, 1] * m1 + inertia_inverse[i, 2] * m2


@kernel
def add_gravity_gradient(inertia, nadir_C, rate_squared, torque):
    """Add ``3 GM/r^3 n x J n`` to ``torque`` (3,), N m, in c, about the centre of mass.

    inertia: (3, 3), kg m^2. nadir_C: (3,), from the vehicle towards the body's centre, of length d, in c. rate_squared:
    GM/(r^3 d^2), which is w0^2 for a unit vector on a circle. Source: Hughes, Spacecraft Attitude Dynamics (1986),
    section 8.1; first order in body size over orbit radius, point-mass body.
    """
    n0, n1, n2 = nadir_C[0], nadir_C[1], nadir_C[2]
    j0 = inertia[0, 0] * n0 + inertia[0, 1] * n1 + inertia[0, 2] * n2
    j1 = inertia[1, 0] * n0 + inertia[1, 1] * n1 + inertia[1, 2] * n2
    j2 = inertia[2, 0] * n0 + inertia[2, 1] * n1 + inertia[2, 2] * n2
    torque[0] += 3.0 * rate_squared * (n1 * j2 - n2 * j1)
    torque[1] += 3.0 * rate_squared * (n2 * j0 - n0 * j2)
    torque[2] += 3.0 * rate_squared * (n0 * j1 - n1 * j0)


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
