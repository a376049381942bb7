"""On/off thrusters: valves with a minimum on-time, and the force, torque and propellant they make."""

from __future__ import annotations

from hil.core.jit import kernel

STANDARD_GRAVITY_MPS2 = 9.80665


@kernel
def step_valves(on, open_s, minimum_on_s, dt_s, fraction):
    """Write the open part (0..1) of this step for each of the n thrusters; keep ``open_s`` up.

    on: commands 0 or 1. open_s: state, time for which each valve has been open, 0 for a closed one.
    A valve that opened stays open for at least ``minimum_on_s``, also when its command is
    withdrawn; it then closes inside the step in which that time ends.
    """
    for j in range(on.shape[0]):
        if on[j] != 0:
            fraction[j] = 1.0
            open_s[j] += dt_s
        elif 0.0 < open_s[j] < minimum_on_s:
            fraction[j] = min(1.0, (minimum_on_s - open_s[j]) / dt_s)
            open_s[j] += dt_s
            if open_s[j] >= minimum_on_s:
                open_s[j] = 0.0
        else:
            fraction[j] = 0.0
            open_s[j] = 0.0


@kernel
def wrench(fraction, position, direction, force_n, n, force_out, torque_out):
    """Write the force (3,), N, and the torque (3,), N m, about the centre of mass, in body axes.

    position: (n, 3), m from the centre of mass. direction: (n, 3), unit vectors of the force on the
    vehicle. force_n: (n,).
    """
    for i in range(3):
        force_out[i] = 0.0
        torque_out[i] = 0.0
    for j in range(n):
        if fraction[j] > 0.0:
            thrust = fraction[j] * force_n[j]
            fx, fy, fz = thrust * direction[j, 0], thrust * direction[j, 1], thrust * direction[j, 2]
            force_out[0] += fx
            force_out[1] += fy
            force_out[2] += fz
            torque_out[0] += position[j, 1] * fz - position[j, 2] * fy
            torque_out[1] += position[j, 2] * fx - position[j, 0] * fz
            torque_out[2] += position[j, 0] * fy - position[j, 1] * fx


@kernel
def propellant_flow(fraction, force_n, exhaust_speed_mps, n):
    """Return the mean mass flow over the step, kg/s: sum of thrust over exhaust speed."""
    flow = 0.0
    for j in range(n):
        if fraction[j] > 0.0:
            flow += fraction[j] * force_n[j] / exhaust_speed_mps
    return flow
