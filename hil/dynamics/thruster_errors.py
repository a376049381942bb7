"""Error model of the thrusters: valves that answer late, thrust that rises and tails off, scatter, falling pressure.

The thrust of a step is its mean over the step, integrated exactly.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.maths import elementary
from hil.maths.limits import to_integer
from hil.models.faults import normal

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
