"""Thrusters with errors and faults: from the command of a valve to its thrust.

Valves answer late, thrust rises and tails off, scatters, and falls with the pressure. The thrust of a step is its mean
over the step, integrated exactly.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.maths import elementary, stack
from hil.maths.arrays import copy_into
from hil.maths.limits import to_integer
from hil.models.faults import KIND, NUMBER, VALUE, is_active, normal
from hil.models.valves import step_valves

THRUSTER_ERRORS = np.dtype(
    [
        ("enabled", "i8"),  # 1: any of the errors below
        ("seed", "i8"),
        ("delay_s", "f8"),  # from a command to the valve
        ("rise_s", "f8"),  # time constant of the thrust once the valve is open
        ("tail_off_s", "f8"),  # and once it is closed
        ("impulse_scatter", "f8"),  # relative scatter of the impulse at minimum on-time
        ("half_pressure_kg", "f8"),  # propellant after which the pressure is a half, 0 for a regulated supply
        ("mass_full_kg", "f8"),  # mass of the chaser at the start
    ],
    align=True,
)

STEPS_KEPT = 130
THRUSTER_ERROR_MEMORY = np.dtype(
    [
        ("next", "i8"),
        ("fraction", "f8", (STEPS_KEPT, MAX_THRUSTERS)),
        ("gain", "f8", (STEPS_KEPT, MAX_THRUSTERS)),
        ("level", "f8", MAX_THRUSTERS),
        ("firings", "i8", MAX_THRUSTERS),
    ],
    align=True,
)
"""fraction, gain: open part of the last steps and thrust while it is open, rings. level: thrust over nominal thrust at
the end of the step. firings: so far."""

_LEAST_LEVEL = 1e-3  # a smaller thrust of a closed valve is none
_LANE = 16384


@kernel
def _impulse(level, target, constant_s, span_s):
    """Return the integral of a thrust that goes from ``level`` to ``target`` with a time constant, over ``span_s``."""
    if constant_s <= 0.0:
        return target * span_s
    return target * span_s - (level - target) * constant_s * elementary.expm1(-span_s / constant_s)


@kernel
def _settled(level, target, constant_s, span_s):
    """Return the thrust after ``span_s``."""
    if span_s <= 0.0:
        return level
    if constant_s <= 0.0:
        return target
    return target + (level - target) * elementary.exp(-span_s / constant_s)


@kernel
def record_valves(errors, memory, fraction, opened, minimum_on_s, dt_s):
    """Keep the open part of this step, ``fraction`` (n,), with the thrust that each firing has.

    opened: (n,), s, time for which each valve had been open before the step; (n,) 0 for a closed one. Scatter acts on
    the minimum on-time of a firing, so that the relative error of a longer one is smaller.
    """
    row = memory.next
    for j in range(fraction.shape[0]):
        gain = 1.0
        if fraction[j] > 0.0:
            if opened[j] == 0.0:
                memory.firings[j] += 1
            scattered = min(1.0, max(0.0, minimum_on_s - opened[j]) / (fraction[j] * dt_s))
            if scattered > 0.0 and errors.impulse_scatter > 0.0:
                drawn = errors.impulse_scatter * normal(errors.seed, memory.firings[j], _LANE + j)
                gain = max(0.0, 1.0 + scattered * drawn)
        memory.fraction[row, j] = fraction[j]
        memory.gain[row, j] = gain
    memory.next = (row + 1) % STEPS_KEPT


@kernel
def thrust_of_valve(errors, memory, j, dt_s):
    """Return thrust over nominal thrust of thruster ``j``, mean over the step that ``record_valves`` has kept last.

    The valve follows late: the step has the end of one kept step and the beginning of the next.
    """
    steps = to_integer(math.floor(errors.delay_s / dt_s))
    late = errors.delay_s / dt_s - steps
    newest = memory.next + 2 * STEPS_KEPT - 1
    level, impulse = memory.level[j], 0.0
    for part in range(2):
        row = (newest - steps - 1 + part) % STEPS_KEPT
        fraction, gain = memory.fraction[row, j], memory.gain[row, j]
        span = late if part == 0 else 1.0 - late
        is_open = max(0.0, fraction - (1.0 - late)) if part == 0 else min(fraction, span)
        open_s, closed_s = is_open * dt_s, (span - is_open) * dt_s
        impulse += _impulse(level, gain, errors.rise_s, open_s)
        level = _settled(level, gain, errors.rise_s, open_s)
        impulse += _impulse(level, 0.0, errors.tail_off_s, closed_s)
        level = _settled(level, 0.0, errors.tail_off_s, closed_s)
        if closed_s > 0.0 and level < _LEAST_LEVEL:
            level = 0.0
    memory.level[j] = level
    return impulse / dt_s


@kernel
def pressure(errors, mass_kg):
    """Return the supply pressure over that at the start: gas that expands at constant temperature (blow-down)."""
    if errors.half_pressure_kg <= 0.0:
        return 1.0
    return errors.half_pressure_kg / (errors.half_pressure_kg + errors.mass_full_kg - mass_kg)


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
