"""Bending mode of the solar array, coupled with the rotation of the hub (hybrid coordinates).

    J dw/dt + w x h + delta d2eta/dt2 = torque,   h = J w + delta deta/dt
    d2eta/dt2 + 2 zeta Omega deta/dt + Omega^2 eta + delta . dw/dt = 0

J is the inertia of the whole vehicle undeformed, eta the modal coordinate, m kg^1/2, delta the coupling
of the mode to the hub's rotation, kg^1/2 m. Source: Likins, Dynamics and Control of Flexible Space Vehicles, JPL
TR 32-1329 (1970). Linear in eta: the bending changes neither J nor the centre of mass, and the
mode is one in which the wings move against each other, so thrust along an axis does not excite it.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel

MODE_PARAMS = np.dtype(
    [
        ("frequency", "f8"),  # Omega, rad/s, of the array on a fixed hub
        ("damping", "f8"),  # zeta
        ("coupling", "f8", 3),  # delta, kg^1/2 m, in c
        ("inertia_inverse", "f8", (3, 3)),  # of J - delta delta^T
    ],
    align=True,
)


@kernel
def add_bending(mode, w, eta, eta_rate, torque):
    """Add the array's torque on the hub to ``torque`` (3,), N m; return its spring and damper, m kg^1/2 / s^2.

    mode: MODE_PARAMS. w: (3,), rad/s, inertial rate. All in c. With ``inertia_inverse`` of the mode, Euler's equations
    then give the hub's dw/dt, and ``bending`` that of the mode.
    """
    d = mode.coupling
    spring = 2.0 * mode.damping * mode.frequency * eta_rate + mode.frequency * mode.frequency * eta
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        torque[i] += d[i] * spring - (w[j] * d[k] - w[k] * d[j]) * eta_rate
    return spring


@kernel
def bending(mode, spring, acceleration):
    """Return d2eta/dt2, m kg^1/2 / s^2, under the hub's dw/dt (3,), rad/s^2, and the ``spring`` of ``add_bending``."""
    d = mode.coupling
    return -spring - (d[0] * acceleration[0] + d[1] * acceleration[1] + d[2] * acceleration[2])
