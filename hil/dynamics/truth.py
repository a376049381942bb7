"""One step of the truth: relative motion in H and attitude of the chaser under its thrusters.

The thrust is constant over the step; the motion is integrated with the classical fourth-order
Runge-Kutta method. The model of relative motion is the one function ``relative_acceleration``.
"""

from __future__ import annotations

import numpy as np

from hil.dynamics.hill import hill_acceleration
from hil.dynamics.rigid_body import angular_acceleration
from hil.dynamics.thrusters import propellant_flow, step_valves, wrench
from hil.maths import quat
from hil.maths.jit import kernel
from hil.messages import MAX_THRUSTERS

DSS_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("orbit_rate", "f8"),  # rad/s
        ("inertia", "f8", (3, 3)),  # kg m^2, in c, about the centre of mass
        ("inertia_inverse", "f8", (3, 3)),
        ("n_thrusters", "i8"),
        ("thruster_position", "f8", (MAX_THRUSTERS, 3)),  # m, from the centre of mass, in c
        ("thruster_direction", "f8", (MAX_THRUSTERS, 3)),  # unit force on the vehicle, in c
        ("thruster_force", "f8", MAX_THRUSTERS),  # N
        ("minimum_on_s", "f8"),
        ("exhaust_speed", "f8"),  # m/s
    ],
    align=True,
)

# the integrated state: r 0:3, v 3:6, q 6:10, w 10:13, integral of w 13:16
_N = 16


@kernel
def relative_acceleration(params, y, out):
    """Write the free relative acceleration in H, (3,), m/s^2, for the state ``y``."""
    hill_acceleration(y[0:3], y[3:6], params.orbit_rate, out)


@kernel
def _derivative(params, y, specific_force, torque, dy):
    """Write dy/dt. specific_force: (3,), m/s^2, and torque: (3,), N m, both in c, constant."""
    relative_acceleration(params, y, dy[3:6])
    q = y[6:10]
    force_h = quat.transform_back(q, specific_force)
    for i in range(3):
        dy[i] = y[3 + i]
        dy[3 + i] += force_h[i]
        dy[13 + i] = y[10 + i]
    # rate of c against H, in c: w_CH = w_CI - A(q) [0, -w0, 0] (bench paper eq. (3))
    a = quat.to_matrix(q)
    w_ch = np.empty(3)
    for i in range(3):
        w_ch[i] = y[10 + i] + a[i, 1] * params.orbit_rate
    quat.rate_of_change(q, w_ch, dy[6:10])
    angular_acceleration(params.inertia, params.inertia_inverse, y[10:13], torque, dy[10:13])


@kernel
def _integrate(params, y, specific_force, torque, dt):
    """Move ``y`` on by ``dt`` with one classical Runge-Kutta step, in place."""
    k = np.empty((4, _N))
    trial = np.empty(_N)
    _derivative(params, y, specific_force, torque, k[0])
    for stage in range(1, 4):
        part = dt if stage == 3 else 0.5 * dt
        for i in range(_N):
            trial[i] = y[i] + part * k[stage - 1, i]
        _derivative(params, trial, specific_force, torque, k[stage])
    for i in range(_N):
        y[i] += dt / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@kernel
def step(params, truth, on):
    """Move ``truth`` (TRUTH) on by one step, in place, with the thruster commands ``on`` (n,), 0 or 1."""
    dt = params.dt_s
    n = params.n_thrusters
    fraction = truth.thrust_fraction
    step_valves(on[:n], truth.open_s[:n], params.minimum_on_s, dt, fraction[:n])
    force = np.empty(3)
    torque = np.empty(3)
    wrench(fraction, params.thruster_position, params.thruster_direction, params.thruster_force, n, force, torque)
    y = np.empty(_N)
    for i in range(3):
        force[i] /= truth.mass_kg
        y[i] = truth.r_CT_H[i]
        y[3 + i] = truth.v_CT_H[i]
        y[10 + i] = truth.w_CI_C[i]
        y[13 + i] = 0.0
    for i in range(4):
        y[6 + i] = truth.q_CH[i]
    _integrate(params, y, force, torque, dt)
    quat.normalise(y[6:10])
    for i in range(3):
        truth.r_CT_H[i] = y[i]
        truth.v_CT_H[i] = y[3 + i]
        truth.w_CI_C[i] = y[10 + i]
        truth.mean_rate_C[i] = y[13 + i] / dt
        truth.mean_force_C[i] = force[i]
    for i in range(4):
        truth.q_CH[i] = y[6 + i]
    truth.mass_kg -= dt * propellant_flow(fraction, params.thruster_force, params.exhaust_speed, n)
    truth.t_s += dt


@kernel
def rate_against_hill(params, truth, out):
    """Write w_CH_C (3,), rad/s: the chaser's rate against H, in c."""
    a = quat.to_matrix(truth.q_CH)
    for i in range(3):
        out[i] = truth.w_CI_C[i] + a[i, 1] * params.orbit_rate
