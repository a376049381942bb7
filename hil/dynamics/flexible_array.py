"""One bending mode of the solar array that turns with the hub and turns it back (hybrid coordinates).

    J dw/dt + w x h + delta d2eta/dt2 = torque,   h = J w + delta deta/dt
    d2eta/dt2 + 2 zeta Omega deta/dt + Omega^2 eta + delta . dw/dt = 0

J is the inertia of the whole vehicle undeformed, eta the modal coordinate, m kg^1/2, delta the coupling
of the mode to the hub's rotation, kg^1/2 m. Source: Likins, Dynamics and Control of Flexible Space Vehicles, JPL
TR 32-1329 (1970). Linear in eta: the bending changes neither J nor the centre of mass, and the
mode is one in which the wings move against each other, so thrust along an axis does not excite it.
"""

from __future__ import annotations

import numpy as np

from hil.maths.jit import kernel

MODE_PARAMS = np.dtype(
    [
        ("frequency", "f8"),  # Omega, rad/s, of the array on a hub that does not turn
        ("damping", "f8"),  # zeta
        ("coupling", "f8", 3),  # delta, kg^1/2 m, in c
        ("inertia_inverse", "f8", (3, 3)),  # of J - delta delta^T
    ],
    align=True,
)


@kernel
def flexible_acceleration(mode, inertia, w, torque, eta, eta_rate, out):
    """Write dw/dt (3,), rad/s^2, in c; return d2eta/dt2, m kg^1/2 / s^2.

    mode: MODE_PARAMS. inertia: (3, 3), J, kg m^2. w: (3,), rad/s, inertial rate. torque: (3,), N m. All in c.
    """
    d = mode.coupling
    h0 = inertia[0, 0] * w[0] + inertia[0, 1] * w[1] + inertia[0, 2] * w[2] + d[0] * eta_rate
    h1 = inertia[1, 0] * w[0] + inertia[1, 1] * w[1] + inertia[1, 2] * w[2] + d[1] * eta_rate
    h2 = inertia[2, 0] * w[0] + inertia[2, 1] * w[1] + inertia[2, 2] * w[2] + d[2] * eta_rate
    spring = 2.0 * mode.damping * mode.frequency * eta_rate + mode.frequency * mode.frequency * eta
    m0 = torque[0] - (w[1] * h2 - w[2] * h1) + d[0] * spring
    m1 = torque[1] - (w[2] * h0 - w[0] * h2) + d[1] * spring
    m2 = torque[2] - (w[0] * h1 - w[1] * h0) + d[2] * spring
    g = mode.inertia_inverse
    for i in range(3):
        out[i] = g[i, 0] * m0 + g[i, 1] * m1 + g[i, 2] * m2
    return -spring - (d[0] * out[0] + d[1] * out[1] + d[2] * out[2])
