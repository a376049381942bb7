"""Evidence for the name of a cause: likelihoods over a stored window of the IMU's residuals against commanded thrust.

Residuals may be those of a thruster that is stuck open or dead, of an IMU that reads anything up to what thrusters can
do, or of a chaser that swings by a flexible mode or slosh which the GNC does not have. A swing goes to the other side
and back, and is predicted by the residuals before it; a bias stays on its side, noise and a thruster that fails are not
predicted. A device is named only if it is likelier by far than a swing and than that nothing is wrong.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import entry, kernel
from hil.core.messages import MAX_THRUSTERS
from hil.maths import cholesky, elementary, stack
from hil.maths.arrays import fill, fill_matrix

ROWS: Final = 128
"""Rows of the window, one of them under way."""
CYCLES: Final = 8
"""Cycles whose mean is a row."""
_ORDER = 4  # rows before one that predict it: of two modes
_SIGMA = 0.05  # of a row with neither fault nor swing, in the units of the thruster monitor
_RANGE = 4.0  # of the readings of an IMU that is wrong, in these units
_BROAD = elementary.log(_RANGE / (_SIGMA * math.sqrt(2.0 * math.pi)))  # cost of a reading anywhere in that range
_STANDS_OUT = 10.0  # difference of log likelihoods
_MOST = 0.5  # of what a swing leaves
_ONE_SIDED = 0.6  # sum of a swing's rows over that of their sizes, at most
_THRUST_MIN = 0.3  # fraction of the thrust that an open thruster has, or a dead one lacks

EVIDENCE_STATE = np.dtype(
    [
        ("residual", "f8", (ROWS, 6)),  # in the units of the thruster monitor, a ring
        ("thrust", "f8", (ROWS, MAX_THRUSTERS)),  # expected
        ("odd", "i8", ROWS),  # 1: most of the row is explained neither by thrusters nor by wrong parameters
        ("row", "i8"),  # under way
        ("n", "i8"),  # complete rows since the start or a pause
        ("cycles", "i8"),  # of the row under way
        ("odd_cycles", "i8"),
    ],
    align=True,
)


@kernel
def keep(evidence, residual, thrust, n, odd):
    """Take the ``residual`` (6,) of a cycle and the expected ``thrust`` (n,). odd: nothing explains the residual."""
    row = evidence.row
    if evidence.cycles == 0:
        fill(evidence.residual[row], 0.0)
        fill(evidence.thrust[row], 0.0)
    for i in range(6):
        evidence.residual[row, i] += residual[i] / CYCLES
    for j in range(n):
        evidence.thrust[row, j] += thrust[j] / CYCLES
    evidence.cycles += 1
    evidence.odd_cycles += 1 if odd else 0
    if evidence.cycles == CYCLES:
        evidence.odd[row] = 1 if 2 * evidence.odd_cycles > CYCLES else 0
        evidence.row, evidence.n = (row + 1) % ROWS, min(ROWS - 1, evidence.n + 1)
        evidence.cycles = evidence.odd_cycles = 0


@kernel
def forget(evidence):
    """Forget all rows."""
    evidence.n = evidence.cycles = evidence.odd_cycles = 0


@kernel
def _row(evidence, k):
    """Return the place in the ring of row ``k``, from the oldest one on."""
    return (evidence.row - evidence.n + k + ROWS) % ROWS


@entry
def _unpredicted(y, n):
    """Return the square of what the rows before leave of ``y`` (n,), but for the first rows."""
    a, low = stack.matrix(_ORDER, _ORDER), stack.matrix(_ORDER, _ORDER)
    b, x = stack.vector(_ORDER), stack.vector(_ORDER)
    fill_matrix(a, 0.0)
    fill(b, 0.0)
    square, predicted = 0.0, 0.0
    for k in range(_ORDER, n):
        square += y[k] * y[k]
        for p in range(_ORDER):
            b[p] += y[k] * y[k - 1 - p]
            for q in range(p + 1):
                a[p, q] += y[k - 1 - p] * y[k - 1 - q]
    if cholesky.solve_damped(a, 1e-6, b, low, x):
        for p in range(_ORDER):
            predicted += x[p] * b[p]
    return square - predicted


@entry
def names_imu(evidence):
    """Return whether wrong readings of the IMU stand out from a swing and from nothing wrong."""
    y, gain, n = stack.vector(ROWS), 0.0, evidence.n
    for i in range(6):
        wrong, square, total, sizes = 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            row = _row(evidence, k)
            y[k] = evidence.residual[row, i]
            if k < _ORDER:
                continue
            total, sizes, square = total + y[k], sizes + abs(y[k]), square + y[k] ** 2
            if evidence.odd[row] != 0:
                wrong += max(0.0, 0.5 * (y[k] / _SIGMA) ** 2 - _BROAD)
        if wrong > 0.0 and abs(total) > _ONE_SIDED * sizes:
            gain += wrong
        elif wrong > 0.0:
            gain += max(0.0, wrong - 0.5 * (square - _unpredicted(y, n)) / _SIGMA**2)
    return gain > _STANDS_OUT


@kernel
def _write_failed(evidence, signature, j, opens, x):
    """Write the thrust that thruster ``j``, open or else dead, has not as expected in each row, ``x`` (ROWS, 6)."""
    for k in range(evidence.n):
        expected = evidence.thrust[_row(evidence, k), j]
        for i in range(6):
            x[k, i] = (1.0 - expected if opens else -expected) * signature[j, i]


@kernel
def _write_late(evidence, signature, x):
    """Write the thrust beyond the expected one if all that fire in a row stay open in it, ``x`` (ROWS, 6)."""
    fill_matrix(x, 0.0)
    for k in range(evidence.n):
        for j in range(signature.shape[0]):
            expected = evidence.thrust[_row(evidence, k), j]
            for i in range(6):
                x[k, i] += (1.0 - expected if expected > 0.0 else 0.0) * signature[j, i]


@kernel
def _gain(evidence, x, back, least, before, y):
    """Return what ``x`` (ROWS, 6), since ``back`` rows, explains of ``before``, what a swing leaves.

    least: fraction of ``x`` below which it explains nothing. y: (ROWS,), scratch.
    """
    product, size, gain, n = 0.0, 0.0, 0.0, evidence.n
    for k in range(n - back, n):
        for i in range(6):
            product += evidence.residual[_row(evidence, k), i] * x[k, i]
            size += x[k, i] ** 2
    if product < least * size or size == 0.0:
        return 0.0
    for i in range(6):
        for k in range(n):
            y[k] = evidence.residual[_row(evidence, k), i]
            if k >= n - back:
                y[k] -= min(1.0, product / size) * x[k, i]
        gain += before[i] - _unpredicted(y, n)
    return gain


@kernel
def _largest_gain(evidence, x, least, before, y):
    """Return the largest ``_gain`` of ``x`` since any number of rows, from 2 on."""
    largest, back = 0.0, 2
    while back <= evidence.n:
        largest = max(largest, _gain(evidence, x, back, least, before, y))
        back += max(1, back // 4)
    return largest


@entry
def names_thruster(evidence, signature, j, opens):
    """Return whether thruster ``j``, open or else dead, explains what a swing leaves; signature: (n, 6), of each.

    It stands out, or explains most of that, and more than valves that close late do. It may have failed any number of
    rows ago, from 2 on. A run that has just begun has no swing yet.
    """
    y, before, x, n, total = stack.vector(ROWS), stack.vector(6), stack.matrix(ROWS, 6), evidence.n, 0.0
    if n <= 2 * _ORDER:
        return True
    for i in range(6):
        for k in range(n):
            y[k] = evidence.residual[_row(evidence, k), i]
        before[i] = _unpredicted(y, n)
        total += before[i]
    _write_failed(evidence, signature, j, opens, x)
    gain = _largest_gain(evidence, x, _THRUST_MIN, before, y)
    if gain <= min(2.0 * _SIGMA**2 * _STANDS_OUT, _MOST * total):
        return False
    _write_late(evidence, signature, x)
    return gain > _largest_gain(evidence, x, 0.0, before, y)
