"""Dual simplex method: minima of random programs against HiGHS."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from hil.maths.linear_program import minimise


def solved(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[bool, np.ndarray, float]:
    """Return whether there is a solution, the variables and the minimum."""
    m, n = a.shape
    tableau, columns, basis = np.zeros((m + 1, n + 1)), np.zeros(n), np.zeros(m)
    tableau[:m, :n], tableau[:m, n], tableau[m, :n] = a, b, c
    found, x = minimise(tableau, columns, basis), np.zeros(n)
    for i, variable in enumerate(basis.astype(int)):
        if variable < n:
            x[variable] = tableau[i, n]
    return found, x, -tableau[m, n]


def test_minima_agree_with_highs_and_infeasible_programs_are_reported() -> None:
    rng, infeasible = np.random.default_rng(1), 0
    for _ in range(200):
        m, n = rng.integers(1, 7, 2)
        a, b, c = rng.standard_normal((m, n)), rng.standard_normal(m), rng.uniform(0.0, 2.0, n)
        found, x, minimum = solved(a, b, c)
        wanted = linprog(c, A_ub=a, b_ub=b, method="highs")
        assert found == (wanted.status == 0)
        infeasible += not found
        if found:
            np.testing.assert_allclose([minimum, c @ x], wanted.fun, rtol=1e-9, atol=1e-9)
            assert (a @ x <= b + 1e-9).all()
            assert (x >= -1e-12).all()
    assert 0 < infeasible < 150


def test_nothing_is_done_where_zero_is_allowed() -> None:
    found, x, minimum = solved(np.array([[1.0, -1.0], [-2.0, 1.0]]), np.array([0.5, 0.0]), np.ones(2))
    assert found
    assert minimum == 0.0
    np.testing.assert_array_equal(x, 0.0)
