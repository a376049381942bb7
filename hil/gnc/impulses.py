"""Least sum of impulses between two states of relative motion in a given time, on a circle or an ellipse.

With the transition ``Phi`` of Yamanaka and Ankersen, impulses ``u_i`` at times ``t_i`` and ``A_i`` the columns of
``Phi(t_end, t_i)`` that belong to the velocity,

    min sum |u_i|    with    sum A_i u_i = b = x_end - Phi(t_end, t_begin) x_begin

Its dual is ``max b l`` with ``|A_i' l| <= 1``: ``A_i' l`` is the primer vector (Lawden 1963; Neustadt, SIAM Journal on
Control 3 (1965) 317-356, for the linear problem), and each ``l`` gives a lower bound of the sum, ``b l / max |A' l|``.
The sum is minimised by least squares that are weighted again (Weiszfeld 1937): with ``w_i = |u_i|`` of the iteration
before, ``l = (sum w_i A_i A_i')^-1 b`` and ``u_i = w_i A_i' l``, which never increases it. Two impulses are the case of
two times, and need no iteration.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import cholesky, stack
from hil.maths.arrays import copy_into, fill, fill_matrix
from hil.models.elliptic_motion import transition_into

TIMES: Final = 33
"""At which there may be an impulse, equidistant."""
MAX_IMPULSES: Final = 8
_CHECKED: Final = 129  # times at which the primer vector is compared with 1
_ITERATIONS: Final = 300
_CONVERGED: Final = 1e-4  # gap between sum and bound
_SMALL: Final = 1e-3  # fraction of the sum: an impulse that counts while neighbours are gathered
_LEAST: Final = 0.01  # fraction of the sum: an impulse that is fired
_RIDGE: Final = 1e-15

IMPULSE_PROGRAM = np.dtype(
    [
        ("n", "i8"),
        ("duration_s", "f8"),
        ("at_s", "f8", TIMES),
        ("a", "f8", (TIMES, 6, 3)),  # positions over the duration, so that all rows are velocities
        ("b", "f8", 6),
        ("u", "f8", (TIMES, 3)),
        ("l", "f8", 6),
        ("sum", "f8"),
    ],
    align=True,
)

TRANSFER_WORK = np.dtype([("program", IMPULSE_PROGRAM), ("whole", "f8", (6, 6))], align=True)
"""What planning needs; zeroed at the start."""


@kernel
def size_of(v):
    """Return the length of ``v`` (3,)."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@kernel
def move(orbit, begin_s, t_s, state, whole, out):
    """Write the state ``out`` (6,) that ``state`` at ``begin_s`` of the run becomes after ``t_s``. whole: work."""
    transition_into(orbit.mean_motion, orbit.eccentricity, orbit.mean_anomaly + orbit.mean_motion * begin_s, t_s, whole)
    for i in range(6):
        out[i] = 0.0
        for j in range(6):
            out[i] += whole[i, j] * state[j]


@kernel
def set_times(orbit, begin_s, program, whole):
    """Write ``program.a`` for the times of ``program``."""
    for k in range(program.n):
        m = orbit.mean_anomaly + orbit.mean_motion * (begin_s + program.at_s[k])
        transition_into(orbit.mean_motion, orbit.eccentricity, m, program.duration_s - program.at_s[k], whole)
        for i in range(6):
            scale = 1.0 / program.duration_s if i < 3 else 1.0
            for j in range(3):
                program.a[k, i, j] = scale * whole[i, 3 + j]


@kernel
def _solve(weights, program):
    """Write ``l`` and ``u`` of ``program`` for the ``weights`` (n,) of its times; return what is left of ``b``."""
    g, y = stack.matrix(6, 6), stack.vector(6)
    fill_matrix(g, 0.0)
    for k in range(program.n):
        for i in range(6):
            for j in range(i + 1):
                for m in range(3):
                    g[i, j] += weights[k] * program.a[k, i, m] * program.a[k, j, m]
    trace = 0.0
    for i in range(6):
        trace += g[i, i]
    for i in range(6):
        g[i, i] += _RIDGE * trace
    program.sum, square, size = 0.0, 0.0, 0.0
    if not cholesky.factor(g, 6, g):  # these times do not reach all states
        fill(program.l, 0.0)
        fill_matrix(program.u, 0.0)
        return np.inf
    cholesky.solve(g, 6, program.b, program.l)
    copy_into(y, program.b)
    for k in range(program.n):
        for m in range(3):
            primer = 0.0
            for i in range(6):
                primer += program.a[k, i, m] * program.l[i]
            program.u[k, m] = weights[k] * primer
            for i in range(6):
                y[i] -= program.a[k, i, m] * program.u[k, m]
        program.sum += size_of(program.u[k])
    for i in range(6):
        square += y[i] * y[i]
        size += program.b[i] * program.b[i]
    return math.sqrt(square / size) if size > 0.0 else 0.0


@kernel
def _longest_primer(program):
    """Return the length of the longest primer vector over the times of ``program``."""
    longest = 0.0
    for k in range(program.n):
        square = 0.0
        for m in range(3):
            primer = 0.0
            for i in range(6):
                primer += program.a[k, i, m] * program.l[i]
            square += primer * primer
        longest = max(longest, square)
    return math.sqrt(longest)


@kernel
def _bound(program):
    """Return the lower bound of the sum that ``program.l`` gives, m/s, over the times of ``program``."""
    longest, product = _longest_primer(program), 0.0
    for i in range(6):
        product += program.b[i] * program.l[i]
    return product / longest if longest > 0.0 else 0.0


@kernel
def minimise(program):
    """Write the impulses of the least sum at the times of ``program``; return what is left of ``b``."""
    weights = stack.vector(TIMES)
    fill(weights, 1.0)
    missed = 0.0
    for _ in range(_ITERATIONS):
        missed = _solve(weights, program)
        if program.n == 2 or program.sum - _bound(program) <= _CONVERGED * program.sum:
            break
        for k in range(program.n):
            weights[k] = max(size_of(program.u[k]), 1e-9 * program.sum)
    return missed


@kernel
def spread_times(program, n):
    """Spread ``n`` times evenly over the duration of ``program``, begin and end included."""
    program.n = n
    for k in range(n):
        program.at_s[k] = program.duration_s * k / (n - 1)


@kernel
def gather(program):
    """Replace neighbours among the impulses by one for each local maximum; the first and the last time stay."""
    kept, last = 1, program.n - 1
    total, moment, falls = 0.0, 0.0, False
    for k in range(1, last + 1):
        size = size_of(program.u[k]) if k < last else 0.0
        previous = size_of(program.u[k - 1]) if k > 1 else 0.0
        ends = size <= _SMALL * program.sum or (falls and size > previous)
        if ends and total > 0.0 and kept < MAX_IMPULSES - 1:
            program.at_s[kept] = moment / total
            kept += 1
        if ends:
            total, moment = 0.0, 0.0
        falls = size < previous
        if size > _SMALL * program.sum:
            total += size
            moment += size * program.at_s[k]
    program.at_s[kept] = program.at_s[last]
    program.n = kept + 1


@kernel
def prune(program):
    """Drop impulses between the first and the last that hardly count."""
    kept, last = 1, program.n - 1
    for k in range(1, last + 1):
        if k == last or size_of(program.u[k]) > _LEAST * program.sum:
            program.at_s[kept] = program.at_s[k]
            kept += 1
    program.n = kept


@kernel
def _demand(orbit, begin_s, start, end, program, whole):
    """Write ``program.b``, which impulses have to give. start, end: states (6,)."""
    moved = stack.vector(6)
    move(orbit, begin_s, program.duration_s, start, whole, moved)
    for i in range(6):
        program.b[i] = (end[i] - moved[i]) / (program.duration_s if i < 3 else 1.0)


@kernel
def least_impulses(orbit, begin_s, duration_s, start, end, work):
    """Return a lower bound of the sum of any number of impulses, m/s, that lead from ``start`` to ``end`` (6,).

    orbit: TARGET_ORBIT, whose axes are those of the Hill frame. begin_s: time of the run. work: TRANSFER_WORK.
    The impulses of the least sum at ``TIMES`` times are left in ``work.program.u``.
    """
    program = work.program
    program.duration_s = duration_s
    if duration_s <= 0.0:
        return 0.0
    _demand(orbit, begin_s, start, end, program, work.whole)
    spread_times(program, TIMES)
    set_times(orbit, begin_s, program, work.whole)
    minimise(program)
    return _certified(orbit, begin_s, program, work.whole)


@kernel
def _certified(orbit, begin_s, program, whole):
    """Return the bound by ``program.l`` with the primer vector between the times as well; uses up ``program.a``."""
    longest, product = 0.0, 0.0
    for i in range(6):
        product += program.b[i] * program.l[i]
    for part in range(0, _CHECKED - 1, TIMES - 1):
        program.n = TIMES
        for k in range(TIMES):
            program.at_s[k] = program.duration_s * (part + k) / (_CHECKED - 1)
        set_times(orbit, begin_s, program, whole)
        longest = max(longest, _longest_primer(program))
    return product / longest if longest > 0.0 else 0.0
