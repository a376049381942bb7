"""Faults of thrusters: between the command of a valve and its thrust."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.dynamics.thrusters import step_valves
from hil.maths.arrays import copy_into
from hil.models.faults import KIND, NUMBER, VALUE, is_active

STUCK_OPEN, STUCK_CLOSED, LEAK, FORCE_SCALE, DELAY, MINIMUM_ON = range(6)

DELAY_STEPS_MAX = 128
"""Steps of the longest delay."""

THRUST_MEMORY = np.dtype(
    [("next", "i8"), ("fraction", "f8", (DELAY_STEPS_MAX + 2, MAX_THRUSTERS))],
    align=True,
)
"""Open fractions of the last steps, a ring."""


@kernel
def _minimum_on(faults, t_s, thruster, nominal_s):
    """Return the minimum on-time of ``thruster``, s."""
    for i in range(faults.n):
        row = faults.row[i]
        if row[KIND] == MINIMUM_ON and row[NUMBER] == thruster and is_active(row, t_s):
            return row[VALUE]
    return nominal_s


@kernel
def _delayed(memory, thruster, delay_s, dt_s):
    """Return the open fraction of this step of a valve that follows ``delay_s`` later: of two steps, in proportion."""
    steps = math.floor(delay_s / dt_s)
    share = delay_s / dt_s - steps
    newest = memory.next + 2 * (DELAY_STEPS_MAX + 2) - 1
    late = memory.fraction[(newest - steps) % (DELAY_STEPS_MAX + 2), thruster]
    later = memory.fraction[(newest - steps - 1) % (DELAY_STEPS_MAX + 2), thruster]
    return (1.0 - share) * late + share * later


@kernel
def step_faulty_valves(faults, memory, t_s, on, open_s, minimum_on_s, dt_s, fraction):
    """``step_valves`` with the faults that act at ``t_s`` of the run, the start of the step.

    faults: FAULTS. memory: THRUST_MEMORY. fraction: (n,), receives thrust over nominal thrust, which FORCE_SCALE may
    raise above 1.
    """
    for j in range(on.shape[0]):
        shortest_s = _minimum_on(faults, t_s, j, minimum_on_s)
        step_valves(on[j : j + 1], open_s[j : j + 1], shortest_s, dt_s, fraction[j : j + 1])
    copy_into(memory.fraction[memory.next, : on.shape[0]], fraction)
    memory.next = (memory.next + 1) % (DELAY_STEPS_MAX + 2)
    for i in range(faults.n):
        row = faults.row[i]
        if not is_active(row, t_s):
            continue
        kind, j = row[KIND], int(row[NUMBER])
        if kind == STUCK_OPEN:
            fraction[j] = 1.0
        elif kind == STUCK_CLOSED:
            fraction[j] = 0.0
        elif kind == LEAK:
            fraction[j] = max(fraction[j], row[VALUE])
        elif kind == FORCE_SCALE:
            fraction[j] *= row[VALUE]
        elif kind == DELAY:
            fraction[j] = _delayed(memory, j, row[VALUE], dt_s)
