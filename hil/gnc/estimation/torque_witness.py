"""The gyros as a witness of a force that was not commanded: a valve that leaks turns the chaser as well.

While no thruster is open the rate changes by torques of the surroundings, by the bending of arrays, which has no mean,
and by the torque of a leak. Gyros measure it a hundred times better than accelerometers measure its force. When the
mean angular acceleration changes, the force without a command may have changed by as much as the thruster with the
shortest arm gives with that torque; it is then estimated again, before the poses that follow it are accused.
docs/explanation/commanded-thrust.md
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths.arrays import copy_into

STAGES: Final = 3
"""Low-passes in a row that make the mean: a period of bending of four seconds is left by a hundredth."""

TORQUE_PARAMS = np.dtype(
    [
        ("weight", "f8"),  # weight of a step in each low-pass
        ("delay", "i8"),  # steps, of the mean
        ("limit", "f8"),  # rad/s^2, change of the mean that is none of a leak
        ("bending", "f8"),  # of the mean torque of the firings, that bending leaves of it
        ("turning", "f8"),  # of the square of the rate, which the assumed inertia tensor may leave unexplained
        ("most", "f8"),  # rad/s^2: the accelerometers show the force of a larger change
        ("force", "f8"),  # m/s^2 for each rad/s^2, largest of a thruster
    ],
    align=True,
)

TORQUE_STATE = np.dtype(
    [
        ("mean", "f8", (STAGES, 3)),  # rad/s^2, in c, of the steps without thrust: output of each low-pass
        ("known", "f8", 3),  # rad/s^2, before the change under way
        ("fired", "f8"),  # rad/s^2, mean of the firings
        ("admitted", "f8"),  # rad/s^2, of that change
        ("since", "i8"),  # steps without thrust since then
    ],
    align=True,
)

_MORE = 1.25  # times what was admitted
_FIRED = 0.1  # of the weight of a low-pass: bending lasts longer
_DELAYS = 4  # after which a change is over


@kernel
def count_firings(params, state, torque):
    """Take the commanded ``torque`` (3,), rad/s^2, of a step into the mean of the firings."""
    size = abs(torque[0]) + abs(torque[1]) + abs(torque[2])
    state.fired += _FIRED * params.weight * (size - state.fired)


@kernel
def watch(params, state, previous, rate, dt_s):
    """Return by how much more the force may differ, m/s^2, 1 sigma, after a step without thrust; 0 for nothing new.

    previous, rate: (3,), rad/s, in c, before and after that step.
    """
    state.since += 1
    if state.admitted > 0.0 and state.since > _DELAYS * params.delay:
        copy_into(state.known, state.mean[STAGES - 1])
        state.admitted = 0.0
    change, square = 0.0, 0.0
    for i in range(3):
        value = (rate[i] - previous[i]) / dt_s
        for k in range(STAGES):
            state.mean[k, i] += params.weight * (value - state.mean[k, i])
            value = state.mean[k, i]
        change += (value - state.known[i]) ** 2
        square += rate[i] ** 2
    change = min(math.sqrt(change), params.most)
    natural = params.limit + params.bending * state.fired + params.turning * square
    if change <= max(natural, _MORE * state.admitted):
        return 0.0
    more = math.sqrt(change**2 - state.admitted**2)
    state.admitted, state.since = change, 0
    return more * params.force
