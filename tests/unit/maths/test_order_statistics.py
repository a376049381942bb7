"""Order statistics against the published table and the binomial distribution."""

from __future__ import annotations

import math

import pytest
from scipy.stats import binom

from hil.maths.order_statistics import acceptance_risk, allowed_failures, cases_needed

PUBLISHED = [
    (0.95, 0.05, 0, 59),  # Wilks, Ann. Math. Stat. 12 (1941) 91
    (0.95, 0.05, 1, 93),
    (0.95, 0.05, 2, 124),
    (0.95, 0.05, 3, 153),
    (0.95, 0.05, 4, 181),
    (0.99, 0.05, 0, 299),
    (0.90, 0.10, 0, 22),
    (0.99865, 0.10, 0, 1705),  # ln 0.1 / ln 0.99865
    (0.9973, 0.10, 0, 852),  # ln 0.1 / ln 0.9973
]
"""Probability, consumer's risk, failures, cases."""


@pytest.mark.parametrize(("probability", "risk", "failures", "cases"), PUBLISHED)
def test_cases_of_the_published_tables(probability: float, risk: float, failures: int, cases: int) -> None:
    assert cases_needed(failures, probability, risk) == cases
    assert allowed_failures(cases, probability, risk) == failures
    assert allowed_failures(cases - 1, probability, risk) == failures - 1


def test_table_of_three_sigma_at_ten_percent_risk_is_the_binomial_one() -> None:
    for failures in range(20):
        cases = cases_needed(failures, 0.9973, 0.1)
        assert binom.cdf(failures, cases, 1.0 - 0.9973) <= 0.1 < binom.cdf(failures, cases - 1, 1.0 - 0.9973)
    assert acceptance_risk(1000, 0, 0.9973) == pytest.approx(math.exp(1000 * math.log(0.9973)))


def test_a_million_cases_are_judged_at_once() -> None:
    assert allowed_failures(10_000_000, 1.0 - 1e-6, 0.1) == binom.ppf(0.1, 10_000_000, 1e-6) - 1
