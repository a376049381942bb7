"""Faults of axes, as terms of their servo: SERVO of rails and turntable, numbered 0 to 5."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary
from hil.models.faults import AT, KIND, NUMBER, VALUE, is_active

STUCK, SLOW, OFFSET, OSCILLATION = range(4)

NOMINAL_AXES = np.dtype([("rate_max", "f8", 6)], align=True)
"""What faults change and their end restores, m/s and rad/s."""


@kernel
def _set(row, t_s, axes, i, rate_max):
    """Apply the fault of ``row``, which acts, to axis ``i`` of ``axes`` (SERVO)."""
    kind = row[KIND]
    if kind == STUCK:
        axes.rate[i] = axes.rate_max[i] = 0.0
    elif kind == SLOW:
        axes.rate_max[i] = rate_max * row[VALUE]
    elif kind == OFFSET:
        axes.encoder_offset[i] += row[VALUE]
    elif kind == OSCILLATION:
        phase = 2.0 * math.pi * row[VALUE + 1]
        axes.disturbance[i] += row[VALUE] * elementary.sin(phase * (t_s - row[AT]))
        axes.disturbance_rate[i] += row[VALUE] * phase * elementary.cos(phase * (t_s - row[AT]))


@kernel
def _restore(axes, rate_max):
    """Remove all faults of ``axes`` (SERVO)."""
    for i in range(3):
        axes.encoder_offset[i] = axes.disturbance[i] = axes.disturbance_rate[i] = 0.0
        axes.rate_max[i] = rate_max[i]


@kernel
def set_axis_faults(faults, nominal, t_s, rails, turntable):
    """Apply the faults that act at ``t_s`` of the run to the axes; restore those whose fault has ended.

    faults: FAULTS. nominal: NOMINAL_AXES. rails, turntable: SERVO.
    """
    _restore(rails, nominal.rate_max[:3])
    _restore(turntable, nominal.rate_max[3:])
    for k in range(faults.n):
        row = faults.row[k]
        if is_active(row, t_s):
            number = int(row[NUMBER])
            if number < 3:
                _set(row, t_s, rails, number, nominal.rate_max[number])
            else:
                _set(row, t_s, turntable, number - 3, nominal.rate_max[number])
