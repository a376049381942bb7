"""Quantiles of the chi-square distribution against scipy's."""

from __future__ import annotations

import pytest
from scipy.stats import chi2, norm

from hil.maths.chi_square import lower_quantile, two_sided_tail, upper_quantile


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 7, 30, 192, 1536])
@pytest.mark.parametrize("probability", [1e-300, 1e-12, 1e-6, 0.1, 0.5, 0.9, 1.0 - 1e-9])
def test_quantiles_are_those_of_scipy(dof: int, probability: float) -> None:
    assert lower_quantile(probability, dof) == pytest.approx(chi2.ppf(probability, dof), rel=1e-9)
    assert upper_quantile(probability, dof) == pytest.approx(chi2.isf(probability, dof), rel=1e-9)


@pytest.mark.parametrize("sigma", [0.0, 1.0, 5.0, 30.0])
def test_two_sided_tail_is_that_of_the_normal_distribution(sigma: float) -> None:
    assert two_sided_tail(sigma) == pytest.approx(2.0 * norm.sf(sigma), rel=1e-12)
