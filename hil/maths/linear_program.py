"""Small linear programs by the dual simplex method (Lemke 1954), in a condensed tableau on the stack."""

from __future__ import annotations

from typing import Final

from hil.core.jit import kernel

_TINY: Final = 1e-12  # of a pivot and of what a row lacks, relative to rows of about 1


@kernel
def minimise(tableau, columns, basis):
    """Solve ``min c x`` with ``A x <= b`` and ``x >= 0`` for ``c >= 0``; return whether there is a solution.

    tableau: (m + 1, n + 1), [[A, b], [c, 0]], overwritten; its last entry is then minus the minimum. columns: (n,),
    basis: (m,), work. Row i of the last column is then the value of variable ``basis[i]``, if that is less than n; all
    other variables are zero. With ``c >= 0`` the start is dual feasible, whatever the sign of ``b``, and without a
    negative entry in ``b`` it is the solution.
    """
    m, n = tableau.shape[0] - 1, tableau.shape[1] - 1
    for j in range(n):
        columns[j] = j
    for i in range(m):
        basis[i] = n + i
    for _ in range(20 * (m + n)):
        row = 0
        for i in range(1, m):
            if tableau[i, n] < tableau[row, n]:
                row = i
        if tableau[row, n] >= -_TINY:
            return True
        column, least = -1, 0.0
        for j in range(n):
            if tableau[row, j] < -_TINY:
                ratio = -tableau[m, j] / tableau[row, j]
                if column < 0 or ratio < least:
                    column, least = j, ratio
        if column < 0:
            return False
        _pivot(tableau, row, column)
        columns[column], basis[row] = basis[row], columns[column]
    return False


@kernel
def _pivot(tableau, row, column):
    """Exchange the variables of ``row`` and ``column``."""
    inverse = 1.0 / tableau[row, column]
    for i in range(tableau.shape[0]):
        if i != row:
            factor = tableau[i, column] * inverse
            for j in range(tableau.shape[1]):
                if j != column:
                    tableau[i, j] -= factor * tableau[row, j]
            tableau[i, column] = -factor
    for j in range(tableau.shape[1]):
        tableau[row, j] *= inverse
    tableau[row, column] = inverse
