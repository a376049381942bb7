"""Mass properties that change from step to step: inertia without the propellant used, and a hub with a moving array.

The propellant has a radius of gyration about each axis of c: what has left the vehicle takes its inertia along. Its
angular momentum goes with it, so that the vehicle's rate is kept (no jet damping).

Bending modes of the array are coupled with rotation and translation of the hub (hybrid coordinates):

    m a + sum(d2eta/dt2 lambda + deta/dt w x lambda) = force
    J dw/dt + w x h + sum(d2eta/dt2 delta) = torque,   h = J w + sum(deta/dt delta)
    d2eta/dt2 + 2 zeta Omega deta/dt + Omega^2 eta + delta . dw/dt + lambda . a = 0   for each mode

m and J are mass and inertia of the whole vehicle undeformed, a the acceleration of its mass centre less gravity, which
pulls the array as it pulls the hub; eta the modal coordinate, m kg^1/2, delta and lambda the coupling of the mode to
the hub's rotation, kg^1/2 m, and translation, kg^1/2. Source: Likins, Dynamics and Control of Flexible Space Vehicles,
JPL TR 32-1329 (1970). Linear in eta: the bending changes neither J nor the centre of mass. A mode with lambda = 0 is
one in which the wings move against each other, so thrust along an axis does not excite it.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_MODES
from hil.maths import stack

MODES = np.dtype(
    [
        ("n", "i8"),
        ("moves", "i8"),  # 1: a mode is coupled to the translation
        ("frequency", "f8", MAX_MODES),  # Omega, rad/s, of the array on a fixed hub
        ("damping", "f8", MAX_MODES),  # zeta
        ("coupling", "f8", (MAX_MODES, 3)),  # delta, kg^1/2 m, in c
        ("translation", "f8", (MAX_MODES, 3)),  # lambda, kg^1/2, in c
        ("inertia_inverse", "f8", (3, 3)),  # of J - sum(delta delta^T)
    ],
    align=True,
)

BENDING = np.dtype([("eta", "f8", MAX_MODES), ("eta_rate", "f8", MAX_MODES)], align=True)
"""Modal coordinates and their rates, without the first mode, which TRUTH has."""


@kernel
def _add_reaction(coupling, w, spring, eta_rate, out):
    """Add ``coupling spring - w x coupling eta_rate`` to ``out`` (3,)."""
    d = coupling
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] += d[i] * spring - (w[j] * d[k] - w[k] * d[j]) * eta_rate


@kernel
def add_bending(modes, mode, w, eta, eta_rate, torque):
    """Add a mode's torque on the hub to ``torque`` (3,), N m; return its spring and damper, m kg^1/2 / s^2.

    modes: MODES. w: (3,), rad/s, inertial rate. All in c. With ``inertia_inverse`` of the modes, Euler's equations
    then give the hub's dw/dt, and ``bending`` that of the mode.
    """
    omega = modes.frequency[mode]
    spring = 2.0 * modes.damping[mode] * omega * eta_rate + omega * omega * eta
    _add_reaction(modes.coupling[mode], w, spring, eta_rate, torque)
    return spring


@kernel
def add_bending_force(modes, mode, w, spring, eta_rate, force):
    """Add a mode's force on the hub to ``force`` (3,), N. spring: of ``add_bending``."""
    _add_reaction(modes.translation[mode], w, spring, eta_rate, force)


@kernel
def bending(modes, mode, spring, acceleration):
    """Return d2eta/dt2, m kg^1/2 / s^2, under the hub's dw/dt (3,), rad/s^2, and the ``spring`` of ``add_bending``."""
    d = modes.coupling[mode]
    return -spring - (d[0] * acceleration[0] + d[1] * acceleration[1] + d[2] * acceleration[2])


@kernel
def bending_of_translation(modes, mode, acceleration):
    """Return the part of d2eta/dt2 that the hub's acceleration less gravity (3,), m/s^2, adds."""
    d = modes.translation[mode]
    return -(d[0] * acceleration[0] + d[1] * acceleration[1] + d[2] * acceleration[2])


MASS_MODEL = np.dtype(
    [
        ("varies", "i8"),  # 1: MASS_PROPERTIES of each step, 0: the constant inertia
        ("full_kg", "f8"),  # mass of the vehicle to which the inertia belongs
        ("gyration_squared", "f8", 3),  # m^2, of the propellant
    ],
    align=True,
)

MASS_PROPERTIES = np.dtype(
    [
        ("inertia", "f8", (3, 3)),  # kg m^2, J
        ("inertia_inverse", "f8", (3, 3)),
        ("mass_inverse", "f8", (3, 3)),  # 1/kg, of A
        ("lever", "f8", (3, 3)),  # 1/m, -B^T A^-1
    ],
    align=True,
)
"""Of a step. With an array that is coupled to rotation (delta) and translation (lambda), ``flexible_array``:

    [A   B] [  a  ]   [force ]    A = m - sum(lambda lambda^T), B = -sum(lambda delta^T),
    [B^T C] [dw/dt] = [torque],   C = J - sum(delta delta^T)

``inertia_inverse`` is that of the Schur complement C - B^T A^-1 B, of which the torque less B^T A^-1 force gives dw/dt.
"""


@kernel
def invert_symmetric(a, out):
    """Write the inverse of the symmetric matrix ``a`` (3, 3), which is not singular, by its cofactors."""
    for i in range(3):
        for j in range(3):
            m, n, p, q = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            out[i, j] = a[m, p] * a[n, q] - a[m, q] * a[n, p]
    determinant = a[0, 0] * out[0, 0] + a[0, 1] * out[0, 1] + a[0, 2] * out[0, 2]
    for i in range(3):
        for j in range(3):
            out[i, j] /= determinant


@kernel
def set_mass_properties(params, mass_kg, out):
    """Write MASS_PROPERTIES of a vehicle of ``mass_kg``. params: DSS_PARAMS."""
    model, modes = params.mass, params.modes
    turning, moving = stack.matrix(3, 3), stack.matrix(3, 3)
    for i in range(3):
        for j in range(3):
            out.inertia[i, j] = params.inertia[i, j]
        out.inertia[i, i] -= (model.full_kg - mass_kg) * model.gyration_squared[i]
    for i in range(3):
        for j in range(3):
            turning[i, j] = out.inertia[i, j]
            moving[i, j] = mass_kg if i == j else 0.0
            out.lever[i, j] = 0.0
    if params.flexible_array != 0:
        for k in range(modes.n):
            for i in range(3):
                for j in range(3):
                    turning[i, j] -= modes.coupling[k, i] * modes.coupling[k, j]
                    moving[i, j] -= modes.translation[k, i] * modes.translation[k, j]
        invert_symmetric(moving, out.mass_inverse)
        for k in range(modes.n):
            for j in range(3):
                moved = 0.0
                for m in range(3):
                    moved += modes.translation[k, m] * out.mass_inverse[m, j]
                for i in range(3):
                    out.lever[i, j] += modes.coupling[k, i] * moved
        for k in range(modes.n):
            for i in range(3):
                turned = 0.0
                for m in range(3):
                    turned += out.lever[i, m] * modes.translation[k, m]
                for j in range(3):
                    turning[i, j] -= turned * modes.coupling[k, j]
    invert_symmetric(turning, out.inertia_inverse)
