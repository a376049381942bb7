"""Subset simulation of functions whose probabilities are known."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import norm

from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths.random_streams import MixedSeed, noise_source, stream
from hil.parts.campaigns.rare_events import (
    ALWAYS,
    ESTIMATED,
    FRESH,
    NEVER,
    STUCK,
    Estimate,
    NormalPoint,
    RareEvent,
    chain_correlation,
    mixed_seeds,
)
from hil.parts.campaigns.subset_simulation import subset_simulation

ONE_IN_A_MILLION = float(norm.isf(1e-6))


def estimate(function: Callable[[Array], float], threshold: float, per_level: int, seed: int, n: int = 5) -> Estimate:
    """Return the estimate for a function of ``n`` standard normals."""
    method = subset_simulation(threshold, per_level, seed)
    generator = np.random.default_rng((seed, 1))
    at: dict[int, Array] = {}

    def value(point: NormalPoint) -> float:
        fresh = generator.standard_normal(n)
        if point.parent == FRESH:
            at[point.number] = fresh
        else:
            at[point.number] = math.sqrt(1.0 - point.scale**2) * at[point.parent] + point.scale * fresh
        return function(at[point.number])

    points = next(method)
    while True:
        try:
            points = method.send(np.array([value(point) for point in points]))
        except StopIteration as end:
            found: Estimate = end.value
            return found


def linear(u: Array) -> float:
    return float(u.sum() / math.sqrt(len(u)))


def test_one_in_a_million_is_found_with_some_thousand_samples() -> None:
    found = estimate(linear, ONE_IN_A_MILLION, 2000, 1)
    assert found.verdict == ESTIMATED
    assert found.probability == pytest.approx(1e-6, rel=0.6)
    assert found.low < 1e-6 < found.upper
    assert 10_000 < found.points < 14_000
    assert found.cov == pytest.approx(0.25, abs=0.06)
    assert found.weights.sum() == pytest.approx(1.0)


def test_two_sided_event_is_the_sum_of_both_sides() -> None:
    found = estimate(lambda u: float(abs(u[0])), float(norm.isf(5e-5)), 2000, 2)
    assert found.low < 1e-4 < found.upper


def stated_and_actual(function: Callable[[Array], float], per_level: int, n: int) -> tuple[Array, Array, float]:
    """Return probabilities and stated c.o.v. of 20 repetitions, and the fraction of intervals that hold 1e-6."""
    found = [estimate(function, ONE_IN_A_MILLION, per_level, seed, n) for seed in range(20)]
    held = np.mean([e.low <= 1e-6 <= e.upper for e in found])
    return np.array([e.probability for e in found]), np.array([e.cov for e in found]), float(held)


@pytest.mark.slow
def test_stated_cov_is_that_of_twenty_repetitions() -> None:
    probability, cov, held = stated_and_actual(linear, 3000, 5)
    assert probability.mean() == pytest.approx(1e-6, rel=0.15)
    assert 0.6 < probability.std(ddof=1) / probability.mean() / cov.mean() < 1.5
    assert held >= 0.85


@pytest.mark.slow
def test_one_in_a_million_in_25000_dimensions_is_within_30_percent() -> None:
    """The sum of a mixed seed's normals is the mix of the sums of its seeds, so that each is drawn once."""
    n, seed = 25_000, 0
    sums: dict[int, float] = {}

    def value(mixed: MixedSeed) -> float:
        if mixed.seeds[0] not in sums:
            sums[mixed.seeds[0]] = linear(stream(mixed.seeds[0], "imu").standard_normal(n))
        return float(np.dot(mixed.weights, [sums[s] for s in mixed.seeds]))

    method = subset_simulation(ONE_IN_A_MILLION, 4000, seed)
    points, seeds = next(method), dict[int, MixedSeed]()
    while True:
        seeds |= mixed_seeds(seed, points, seeds)
        try:
            points = method.send(np.array([value(seeds[point.number]) for point in points]))
        except StopIteration as end:
            found: Estimate = end.value
            break
    assert found.probability == pytest.approx(1e-6, rel=0.3)
    deepest = seeds[int(found.samples[-1])]
    drawn = linear(noise_source(deepest, "imu").standard_normal((n,)))
    assert drawn == pytest.approx(value(deepest), abs=1e-12)
    assert drawn > ONE_IN_A_MILLION


def test_cov_shows_that_few_first_samples_found_the_second_cause_of_an_event() -> None:
    def two_causes(u: Array) -> float:
        return float(u[0]) if u[1] < 3.0 else 6.0 + float(u[2])

    probability = norm.sf(3.0) * norm.cdf(1.0) + norm.cdf(3.0) * norm.sf(5.0)
    found = [estimate(two_causes, 5.0, 1000, seed) for seed in range(60)]
    estimates = np.array([e.probability for e in found])
    cov = np.array([e.cov for e in found])
    assert estimates.mean() == pytest.approx(probability, rel=0.25)
    assert cov.mean() == pytest.approx(estimates.std(ddof=1) / estimates.mean(), rel=0.25)
    assert np.mean([e.largest_family for e in found]) > 0.5


@pytest.mark.parametrize(
    ("threshold", "verdict", "probability"),
    [(-9.0, ALWAYS, 1.0), (0.0, ESTIMATED, 0.5), (50.0, NEVER, None)],
)
def test_threshold_that_is_always_or_never_met_is_named(
    threshold: float, verdict: str, probability: float | None
) -> None:
    found = estimate(linear, threshold, 500, 3)
    assert found.verdict == verdict
    assert found.probability == (None if probability is None else pytest.approx(probability, abs=0.1))
    assert found.upper <= 2e-9 or probability is not None


@pytest.mark.parametrize("function", [lambda u: float(u[0] > 1.0), lambda u: -math.inf], ids=["steps", "no value"])
def test_outcome_in_steps_has_no_estimate_but_a_limit(function: Callable[[Array], float]) -> None:
    found = estimate(function, 2.0, 500, 3)
    assert found.verdict == STUCK
    assert found.probability is None
    assert 0.0 < found.upper < 0.05


def test_correlation_of_chains_counts_equal_neighbours() -> None:
    generator = np.random.default_rng(0)
    independent = generator.random((4000, 10)) < 0.1
    assert chain_correlation(independent) < 0.1
    frozen = np.repeat(generator.random((4000, 1)) < 0.1, 10, axis=1)
    assert chain_correlation(frozen) == pytest.approx(9.0, abs=0.1)


def test_mixed_noise_is_standard_normal_and_the_same_in_any_blocks() -> None:
    mixed = MixedSeed.fresh(1).moved(2, 0.6).moved(3, 0.3)
    assert mixed == 3
    assert sum(weight**2 for weight in mixed.weights) == pytest.approx(1.0)
    whole = noise_source(mixed, "imu").standard_normal((1000, 12))
    source = noise_source(mixed, "imu")
    parts = [source.standard_normal((length, 12)) for length in (1, 499, 500)]
    assert np.array_equal(whole, np.concatenate(parts))
    assert whole.std() == pytest.approx(1.0, abs=0.03)
    normals = [stream(seed, "imu").standard_normal((1000, 12)) for seed in mixed.seeds]
    assert np.allclose(whole, np.tensordot(mixed.weights, normals, axes=1))
    uniform = noise_source(mixed, "transport").random((1000,))
    assert 0.0 <= uniform.min() < 0.05 < 0.95 < uniform.max() < 1.0
    same = noise_source(MixedSeed.fresh(5), "imu").standard_normal((3,))
    assert np.array_equal(same, noise_source(5, "imu").standard_normal((3,)))


def test_event_is_an_outcome_a_side_and_a_number() -> None:
    event = RareEvent.parse("control_margin<-0.25")
    assert (event.outcome, event.side, event.threshold, event.level) == ("control_margin", "<", -0.25, 0.25)
    assert event.values(np.array([-1.0, np.nan, 2.0])).tolist() == [1.0, -math.inf, -2.0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("position_m_x", ("position_m_x", "must be an outcome")),
        ("position_m_x > far", ("far", "must be an outcome")),
        ("position_m_x > nan", ("position_m_x", "nan", "finite")),
        ("position_x > 1", ("position_x", "no such outcome", "position_m_x")),
        ("stop > 1", ("stop", "no such outcome")),
    ],
)
def test_text_that_is_no_event_is_refused(text: str, words: tuple[str, ...]) -> None:
    with pytest.raises(BadInput) as raised:
        RareEvent.parse(text)
    assert all(word in str(raised.value) for word in words)
