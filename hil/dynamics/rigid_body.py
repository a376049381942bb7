"""Attitude of a rigid body: Euler's equations with a full inertia matrix."""

from __future__ import annotations

from hil.core.jit import kernel


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
