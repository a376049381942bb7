"""Isolation valves of the thrusters: upstream of the thruster's own valve, they close once and stay closed."""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS

ISOLATION = np.dtype(
    [("acts", "i8"), ("commanded", "i8", MAX_THRUSTERS), ("elapsed_s", "f8", MAX_THRUSTERS)], align=True
)
"""acts: 1 if a valve was commanded to close. elapsed_s: time since that command, of each thruster."""


@kernel
def isolate(isolation, thrusters):
    """Command the isolation valves of ``thrusters`` (n,), 0 or 1, to close."""
    for j in range(thrusters.shape[0]):
        if thrusters[j] != 0:
            isolation.acts = 1
            isolation.commanded[j] = 1


@kernel
def close_isolated(isolation, closing_s, dt_s, fraction):
    """Cut the thrust (n,) of this step off where an isolation valve was commanded ``closing_s`` ago."""
    for j in range(fraction.shape[0]):
        if isolation.commanded[j] != 0:
            isolation.elapsed_s[j] += dt_s
            if isolation.elapsed_s[j] > closing_s:
                fraction[j] = 0.0
