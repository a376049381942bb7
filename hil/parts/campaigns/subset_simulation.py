"""Subset simulation: the probability of a rare event as a product of conditional ones of about 0.1.

S. K. Au and J. L. Beck, Probabilistic Engineering Mechanics 16 (2001) 263-277; the chains move by conditional sampling
with an adaptive scale: I. Papaioannou et al., Probabilistic Engineering Mechanics 41 (2015) 89-103. All chains move
together, so that the points do not depend on the order in which their values arrive.

The coefficient of variation is the larger of two: of the levels' fractions with the correlation inside the chains, and
of the families of the samples (``families_cov``), which also has the common ancestors of chains of later levels.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.maths import elementary, linear
from hil.maths.elementary import square
from hil.parts.campaigns.rare_events import (
    ALWAYS,
    ESTIMATED,
    FRESH,
    LEAST,
    NEVER,
    STUCK,
    Estimate,
    Level,
    Method,
    NormalPoint,
    chain_correlation,
    families_cov,
    lognormal_interval,
    method_generator,
)
from hil.parts.campaigns.statistics import wilson

STEPS: Final = 10
"""Length of a chain; one over the conditional probability."""
ACCEPTANCE: Final = 0.44  # optimum of Papaioannou et al.
_FIRST_SCALE: Final = 0.6


@dataclass
class AdaptiveScale:
    """Scale of the chains' moves, adapted to an acceptance of ``ACCEPTANCE``."""

    log_scale: float = elementary.log(_FIRST_SCALE)

    @property
    def value(self) -> float:
        """The scale, at most 1."""
        return min(1.0, elementary.exp(self.log_scale))

    def update(self, acceptance: float, step: int) -> None:
        """Adapt to the acceptance of step number ``step`` of a level, from 1."""
        self.log_scale += (acceptance - ACCEPTANCE) / math.sqrt(step)


@dataclass
class _LevelSamples:
    """Samples of a level: numbers of their points, of their ancestors in the first level, and values.

    (per_level,), of a later level (chains, steps).
    """

    points: np.ndarray
    ancestors: np.ndarray
    values: Array
    acceptance: float = math.nan

    def level(self, bound: float | None, met: np.ndarray) -> Level:
        """Return the level whose next one is ``met`` by some samples."""
        fraction = float(met.mean())
        gamma = 0.0 if bound is None else chain_correlation(met)
        cov = math.sqrt((1.0 - fraction) * (1.0 + gamma) / (fraction * met.size)) if fraction else math.inf
        return Level(bound, fraction, cov, self.acceptance)


def subset_simulation(threshold: float, per_level: int, seed: int) -> Method:
    """Estimate the probability that a value is above ``threshold``; per_level: samples, a multiple of ``STEPS``."""
    chains = per_level // STEPS
    numbers = np.arange(per_level)
    samples = _LevelSamples(numbers, numbers, (yield [NormalPoint(i, FRESH, 1.0, 0) for i in range(per_level)]))
    used, levels, scale = per_level, list[Level](), AdaptiveScale()
    bound: float | None = None
    while np.count_nonzero(samples.values > threshold) < chains:
        seeds, following = _seeds(samples, chains, method_generator(seed, len(levels)))
        if following == -math.inf or (bound is not None and following <= bound):
            return _without(STUCK, samples, threshold, levels, bound, used)
        levels.append(samples.level(bound, samples.values >= following))
        bound = following
        reached = math.prod(level.fraction for level in levels)
        if reached < LEAST:
            return _without(NEVER, samples, threshold, levels, bound, used)
        samples = yield from _chains(samples, seeds, bound, (used, len(levels)), scale)
        used += chains * (STEPS - 1)
    return _estimate(samples, threshold, levels, bound, used)


def _seeds(samples: _LevelSamples, chains: int, generator: np.random.Generator) -> tuple[np.ndarray, float]:
    """Return the indices of the ``chains`` largest values, of equals any, and the least of them."""
    values = samples.values.ravel()
    mixed = generator.permutation(values.size)
    order = mixed[np.argsort(-values[mixed], kind="stable")][:chains]
    return order, float(values[order[-1]])


def _chains(
    samples: _LevelSamples, seeds: np.ndarray, bound: float, at: tuple[int, int], scale: AdaptiveScale
) -> Generator[list[NormalPoint], Array, _LevelSamples]:
    """Run chains from ``seeds`` above ``bound``; return their samples. at: number of the first point, and the level."""
    number, level = at
    points = np.empty((len(seeds), STEPS), int)
    values = np.empty((len(seeds), STEPS))
    points[:, 0], values[:, 0] = samples.points.ravel()[seeds], samples.values.ravel()[seeds]
    accepted = 0
    for step in range(1, STEPS):
        last = points[:, step - 1]
        proposed = yield [NormalPoint(number + i, int(parent), scale.value, level) for i, parent in enumerate(last)]
        inside = proposed >= bound
        points[:, step] = np.where(inside, number + np.arange(len(seeds)), last)
        values[:, step] = np.where(inside, proposed, values[:, step - 1])
        number += len(seeds)
        accepted += int(np.count_nonzero(inside))
        scale.update(float(inside.mean()), step)
    ancestors = np.repeat(samples.ancestors.ravel()[seeds, None], STEPS, axis=1)
    return _LevelSamples(points, ancestors, values, accepted / (len(seeds) * (STEPS - 1)))


def _estimate(
    samples: _LevelSamples, threshold: float, levels: list[Level], bound: float | None, used: int
) -> Estimate:
    met = samples.values > threshold
    levels = [*levels, samples.level(bound, met)]
    probability = math.prod(level.fraction for level in levels)
    _, counts = np.unique(samples.ancestors[met], return_counts=True)
    shares = counts / counts.sum()
    cov = math.sqrt(linear.total(square(level.cov) for level in levels))
    if bound is None:
        rate = wilson(int(np.count_nonzero(met)), met.size)
        low, high = float(rate["low"]), float(rate["high"])
    else:
        cov = max(cov, families_cov(shares, samples.values.size, len(levels)))
        low, high = lognormal_interval(probability, cov)
    numbers, times = np.unique(samples.points[met], return_counts=True)
    verdict = ALWAYS if bound is None and met.all() else ESTIMATED
    weights = times / times.sum()
    return Estimate(verdict, probability, cov, high, low, used, levels, numbers, weights, float(shares.max()))


def _without(
    verdict: str, samples: _LevelSamples, threshold: float, levels: list[Level], bound: float | None, used: int
) -> Estimate:
    """Return the estimate of an event that was not reached: an upper limit."""
    met = samples.values > threshold
    reached = math.prod(level.fraction for level in levels)
    cov = math.sqrt(linear.total(square(level.cov) for level in levels))
    if verdict == STUCK:
        reached *= float(wilson(int(np.count_nonzero(met)), met.size)["high"])
    upper = lognormal_interval(reached, cov)[1] if levels else reached
    numbers, times = np.unique(samples.points[met], return_counts=True)
    weights = times / max(1, times.sum())
    return Estimate(verdict, None, None, upper, 0.0, used, levels, numbers, weights)
