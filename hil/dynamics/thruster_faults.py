"""Thrusters with errors and faults: from the command of a valve to its thrust."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.dynamics.thruster_errors import (
    STEPS_KEPT,
    THRUSTER_ERROR_MEMORY,
    pressure,
    record_valves,
    thrust_of_valve,
)
from hil.maths import stack
from hil.maths.arrays import copy_into
from hil.maths.limits import to_integer
from hil.models.faults import KIND, NUMBER, VALUE, is_active
from hil.models.valves import step_valves

STUCK_OPEN, STUCK_CLOSED, LEAK, FORCE_SCALE, DELAY, MINIMUM_ON = range(6)

DELAY_STEPS_MAX = STEPS_KEPT - 2
"""Steps of the longest delay."""

THRUST_MEMORY = np.dtype(
    [("next", "i8"), ("fraction", "f8", (STEPS_KEPT, MAX_THRUSTERS)), ("errors", THRUSTER_ERROR_MEMORY)],
    align=True,
)
"""Thrust over nominal thrust in the last steps, a ring."""


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
    steps = to_integer(math.floor(delay_s / dt_s))
    share = delay_s / dt_s - steps
    newest = memory.next + 2 * STEPS_KEPT - 1
    late = memory.fraction[(newest - steps) % STEPS_KEPT, thruster]
    later = memory.fraction[(newest - steps - 1) % STEPS_KEPT, thruster]
    return (1.0 - share) * late + share * later


@kernel
def step_real_valves(faults, errors, memory, truth, on, minimum_on_s, dt_s, fraction):
    """``step_valves`` with the error model of the thrusters and the faults that act at the start of the step.

    faults: FAULTS. errors: THRUSTER_ERRORS. memory: THRUST_MEMORY. truth: TRUTH, whose ``open_s`` are updated.
    fraction: (n,), receives thrust over nominal thrust, which scatter and FORCE_SCALE may raise above 1.
    """
    t_s, open_s = truth.t_s, truth.open_s
    opened = stack.vector(MAX_THRUSTERS)
    copy_into(opened, open_s)
    for j in range(on.shape[0]):
        shortest_s = _minimum_on(faults, t_s, j, minimum_on_s)
        step_valves(on[j : j + 1], open_s[j : j + 1], shortest_s, dt_s, fraction[j : j + 1])
    if errors.enabled != 0:
        record_valves(errors, memory.errors, fraction, opened, minimum_on_s, dt_s)
        for j in range(on.shape[0]):
            fraction[j] = thrust_of_valve(errors, memory.errors, j, dt_s)
    copy_into(memory.fraction[memory.next, : on.shape[0]], fraction)
    memory.next = (memory.next + 1) % STEPS_KEPT
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
    if errors.half_pressure_kg > 0.0:
        supply = pressure(errors, truth.mass_kg)
        for j in range(on.shape[0]):
            fraction[j] *= supply
