"""Attitude of a rigid body: Euler's equations with a full inertia matrix, and the gravity-gradient torque."""

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
