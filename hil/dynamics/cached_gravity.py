"""Cached gravity over a step of the truth (multi-rate): evaluated before the Runge-Kutta stages that use it.

The point mass is evaluated three times per step, harmonics, drag and third bodies at four places once per CACHE_SPAN_S
(docs/explanation/truth.md).
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.dynamics import central_gravity
from hil.dynamics.central_gravity import LANES
from hil.dynamics.orbit_forces import add_orbit_forces
from hil.maths import quat, stack
from hil.maths.arrays import fill_matrix

CACHE_SPAN_S = 0.4  # over which the harmonics are interpolated; one step if that is longer

CACHED_GRAVITY = np.dtype(
    [
        ("steps", "i8"),  # steps in the span, 0 before the first
        ("step", "i8"),  # number of the next one
        ("pull", "f8", (LANES, 3)),  # m/s^2, see sample_perturbation
        ("drag", "f8", 3),  # m/s^2, of the chaser in the middle of the span, inertial
    ],
    align=True,
)


@kernel
def interpolate_perturbation(params, forces, field, t_s, r_T, v_T, rho, rho_rate, dt, held, out):
    """Write the perturbing accelerations of the step of ``dt``, s, from ``t_s`` on, m/s^2, into ``out`` (4, 3).

    forces: ORBIT_FORCES. Rows and other arguments as for ``central_gravity.sample_perturbation``, which is called once
    per CACHE_SPAN_S; in between the target's acceleration is interpolated by the parabola through its three values.
    held: CACHED_GRAVITY, zeroed at the start of a run and updated here; the steps of a run are consecutive.
    """
    if held.step >= held.steps:
        held.steps = max(1, int(CACHE_SPAN_S / dt + 1e-6))
        held.step = 0
        central_gravity.sample_perturbation(params, field, t_s, r_T, v_T, rho, rho_rate, held.steps * dt, held.pull)
        if forces.acts != 0:
            add_orbit_forces(forces, params.gm, t_s, r_T, v_T, rho, rho_rate, held.steps * dt, held.pull, held.drag)
    pull = held.pull
    for row in range(3):
        fraction = (held.step + 0.5 * row) / held.steps  # of the span
        begin, end = (1.0 - fraction) * (1.0 - 2.0 * fraction), fraction * (2.0 * fraction - 1.0)
        middle = 4.0 * fraction * (1.0 - fraction)
        for i in range(3):
            out[row, i] = begin * pull[0, i] + middle * pull[1, i] + end * pull[2, i]
    for i in range(3):
        out[3, i] = pull[3, i]
    held.step += 1


@kernel
def gravity_over_step(gm, harmonics, y, force_C, dt, gravity):
    """Write gravity at begin, middle and end of a step of ``dt``, s, into the rows of ``gravity`` (3, 10).

    In a row: the target's acceleration (3,), the chaser's minus it (3,), m/s^2; in mid-step also the vector from the
    chaser to the body's centre (3,), m, of length d, and GM/d^5, 1/(s^2 m^2). The places are those of parabolas under
    the accelerations of the start, within a nanometre. gm: m^3/s^2. harmonics: (4, 3) of ``interpolate_perturbation``.
    y: the integrated state of ``truth`` in inertial axes. force_C: (3,), specific thrust, m/s^2, in c.
    """
    r, rho, thrust = stack.vector(3), stack.vector(3), stack.vector(3)
    quat.transform_back_into(y[6:10], force_C, thrust)
    fill_matrix(gravity, 0.0)
    for row in range(3):
        t = 0.5 * row * dt
        fallen = 0.5 * t * t
        for i in range(3):
            r[i] = y[21 + i] + t * y[24 + i] + fallen * gravity[0, i]
            rho[i] = y[i] + t * y[3 + i] + fallen * (gravity[0, 3 + i] + thrust[i])
        central_gravity.point_mass_differential(gm, r, rho, gravity[row, 0:3], gravity[row, 3:6])
        for i in range(3):
            gravity[row, i] += harmonics[row, i]
            gravity[row, 3 + i] += harmonics[3, i]
        if row == 1:
            squared = 0.0
            for i in range(3):
                gravity[1, 6 + i] = -(r[i] + rho[i])
                squared += gravity[1, 6 + i] * gravity[1, 6 + i]
            gravity[1, 9] = gm / (squared * squared * math.sqrt(squared))
