"""Keep-out of the chaser's reference point: a sphere about the target's, and the half-space behind it.

The half-space keeps the chaser before the plane through the sphere's nearest point of the docking axis, also where it
would pass the target at its side. A scenario that docks has a corridor through both.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.models.bodies import travel_to_rest

KEEP_OUT_ZONE = np.dtype(
    [
        ("axis", "f8", 3),  # unit vector in H, from the target outwards
        ("radius", "f8"),  # m, of the sphere; 0: none
        ("plane", "f8"),  # m, least position along the axis; -inf: none
        ("corridor", "f8"),  # m, radius about the axis within which neither holds; 0: none
    ],
    align=True,
)

BREACH = np.dtype([("axis", "i8"), ("value", "f8"), ("low", "f8"), ("high", "f8")], align=True)

NOTHING = 0
KEEP_OUT, PLANE = 8, 17
"""What was found: too near to the target, or to the plane."""


@kernel
def check_keep_out(zone, r, v, slack, reaction_s, deceleration, breach):
    """Return KEEP_OUT or PLANE if the chaser, braking now, would enter the keep-out, NOTHING otherwise.

    zone: KEEP_OUT_ZONE. r, v (3,): of the chaser's reference point in H, m and m/s. slack: m, by which it may be off.
    ``breach`` (BREACH) then has range or position along the axis as ``value``, the closing rate as ``low`` and the
    least value allowed at it as ``high``.
    """
    along, outwards = 0.0, 0.0
    for i in range(3):
        along += zone.axis[i] * r[i]
        outwards += zone.axis[i] * v[i]
    # the range is at least the position along the axis, and the closing rate at most the sum of the components
    farthest = travel_to_rest(abs(v[0]) + abs(v[1]) + abs(v[2]), reaction_s, deceleration)
    if along - farthest - slack >= max(zone.radius, zone.plane):
        return NOTHING
    square, product = 0.0, 0.0
    for i in range(3):
        square += r[i] * r[i]
        product += r[i] * v[i]
    distance = math.sqrt(square)
    closing = max(0.0, -product / distance) if distance > 0.0 else 0.0
    least = zone.radius + slack + travel_to_rest(closing, reaction_s, deceleration)
    least_along = zone.plane + slack + travel_to_rest(-outwards, reaction_s, deceleration)
    # "not >=" also takes nan
    too_near, beyond = zone.radius > 0.0 and not distance >= least, not along >= least_along
    if not (too_near or beyond):
        return NOTHING
    if zone.corridor > 0.0:
        off = math.sqrt(max(0.0, square - along * along))
        leaving = (product - along * outwards) / off if off > 0.0 else 0.0
        if off + slack + travel_to_rest(leaving, reaction_s, deceleration) <= zone.corridor:
            return NOTHING
    breach.axis = 0
    if too_near:
        breach.value, breach.low, breach.high = distance, closing, least
        return KEEP_OUT
    breach.value, breach.low, breach.high = along, max(0.0, -outwards), least_along
    return PLANE
