"""Sums, products and systems of equations in a fixed order against numpy's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.maths import linear

SHAPES = [
    ((3, 3), (3, 3)), ((7, 3), (3,)), ((3,), (3, 5)), ((5,), (5,)), ((8, 3), (3, 6)),
    ((4, 3, 3), (3, 3)), ((3, 3), (4, 3, 3)), ((4, 2, 3), (4, 3, 5)),
]  # fmt: skip


@pytest.mark.parametrize(("a", "b"), SHAPES)
def test_product_is_that_of_matrices(rng: np.random.Generator, a: tuple[int, ...], b: tuple[int, ...]) -> None:
    x, y = rng.normal(size=a), rng.normal(size=b)
    own = linear.product(x, y)
    assert np.shape(own) == np.shape(x @ y)
    np.testing.assert_allclose(own, x @ y, atol=1e-14)


def test_sums_are_in_the_order_of_the_indices() -> None:
    assert linear.total([1e16, 1.0, 1.0, -1e16]) == 0.0
    assert linear.product([1.0, 1.0, 1.0, 1.0], [1e16, 1.0, 1.0, -1e16]) == 0.0


def test_lengths(rng: np.random.Generator) -> None:
    vectors = rng.normal(size=(5, 4, 3))
    np.testing.assert_allclose(linear.lengths(vectors), np.linalg.norm(vectors, axis=-1), rtol=1e-15)
    assert linear.length((3.0, 4.0)) == 5.0


@pytest.mark.parametrize("n", [1, 3, 6])
def test_systems_and_inverses(rng: np.random.Generator, n: int) -> None:
    a, b = rng.normal(size=(n, n)), rng.normal(size=(n, 2))
    np.testing.assert_allclose(a @ linear.solve(a, b), b, atol=1e-12)
    np.testing.assert_allclose(linear.solve(a, b[:, 0]), linear.solve(a, b)[:, 0], atol=0.0)
    np.testing.assert_allclose(linear.inverse(a) @ a, np.eye(n), atol=1e-12)


def test_system_needs_the_pivots() -> None:
    np.testing.assert_array_equal(linear.solve([[0.0, 1.0], [1.0, 0.0]], [2.0, 3.0]), [3.0, 2.0])


def test_singular_system_is_refused() -> None:
    with pytest.raises(ValueError, match="singular"):
        linear.solve([[1.0, 2.0], [2.0, 4.0]], [1.0, 1.0])


@pytest.mark.parametrize("n", [1, 3, 6])
def test_eigenvalues(rng: np.random.Generator, n: int) -> None:
    a = rng.normal(size=(n, n))
    np.testing.assert_allclose(linear.eigenvalues(a + a.T), np.linalg.eigvalsh(a + a.T), atol=1e-13)
    assert linear.eigenvalues(np.diag([3.0, 1.0, 2.0])) == [1.0, 2.0, 3.0]
    assert not math.isnan(linear.eigenvalues(np.zeros((2, 2)))[0])
