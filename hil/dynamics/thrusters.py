"""On/off thrusters: force, torque, propellant flow, errors, and isolation valves upstream, which stay closed."""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS, Array
from hil.maths import elementary, linear

ISOLATION = np.dtype(
    [("acts", "i8"), ("commanded", "i8", MAX_THRUSTERS), ("elapsed_s", "f8", MAX_THRUSTERS)], align=True
)
"""acts: 1 if a valve was commanded to close. elapsed_s: time since that command, of each thruster."""


@kernel
def isolate(isolation, thrusters):
    """Command the isolation valves of ``thrusters`` (n,), 0 or 1, to close."""
    for j in range(thrusters.shape[0]):
        if thrusters[j] != 0:
            isolation.acts = 1
            isolation.commanded[j] = 1


@kernel
def close_isolated(isolation, closing_s, dt_s, fraction):
    """Cut the thrust (n,) of this step off where an isolation valve was commanded ``closing_s`` ago."""
    for j in range(fraction.shape[0]):
        if isolation.commanded[j] != 0:
            isolation.elapsed_s[j] += dt_s
            if isolation.elapsed_s[j] > closing_s:
                fraction[j] = 0.0


STANDARD_GRAVITY_MPS2 = 9.80665
DRAWS_PER_THRUSTER = 3  # standard normals: two tilts, one force


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


def as_built(
    direction: Array, force_n: Array, tilt_sigma: float, force_sigma: float, draws: Array
) -> tuple[Array, Array]:
    """Return direction (n, 3) and force (n,), N, of the thrusters with their errors.

    direction: (n, 3), unit vectors. force_n: (n,). tilt_sigma: rad, about each of two axes orthogonal to the
    thrust. force_sigma: relative to the nominal force. draws: standard normals, (n, 3). A force is never negative.
    """
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin(axis=1)])
    first /= linear.lengths(first)[:, None]
    aside = draws[:, 0:1] * first + draws[:, 1:2] * np.cross(direction, first)
    size = linear.lengths(aside)[:, None]
    angle = tilt_sigma * size
    cosine, sine = elementary.each(elementary.cos, angle), elementary.each(elementary.sin, angle)
    turned = cosine * direction + sine * aside / np.where(size > 0.0, size, 1.0)
    built = np.where(angle == 0.0, direction, turned)
    return built, force_n * np.maximum(0.0, 1.0 + force_sigma * draws[:, 2])
