"""Transfers: burns at the least sum of impulses (``hil.gnc.impulses``), and free motion between them.

A burn takes ``T = |u| / a``, and is centred on its impulse: over it the motion is off by ``(n T)^2 / 24`` of what the
impulse does, 4e-5 for 30 s.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import entry
from hil.gnc.impulses import (
    MAX_IMPULSES,
    TIMES,
    gather,
    least_impulses,
    minimise,
    move,
    prune,
    set_times,
    size_of,
    spread_times,
)
from hil.maths import stack
from hil.maths.arrays import copy_into, fill

_MISSED: Final = 1e-6  # of what impulses have to give, from which on their times do not reach the end
_CENTRED: Final = 6  # plans until the first and the last burn begin and end with the transfer
_CLOSER: Final = 96  # samples of a drift

TRANSFER_PLAN = np.dtype(
    [
        ("n", "i8"),  # impulses; 0: there is no plan
        ("begin_s", "f8"),  # time of the run
        ("duration_s", "f8"),
        ("start", "f8", 6),  # [r, v] in H at the start
        ("at_s", "f8", MAX_IMPULSES),  # centre of each burn, from the start on
        ("impulse", "f8", (MAX_IMPULSES, 3)),  # m/s, in H
        ("burn_s", "f8", MAX_IMPULSES),  # duration
        ("bound", "f8"),  # m/s, that no number of impulses in this time falls below
    ],
    align=True,
)


@entry
def plan_transfer(orbit, begin_s, duration_s, optimal, acceleration, start, point, work, plan):
    """Write ``plan`` (TRANSFER_PLAN) from ``start`` (6,), [r, v], to rest at ``point`` (3,), m, in H.

    orbit: TARGET_ORBIT. begin_s: time of the run. optimal: 0 two impulses, at begin and end; 1 the least sum.
    acceleration: m/s^2 of a burn. work: TRANSFER_WORK. Without a plan, ``plan.n`` is 0: the time does not reach the
    point, or burns take longer than it.
    """
    program, end = work.program, stack.vector(6)
    fill(end, 0.0)
    for i in range(3):
        end[i] = point[i]
    copy_into(plan.start, start)
    plan.begin_s, plan.duration_s, plan.n = begin_s, duration_s, 0
    plan.bound = least_impulses(orbit, begin_s, duration_s, start, end, work)
    if optimal == 0:
        spread_times(program, 2)
        set_times(orbit, begin_s, program, work.whole)
        missed = minimise(program)
    else:
        spread_times(program, TIMES)  # whose impulses the bound has left
        for prunes in range(2):
            if prunes == 0:
                gather(program)
            else:
                prune(program)
            set_times(orbit, begin_s, program, work.whole)
            missed = minimise(program)
    for _ in range(_CENTRED):
        last = program.n - 1
        program.at_s[0] = 0.5 * size_of(program.u[0]) / acceleration
        program.at_s[last] = duration_s - 0.5 * size_of(program.u[last]) / acceleration
        if not program.at_s[0] < program.at_s[last] or missed > _MISSED:
            return
        set_times(orbit, begin_s, program, work.whole)
        missed = minimise(program)
    until = 0.0
    for k in range(program.n):
        copy_into(plan.impulse[k], program.u[k])
        plan.at_s[k] = program.at_s[k]
        plan.burn_s[k] = size_of(program.u[k]) / acceleration
        if plan.at_s[k] - 0.5 * plan.burn_s[k] < until - 1e-3 * duration_s:
            return
        until = plan.at_s[k] + 0.5 * plan.burn_s[k]
    plan.n = program.n


@entry
def on_transfer(orbit, plan, fired, since_s, whole, state, thrust):
    """Write the state (6,) ``since_s`` after the start of ``plan`` and its acceleration by thrust (3,), m/s^2.

    fired: burns that take place, in their order, ``plan.n`` for all. whole: (6, 6), work. A part of a burn acts as two
    impulses at the nodes of Gauss.
    """
    moved, kick = stack.vector(6), stack.vector(6)
    fill(thrust, 0.0)
    move(orbit, plan.begin_s, since_s, plan.start, whole, state)
    for k in range(fired):
        begin = plan.at_s[k] - 0.5 * plan.burn_s[k]
        elapsed = min(since_s - begin, plan.burn_s[k])
        if elapsed <= 0.0 or plan.burn_s[k] <= 0.0:
            continue
        for i in range(3):
            kick[i] = 0.0
            kick[3 + i] = 0.5 * plan.impulse[k, i] * elapsed / plan.burn_s[k]
            if since_s - begin < plan.burn_s[k]:
                thrust[i] = plan.impulse[k, i] / plan.burn_s[k]
        for side in range(2):
            node = begin + elapsed * (0.5 + (side - 0.5) / math.sqrt(3.0))
            move(orbit, plan.begin_s + node, since_s - node, kick, whole, moved)
            for i in range(6):
                state[i] += moved[i]


@entry
def least_drift_range(orbit, plan, horizon_s, whole):
    """Return the least range, m, over ``horizon_s`` after each burn that is missed, with all that follow it.

    Arguments: see ``on_transfer``. The first burn is missed at the start of the transfer.
    """
    state, aside, nearest = stack.vector(6), stack.vector(3), math.inf
    for fired in range(plan.n):
        begin = max(0.0, plan.at_s[fired] - 0.5 * plan.burn_s[fired])
        for k in range(_CLOSER + 1):
            on_transfer(orbit, plan, fired, begin + horizon_s * k / _CLOSER, whole, state, aside)
            nearest = min(nearest, size_of(state))
    return nearest
