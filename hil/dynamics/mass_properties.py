"""Mass properties that change from step to step: inertia without the propellant used, and a hub with a moving array.

The propellant has a radius of gyration about each axis of c: what has left the vehicle takes its inertia along. Its
angular momentum goes with it, so that the vehicle's rate is kept (no jet damping).
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import stack

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
