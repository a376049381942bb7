"""From six on/off demands to thrusters.

At set-up, every axis and sign gets the set of thrusters that serves it best (``thruster_sets``). In
the cycle the sets of all demands are superposed: a thruster fires if more demands use it than use its
opposite (``select``), so that opposing demands consume nothing. An abort brakes with the full-thrust sets
of the force axes: all thrusters that push that way.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import combinations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import Array
from hil.maths import linear
from hil.maths.elementary import square

AXES_OF_A_BODY = 6  # force x, y, z, torque x, y, z
ROWS = 9  # of the sets: the six axes, then force x, y, z again with the full-thrust sets
_LARGEST_SET = 4
_COST_PER_THRUSTER = 0.02  # in units of unwanted over wanted part of the wrench
_OPPOSED_FRACTION = 0.5  # of a stuck thruster's wrench that others may leave


def axes_in_plane(held: int) -> tuple[int, ...]:
    """Return the axes of a vehicle that is held along axis ``held`` and turns about it, 1 to 3; all of them if 0."""
    return tuple(k for k in range(AXES_OF_A_BODY) if held == 0 or (k < 3) == (k % 3 != held - 1))


def unit_wrenches(position_m: Array, direction: Array, force_n: Array) -> Array:
    """Return force, N, and torque, N m, of each thruster at full thrust, shape (n, 6), in c."""
    force = direction * force_n[:, None]
    return np.hstack([force, np.cross(position_m, force)])


def thruster_sets(
    wrenches: Array, full_thrust: bool = False, axes: Sequence[int] = range(AXES_OF_A_BODY)
) -> tuple[np.ndarray, Array]:
    """Return the best set for each axis and sign, and its strength; of ``axes`` alone, the others have no set.

    wrenches: (n, 6). Returns ``sets``, int64 (6, 2, n) of 0 or 1, second index 0 for the negative
    and 1 for the positive demand, and ``strength`` (6,), N or N m, the weaker of the two signs, inf without a set.
    A set is best if its unwanted force and torque are smallest relative to the wanted one; a torque
    counts as the force at the thrusters' mean arm. Of equally clean sets the smallest is best, with
    ``full_thrust`` the strongest. Raises ValueError if no set of up to four thrusters moves an axis.
    """
    masks, totals, cost = _candidates(wrenches, full_thrust)
    sets = np.zeros((AXES_OF_A_BODY, 2, len(wrenches)), dtype=np.int64)
    strength = np.full(AXES_OF_A_BODY, np.inf)
    for axis in axes:
        for sign_index, sign in enumerate((-1.0, 1.0)):
            best = _best(cost[axis, sign_index])
            if best < 0:
                raise ValueError(
                    f"no thrusters for the {'-' if sign < 0 else '+'}{'FFFTTT'[axis]}{'xyz'[axis % 3]} demand"
                )
            sets[axis, sign_index] = masks[best]
            strength[axis] = min(strength[axis], sign * totals[best, axis])
    return sets, strength


def sets_without(wrenches: Array, excluded: np.ndarray, full_thrust: bool = False) -> np.ndarray:
    """Return the best sets without the thrusters of each row of ``excluded`` (m, n), of bool: int64 (m, 6, 2, n).

    wrenches, full_thrust: see ``thruster_sets``. A demand for which no thrusters are left has an empty set.
    """
    masks, _, cost = _candidates(wrenches, full_thrust)
    sets = np.zeros((len(excluded), AXES_OF_A_BODY, 2, len(wrenches)), dtype=np.int64)
    for row, barred in enumerate(excluded):
        allowed = ~(masks[:, barred] != 0).any(axis=1)
        for axis in range(AXES_OF_A_BODY):
            for sign_index in range(2):
                best = _best(np.where(allowed, cost[axis, sign_index], np.inf))
                if best >= 0:
                    sets[row, axis, sign_index] = masks[best]
    return sets


def opposing_thrusters(wrenches: Array) -> np.ndarray:
    """Return, for each thruster, the set of up to four others that leaves least of its force and torque, (n, n).

    wrenches: (n, 6). The set is empty if none leaves less than half of them; of equal ones it is the smallest.
    """
    masks, totals, arm = _all_sets(wrenches)
    scale = np.array([1.0, 1.0, 1.0, arm, arm, arm])
    opposing = np.zeros((len(wrenches), len(wrenches)), dtype=np.int64)
    for j, wrench in enumerate(wrenches):
        size = linear.length(wrench / scale)
        remaining = linear.lengths((totals + wrench) / scale) / size + _COST_PER_THRUSTER * masks.sum(axis=1)
        remaining[masks[:, j] != 0] = np.inf
        best = _best(remaining)
        if best >= 0 and remaining[best] < _OPPOSED_FRACTION:
            opposing[j] = masks[best]
    return opposing


def _all_sets(wrenches: Array) -> tuple[np.ndarray, Array, float]:
    """Return all sets of up to four thrusters, (m, n) of 0 or 1, their force and torque (m, 6), and the mean arm, m."""
    arm = max(float(np.sqrt(np.mean(square(linear.lengths(wrenches[:, 3:]) / linear.lengths(wrenches[:, :3]))))), 1e-9)
    masks = _masks(len(wrenches))
    return masks, linear.product(masks, wrenches), arm


@cache
def _masks(n: int) -> np.ndarray:
    members = [list(c) for size in range(1, min(_LARGEST_SET, n) + 1) for c in combinations(range(n), size)]
    masks = np.zeros((len(members), n), dtype=np.int64)
    for row, chosen in enumerate(members):
        masks[row, chosen] = 1
    masks.flags.writeable = False
    return masks


def _candidates(wrenches: Array, full_thrust: bool) -> tuple[np.ndarray, Array, Array]:
    """Return all sets (m, n), their force and torque (m, 6), and their cost (6, 2, m), inf for useless ones."""
    masks, totals, arm = _all_sets(wrenches)
    scaled = totals / np.array([1.0, 1.0, 1.0, arm, arm, arm])
    cost = np.full((AXES_OF_A_BODY, 2, len(masks)), np.inf)
    for axis in range(AXES_OF_A_BODY):
        for sign_index, sign in enumerate((-1.0, 1.0)):
            along = sign * scaled[:, axis]
            unwanted = np.sqrt(np.maximum(np.sum(square(scaled), axis=1) - square(along), 0.0))
            useful = along > 1e-6
            if not useful.any():
                continue
            of_set = unwanted[useful] / along[useful]
            if full_thrust:
                of_set -= _COST_PER_THRUSTER * along[useful] / along.max()
            else:
                of_set += _COST_PER_THRUSTER * masks[useful].sum(axis=1)
            cost[axis, sign_index, useful] = of_set
    return masks, totals, cost


def _best(cost: Array) -> int:
    """Return the first of the smallest of ``cost`` (m,), -1 if all are inf. Equal ones may differ by rounding."""
    least = cost.min()
    return int(np.flatnonzero(cost <= least + 1e-9)[0]) if np.isfinite(least) else -1


@kernel
def select(sets, n, command):
    """Write ``command.on`` for the n thrusters from ``command.force`` and ``command.torque``.

    sets: int64 (ROWS, 2, MAX_THRUSTERS); with ``command.boost`` force demands use the last three rows.
    """
    on = command.on
    for j in range(n):
        on[j] = 0
    for axis in range(6):
        demand = command.force[axis] if axis < 3 else command.torque[axis - 3]
        if demand != 0:
            row = axis + 6 if axis < 3 and command.boost != 0 else axis
            sign = 1 if demand > 0 else -1
            for j in range(n):  # votes
                on[j] += sign * (sets[row, 1, j] - sets[row, 0, j])
    for j in range(n):
        on[j] = 1 if on[j] > 0 else 0
