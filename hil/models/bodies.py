"""Convex bodies of chaser, target and bench, and the distance that is left between them after braking."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.convex import separation

MAX_BODIES = 8
MAX_VERTICES = 16

BODIES = np.dtype(
    [
        ("n", "i8"),
        ("low", "f8", 3),  # m, of all bodies along the axes of their frame; inf without a body
        ("high", "f8", 3),  # -inf without a body
        ("farthest", "f8"),  # m, of all bodies from the origin of their frame
        ("number", "i8", MAX_BODIES),  # in the list of the configuration, from 1
        ("vertices", "i8", MAX_BODIES),
        ("vertex", "f8", (MAX_BODIES, MAX_VERTICES, 3)),  # m, in the frame of the bodies
        ("radius", "f8", MAX_BODIES),  # m, by which the hull of the vertices is widened
        ("centre", "f8", (MAX_BODIES, 3)),  # m, mean of the vertices
        ("reach", "f8", MAX_BODIES),  # m, of the body from its centre
        ("arm", "f8", MAX_BODIES),  # m, of the body from the origin of its frame, about which it rotates
    ],
    align=True,
)
"""Bodies that are fixed to each other."""

PAIR = 100
"""Number of a pair: PAIR times the number of the moving body, plus the number of the other."""
WHICH, DISTANCE, CLOSING, STOPPING = range(4)
"""What ``clearance`` finds: number of the pair; distance, m, not above 0 if they meet; closing rate, m/s; distance
that they approach each other until rest, m."""


@kernel
def travel_to_rest(speed, reaction_s, deceleration):
    """Return the distance, or angle, until rest, from ``speed`` with ``deceleration`` after ``reaction_s``."""
    return speed * (reaction_s + speed / (2.0 * deceleration)) if speed > 0.0 else 0.0


@kernel
def are_apart(moving, r, rotation, fixed, least):
    """Return whether bodies are ``least``, m, apart along an axis of the frame of ``fixed``: cheap, and sufficient.

    moving: BODIES in a frame at ``r`` (3,), m, rotated from that of ``fixed`` by at most ``rotation``, rad.
    """
    gap = -np.inf
    for i in range(3):
        gap = max(gap, r[i] + moving.low[i] - fixed.high[i], fixed.low[i] - r[i] - moving.high[i])
    return gap - moving.farthest * rotation >= least


@kernel
def chord(q):
    """Return a bound of how far the rotation ``q`` (4,) displaces a point, over its arm: 2 sin(angle / 2)."""
    return 2.0 * (abs(q[0]) + abs(q[1]) + abs(q[2]))


@kernel
def clearance(moving, r, q, v, rate, fixed, reaction_s, deceleration, turning_deceleration, enough, nearest):
    """Return the least distance, m, that braking leaves between a body of ``moving`` and one of ``fixed``.

    moving: BODIES in a frame at ``r`` (3,), m, with the attitude ``q`` (4,) (from that of ``fixed``), the velocity
    ``v`` (3,), m/s, and the angular rate ``rate``, rad/s. fixed: BODIES. The distance of convex bodies is a convex
    function of their translation: it falls by no more than the travel along its present gradient. Rotation takes at
    most the angle until rest times the arm. Braking begins after ``reaction_s``. Returns at most ``enough``; if it is
    less, ``nearest`` (4,) has the pair.
    """
    hull, centre, normal, vertex = stack.matrix(MAX_VERTICES, 3), stack.vector(3), stack.vector(3), stack.vector(3)
    least = enough
    speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    angle = travel_to_rest(rate, reaction_s, turning_deceleration)
    farthest = travel_to_rest(speed, reaction_s, deceleration)
    for i in range(moving.n):
        turned, is_placed = moving.arm[i] * angle, False
        quat.transform_back_into(q, moving.centre[i], centre)
        for j in range(fixed.n):
            square = 0.0
            for k in range(3):
                square += (r[k] + centre[k] - fixed.centre[j, k]) ** 2
            if math.sqrt(square) - moving.reach[i] - fixed.reach[j] - farthest - turned >= least:
                continue
            if not is_placed:
                for m in range(moving.vertices[i]):
                    quat.transform_back_into(q, moving.vertex[i, m], vertex)
                    for k in range(3):
                        hull[m, k] = r[k] + vertex[k]
                is_placed = True
            distance = separation(hull, moving.vertices[i], fixed.vertex[j], fixed.vertices[j], normal)
            distance -= moving.radius[i] + fixed.radius[j]
            closing = -(normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2])
            travel = travel_to_rest(closing, reaction_s, deceleration) + turned
            # "not >=" also takes nan
            if not distance - travel >= least:
                least = distance - travel
                nearest[WHICH] = PAIR * moving.number[i] + fixed.number[j]
                nearest[DISTANCE], nearest[CLOSING], nearest[STOPPING] = distance, max(0.0, closing), travel
    return least
