"""Valves of on/off thrusters: open with their command, and for a minimum on-time.

The truth steps them with their faults; navigation and thruster monitor expect the nominal ones.
"""

from __future__ import annotations

from hil.core.jit import kernel


@kernel
def step_valves(on, open_s, minimum_on_s, dt_s, fraction):
    """Write the open fraction (0..1) of this step for each of the n thrusters; update ``open_s``.

    on: commands 0 or 1. open_s: state, time for which each valve has been open, 0 for a closed one.
    A valve that opened stays open for at least ``minimum_on_s``, also when its command is
    withdrawn; it then closes within the step in which that time ends.
    """
    for j in range(on.shape[0]):
        if on[j] != 0:
            fraction[j] = 1.0
            open_s[j] += dt_s
        elif 0.0 < open_s[j] < minimum_on_s:
            fraction[j] = min(1.0, (minimum_on_s - open_s[j]) / dt_s)
            open_s[j] += dt_s
            if open_s[j] >= minimum_on_s:
                open_s[j] = 0.0
        else:
            fraction[j] = 0.0
            open_s[j] = 0.0
