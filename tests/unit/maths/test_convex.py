"""Distance between convex hulls: closed forms, an optimiser as oracle, and degenerate hulls."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.optimize import nnls

from hil.core.messages import Array
from hil.maths.convex import separation

MAX_POINTS = 16


def box(centre: tuple[float, float, float], half: tuple[float, float, float]) -> Array:
    """Return the eight corners of a box along the axes."""
    return np.array(centre) + np.array(list(product((-1.0, 1.0), repeat=3))) * np.array(half)


def distance(a: Array, b: Array) -> tuple[float, Array]:
    """Return the distance between the hulls and the normal."""
    rows = np.full((2, MAX_POINTS, 3), np.nan)  # places beyond the number of points are never read
    rows[0, : len(a)], rows[1, : len(b)] = a, b
    normal = np.empty(3)
    return float(separation(rows[0], len(a), rows[1], len(b), normal)), normal


def oracle(a: Array, b: Array) -> float:
    """Return the same distance by non-negative least squares, with the sums of the weights as stiff equations."""
    n, m, stiff = len(a), len(b), 1e5
    sums = stiff * np.array([[1.0] * n + [0.0] * m, [0.0] * n + [1.0] * m])
    weights, _ = nnls(np.vstack([np.hstack([a.T, -b.T]), sums]), np.array([0.0, 0.0, 0.0, stiff, stiff]))
    return float(np.linalg.norm(a.T @ weights[:n] / weights[:n].sum() - b.T @ weights[n:] / weights[n:].sum()))


@pytest.mark.parametrize(
    ("centre", "expected", "normal"),
    [
        ((3.0, 0.2, -0.1), 1.7, (1.0, 0.0, 0.0)),  # face to face
        ((3.0, 4.0, 0.0), np.hypot(1.7, 2.4), np.array([1.7, 2.4, 0.0]) / np.hypot(1.7, 2.4)),  # edge to edge
        ((3.0, 4.0, -5.0), np.sqrt(1.7**2 + 2.4**2 + 3.1**2), None),  # corner to corner
    ],
)
def test_boxes_are_apart_by_the_gaps_between_their_sides(
    centre: tuple[float, float, float], expected: float, normal: Array | None
) -> None:
    found, direction = distance(box(centre, (0.3, 0.6, 0.9)), box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    assert found == pytest.approx(expected, abs=1e-12)
    if normal is not None:
        assert direction == pytest.approx(np.array(normal), abs=1e-12)


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (0.5, 0.2, 0.1), (1.2999, 0.0, 0.0), (1.25, 1.5, 1.8)])
def test_hulls_that_meet_have_no_distance_and_no_normal(centre: tuple[float, float, float]) -> None:
    found, normal = distance(box(centre, (0.3, 0.6, 0.9)), box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    assert found == 0.0
    assert not normal.any()


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([[1.0, 2.0, 2.0]], [[0.0, 0.0, 0.0]], 3.0),
        ([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]], [[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]], 1.0),  # crossing rods
        ([[1.0, 0.0, 0.0], [1.0, 5.0, 0.0]], [[0.0, 1.0, 0.0], [0.0, 9.0, 0.0]], 1.0),  # parallel rods
        ([[0.0, 0.0, 1.0]] * 5, [[2.0, 0.0, 0.0], [-2.0, 2.0, 0.0], [-2.0, -2.0, 0.0]], 1.0),  # a plate
        ([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, 3.0]], [[0.0, 0.0, -1.0]], 2.0),  # on one line
        ([[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]], 0.0),
    ],
)
def test_degenerate_hulls(a: list[list[float]], b: list[list[float]], expected: float) -> None:
    assert distance(np.array(a), np.array(b))[0] == pytest.approx(expected, abs=1e-12)
    assert distance(np.array(b), np.array(a))[0] == pytest.approx(expected, abs=1e-12)


def test_random_hulls_agree_with_an_optimiser_and_their_normal_is_the_gradient() -> None:
    random = np.random.default_rng(1)
    for k in range(500):
        n, m = random.integers(1, MAX_POINTS + 1, 2)
        a = random.standard_normal((n, 3)) * random.choice([1e-3, 0.1, 1.0], 3)
        b = random.standard_normal((m, 3)) + random.standard_normal(3) * random.choice([0.0, 1.0, 5.0])
        if k % 5 == 0:
            a[:, 0] = 0.3  # a plate
        if k % 7 == 0:
            b = np.round(b)  # points that coincide and faces with many points
        found, normal = distance(a, b)
        assert found == pytest.approx(oracle(a, b), abs=1e-8)
        if found > 0.0:
            assert float((a @ normal).min() - (b @ normal).max()) == pytest.approx(found, abs=1e-12)
