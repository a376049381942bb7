"""Planted drivers are found, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from hil.parts.campaigns.drivers import Candidates, Term, auc, find_drivers, threshold

NAMES = [f"n{j}" for j in range(12)]


def planted(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, set[str]]:
    """Return the numbers of 200 cases, which of them fail for a cause of ``kind``, and the numbers that decide."""
    values = rng.normal(size=(200, len(NAMES)))
    values[:, 6:] = rng.uniform(0.5, 2.0, size=(200, 6))
    size, wanted = {
        "threshold": (values[:, 7], {"n7"}),
        "two-sided": (np.abs(values[:, 2] - 0.2), {"n2"}),
        "saddle": (values[:, 1] * values[:, 4], {"n1", "n4"}),
        "product": (values[:, 8] * values[:, 10], {"n8", "n10"}),
        "none": (rng.normal(size=200), set()),
    }[kind]
    size = size + 0.2 * size.std() * rng.normal(size=200)
    return values, size > np.quantile(size, 0.7), wanted


@pytest.mark.parametrize("kind", ["threshold", "two-sided", "saddle", "product"])
def test_planted_driver_comes_first(kind: str, rng: np.random.Generator) -> None:
    values, failed, wanted = planted(kind, rng)
    found = find_drivers(Candidates(values), NAMES, failed, np.ones(200, bool))
    assert set(list(found.importance)[: len(wanted)]) == wanted
    assert found.score is not None
    assert found.score > 0.8


def test_nothing_is_found_without_a_cause(rng: np.random.Generator) -> None:
    found = [find_drivers(Candidates(v), NAMES, f, np.ones(200, bool)) for v, f, _ in [planted("none", rng)] * 1]
    for _ in range(9):
        values, failed, _ = planted("none", rng)
        found.append(find_drivers(Candidates(values), NAMES, failed, np.ones(200, bool)))
    assert sum(each.nothing_found for each in found) >= 9


def test_few_failures_have_no_driver(rng: np.random.Generator) -> None:
    values = rng.normal(size=(200, len(NAMES)))
    failed = values[:, 0] > np.sort(values[:, 0])[-4]
    assert find_drivers(Candidates(values), NAMES, failed, np.ones(200, bool)).nothing_found


def test_cases_that_are_not_used_do_not_count(rng: np.random.Generator) -> None:
    values, failed, _ = planted("threshold", rng)
    used = np.arange(200) < 190
    one = find_drivers(Candidates(values), NAMES, failed, used)
    failed[190:] = ~failed[190:]
    assert find_drivers(Candidates(values), NAMES, failed, used) == one


def test_threshold_is_the_value_beyond_which_no_case_passes() -> None:
    values = np.linspace(0.0, 1.0, 101)[:, None]
    failed = values[:, 0] > 0.695
    found = threshold(Term("value", (0,)), values, failed)
    assert found == {
        "side": "above", "value": pytest.approx(0.695), "cases": 31, "passes": 0, "other_cases": 70, "other_passes": 70,
    }  # fmt: skip
    assert threshold(Term("value", (0,)), -values, failed)["side"] == "below"
    assert threshold(Term("distance", (0,), (0.5, 0.0)), values, np.abs(values[:, 0] - 0.5) > 0.4)["passes"] == 0


def test_area_under_the_curve_is_the_chance_of_the_right_order() -> None:
    assert auc(np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.0, 1.0, 0.0, 1.0])) == 0.75
    assert auc(np.ones(4), np.array([0.0, 1.0, 0.0, 1.0])) == 0.5
