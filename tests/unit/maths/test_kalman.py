"""Covariances of filters against the textbook formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from hil.maths import kalman


def positive_definite(rng: np.random.Generator, n: int) -> np.ndarray:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_covariance_propagates_as_phi_p_phi_t_plus_noise(rng: np.random.Generator) -> None:
    p, noise, phi = positive_definite(rng, 7), positive_definite(rng, 7), rng.standard_normal((7, 7))
    expected = phi @ p @ phi.T + noise
    kalman.propagate_covariance(p, phi, noise)
    np.testing.assert_allclose(p, expected, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(p, p.T)


def test_inverse_of_three_by_three_agrees_with_numpy(rng: np.random.Generator) -> None:
    for _ in range(20):
        s, inverse, root = positive_definite(rng, 3), np.empty((3, 3)), np.empty((3, 3))
        kalman.invert_symmetric_3(s, inverse)
        kalman.inverse_root_3(s, root)
        np.testing.assert_allclose(inverse, np.linalg.inv(s), rtol=1e-10, atol=1e-11)
        np.testing.assert_allclose(root.T @ root, inverse, rtol=1e-10, atol=1e-11)


def test_normalised_square_agrees_with_solve(rng: np.random.Generator) -> None:
    for n in (3, 6, 9):
        p, error = positive_definite(rng, n), rng.standard_normal(n)
        assert kalman.normalised_square(error, p) == pytest.approx(error @ np.linalg.solve(p, error), rel=1e-11)


def test_normalised_square_of_a_covariance_that_is_none_is_nan() -> None:
    assert np.isnan(kalman.normalised_square(np.ones(3), np.diag([1.0, -1.0, 1.0])))
    assert np.isnan(kalman.normalised_square(np.ones(3), np.zeros((3, 3))))
    assert np.isnan(kalman.normalised_square(np.ones(3), np.full((3, 3), np.nan)))


def test_normalised_square_of_matching_errors_is_chi_square(rng: np.random.Generator) -> None:
    p = positive_definite(rng, 6)
    errors = rng.standard_normal((2000, 6)) @ np.linalg.cholesky(p).T
    total = sum(kalman.normalised_square(np.ascontiguousarray(e), p) for e in errors)
    assert chi2.ppf(0.0005, 12000) < total < chi2.ppf(0.9995, 12000)


def test_more_states_than_the_capacity_are_refused() -> None:
    n = kalman.MAX_STATES + 1
    with pytest.raises(ValueError, match="too many states"):
        kalman.propagate_covariance(np.eye(n), np.eye(n), np.eye(n))
    with pytest.raises(ValueError, match="too many states"):
        kalman.normalised_square(np.ones(n), np.eye(n))
    p = np.eye(kalman.MAX_STATES)
    kalman.propagate_covariance(p, 2.0 * np.eye(len(p)), np.eye(len(p)))
    assert np.array_equal(p, 5.0 * np.eye(len(p)))
