"""Plumes of the chaser's thrusters on the target: they push it, and the light of its LEDs comes through them.

Momentum flux in the far field of a plume, by the cosine law (Boynton, AIAA Journal 5 (1967) 1703; Simons, AIAA Journal
10 (1972) 1534), about the axis to which the thrust F belongs:

    p(r, theta) = F (n + 2) / (2 pi r^2) cos^n(theta),   theta < 90 deg,   n = 2 / (gamma - 1),

whose momentum along the axis is F. A sphere of radius R on the axis at the distance r is in the cone of half-angle
asin(R / r) and meets ``1 - (1 - R^2 / r^2)^(n/2 + 1)`` of it, far away (n/2 + 1) (R / r)^2, off the axis cos^n(theta)
of that. It takes up all momentum of the gas that it meets, along the line from the thruster to its centre.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, quat, stack
from hil.maths.arrays import fill
from hil.maths.limits import to_integer

PLUME_PARAMS = np.dtype(
    [
        ("radius", "f8"),  # m, of the target about its reference point; 0: no plume acts
        ("target_mass", "f8"),  # kg
        ("exponent", "f8"),  # n
        ("thrust", "f8"),  # N, nominal, of one thruster
        ("dimming", "f8"),  # fraction of the LEDs' light that is lost while the target meets all of that thrust
        ("least_light", "f8"),  # 1/m^2, see ``hil.sensors.vision_unit.faults.dim``
        ("span_s", "f8"),  # of one number in PLUME_MEMORY
    ],
    align=True,
)

_KEPT = 128
PLUME_MEMORY = np.dtype([("newest", "i8"), ("share", "f8", _KEPT)], align=True)
"""share: largest thrust that the target met in each span, over that of one thruster, a ring. newest: number of the last
span."""


@kernel
def met_fraction(exponent, radius, distance, cosine):
    """Return the part of a thrust that a sphere of ``radius`` meets, 0 to 1. cosine: of the angle from the axis."""
    if not cosine > 0.0:
        return 0.0
    ratio = min(1.0, radius / distance)
    return (1.0 - elementary.power(1.0 - ratio * ratio, 0.5 * exponent + 1.0)) * elementary.power(cosine, exponent)


@kernel
def push_of_plumes(params, radius, fraction, truth, out):
    """Write the target's acceleration (3,), m/s^2, in H; return the thrust that it meets, over that of one thruster.

    params: DSS_PARAMS. radius: m, of the target. fraction: (n,), thrust over nominal thrust. truth: TRUTH.
    """
    plume = params.plume
    to_target, force = stack.vector(3), stack.vector(3)
    for i in range(3):
        to_target[i] = -truth.r_CT_H[i]
    quat.transform_into(truth.q_CH, to_target, to_target)
    fill(force, 0.0)
    total = 0.0
    for j in range(params.n_thrusters):
        if fraction[j] <= 0.0:
            continue
        position, direction = params.thruster_position[j], params.thruster_direction[j]
        x = to_target[0] - params.mass_centre[0] - position[0]
        y = to_target[1] - params.mass_centre[1] - position[1]
        z = to_target[2] - params.mass_centre[2] - position[2]
        distance = math.sqrt(x * x + y * y + z * z)
        cosine = -(x * direction[0] + y * direction[1] + z * direction[2]) / distance
        met = fraction[j] * params.thruster_force[j] * met_fraction(plume.exponent, radius, distance, cosine)
        if met > 0.0:
            total += met
            force[0] += met * x / distance
            force[1] += met * y / distance
            force[2] += met * z / distance
    for i in range(3):
        force[i] /= plume.target_mass
    quat.transform_back_into(truth.q_CH, force, out)
    return total / plume.thrust


@kernel
def keep_share(plume, memory, t_s, share):
    """Keep the ``share`` of ``push_of_plumes`` in the step from ``t_s`` on. memory: PLUME_MEMORY."""
    number = to_integer(math.floor(t_s / plume.span_s))
    memory.newest = max(memory.newest, number - _KEPT)
    while memory.newest < number:
        memory.newest += 1
        memory.share[memory.newest % _KEPT] = 0.0
    memory.share[number % _KEPT] = max(memory.share[number % _KEPT], share)


@kernel
def share_at(plume, memory, t_s):
    """Return the share at ``t_s`` of the run, at most 1; 0 at a time of which none is kept."""
    number = to_integer(math.floor(t_s / plume.span_s))
    if number > memory.newest + 1 or number <= memory.newest - _KEPT or number < 0:
        return 0.0
    return min(1.0, memory.share[min(number, memory.newest) % _KEPT])
