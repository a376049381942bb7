"""Faults of the target: it leaves the place where the approach expects it, or plumes push it."""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_FAULTS
from hil.models.faults import KIND, VALUE, is_active

JUMP, DRIFT, PLUME = range(3)

TARGET_MEMORY = np.dtype([("acts", "i8", MAX_FAULTS)], align=True)
"""1 for each fault whose change is in the relative state."""


@kernel
def move_target(faults, memory, truth):
    """Apply the beginning and the end of each fault at the truth's time to the relative state, in H.

    faults: FAULTS. memory: TARGET_MEMORY. truth: TRUTH, whose position and velocity are those against the target.
    """
    for i in range(faults.n):
        row = faults.row[i]
        if row[KIND] == PLUME:
            continue
        acts = 1 if is_active(row, truth.t_s) else 0
        change = acts - memory.acts[i]
        memory.acts[i] = acts
        for j in range(3):
            if row[KIND] == JUMP:
                truth.r_CT_H[j] -= change * row[VALUE + j]
            else:
                truth.v_CT_H[j] -= change * row[VALUE + j]


@kernel
def pushed_radius(faults, t_s, nominal):
    """Return the radius of the target that plumes push at ``t_s``, m; ``nominal`` without a fault. faults: FAULTS."""
    for i in range(faults.n):
        if faults.row[i, KIND] == PLUME and is_active(faults.row[i], t_s):
            return faults.row[i, VALUE]
    return nominal
