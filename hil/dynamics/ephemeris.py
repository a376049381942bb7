"""Orbit of the target, propagated before a run, and the ephemeris of its Hill frame H.

The gravity field, drag and third bodies are those of the truth's step.
"""

from __future__ import annotations

import math

from hil.core.jit import entry, kernel
from hil.dynamics import orbit
from hil.dynamics.central_gravity import acceleration
from hil.dynamics.orbit_forces import add_drag, add_third_bodies
from hil.maths import stack
from hil.maths.arrays import copy_into, fill


@kernel
def _acceleration(gravity, forces, field, t_s, y, out):
    """Write the target's acceleration (3,), m/s^2; y: position, m, and velocity, m/s, (6,), inertial."""
    none, unused = stack.vector(3), stack.vector(3)
    acceleration(gravity, field, t_s, y[0:3], out)
    if forces.acts != 0:
        fill(none, 0.0)
        add_third_bodies(forces, t_s, y[0:3], none, out, unused)
        if forces.layers > 0:
            add_drag(forces, forces.target_drag, y[0:3], y[3:6], out)


@kernel
def _move(gravity, forces, field, t_s, dt, y):
    """Move ``y`` (6,) on by ``dt``, s, with one classical Runge-Kutta step, in place."""
    k, trial, total = stack.vector(3), stack.vector(6), stack.vector(6)
    copy_into(trial, y)
    copy_into(total, y)
    for stage in range(4):
        _acceleration(gravity, forces, field, t_s + 0.5 * dt * ((stage + 1) // 2), trial, k)
        weight = dt / 6.0 if stage == 0 or stage == 3 else dt / 3.0
        part = dt if stage == 2 else 0.5 * dt
        for i in range(3):
            speed = trial[3 + i]
            total[i] += weight * speed
            total[3 + i] += weight * k[i]
            trial[i] = y[i] + part * speed
            trial[3 + i] = y[3 + i] + part * k[i]
    copy_into(y, total)


@entry
def tabulate_frames(gravity, forces, field, y, interval_s, steps, rows):
    """Write H at every ``interval_s``, from the start of the run on, into ``rows`` (n, FRAME_COLUMNS) of an ephemeris.

    gravity, forces: GRAVITY_PARAMS, ORBIT_FORCES. field: ``central_gravity.field_table``. y: position, m, and
    velocity, m/s, of the target at the start, (6,), inertial; moved on. steps: of the integration, in an interval.
    """
    a, rate, pull, q = stack.matrix(3, 3), stack.vector(3), stack.vector(3), stack.vector(4)
    fill(q, 0.0)
    for k in range(rows.shape[0]):
        if k > 0:
            for step in range(steps):
                t_s = (k - 1 + step / steps) * interval_s
                _move(gravity, forces, field, t_s, interval_s / steps, y)
        r, v = y[0:3], y[3:6]
        _acceleration(gravity, forces, field, k * interval_s, y, pull)
        orbit.hill_frame(r, v, a)
        orbit.hill_rate(r, v, pull, a, rate)
        orbit.quaternion_near(a, q, rows[k, 3:7])
        copy_into(q, rows[k, 3:7])
        squared = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        rows[k, 0], rows[k, 1], rows[k, 2] = -rate[1], rate[2], gravity.gm / (squared * math.sqrt(squared))
