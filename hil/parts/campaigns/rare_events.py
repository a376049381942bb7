"""Rare events: the event, the points at which a method asks for cases, and the estimate of the probability.

A method is a generator: it yields the next points and is sent the values there, of which the large ones are rare. A
point is a number to it: a case of a campaign, or a sample of a function in a test.
"""

from __future__ import annotations

import math
import re
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths import elementary
from hil.maths.random_streams import MixedSeed, generator_of
from hil.maths.special import normal_quantile
from hil.parts.campaigns.dispersions import case_seed
from hil.parts.campaigns.outcome import NUMERIC
from hil.parts.campaigns.statistics import CONFIDENCE

FRESH: Final = -1
"""Parent of a point without one."""
ESTIMATED, ALWAYS, NEVER, STUCK = "estimated", "always met", "never met", "levels do not advance"
LEAST: Final = 1e-9
"""Least probability that is looked for."""
_METHOD: Final = 3  # of the spawn keys of a campaign's seed
_EVENT: Final = re.compile(r"\s*([A-Za-z_]\w*)\s*([<>])\s*([-+]?[\w.+-]+)\s*")


@dataclass(frozen=True)
class RareEvent:
    """The event that ``outcome`` of a case is above (">") or below ("<") ``threshold``."""

    outcome: str
    side: str
    threshold: float

    @classmethod
    def parse(cls, text: str) -> RareEvent:
        """Return the event of a text like ``position_m_x > 0.0058``; raise BadInput."""
        match = _EVENT.fullmatch(text)
        try:
            if match is None:
                raise ValueError
            threshold = float(match[3])
        except ValueError as error:
            form = f"{text:.60}: must be an outcome, < or >, and a number, as position_m_x > 0.0058"
            raise BadInput.single("--rare", "", form) from error
        if not math.isfinite(threshold):
            raise BadInput.single("--rare", match[1], f"{match[3]}: must be a finite number")
        if match[1] not in NUMERIC:
            raise BadInput.single("--rare", match[1], f"no such outcome: give one of {', '.join(NUMERIC)}")
        return cls(match[1], match[2], threshold)

    def __str__(self) -> str:
        return f"{self.outcome} {self.side} {self.threshold:g}"

    def values(self, column: Array) -> Array:
        """Return the values of an outcome's ``column``, as large as they are rare; -inf where it has none."""
        values = np.asarray(column, dtype=float)
        return np.where(np.isfinite(values), values if self.side == ">" else -values, -np.inf)

    @property
    def level(self) -> float:
        """Threshold of ``values``."""
        return self.threshold if self.side == ">" else -self.threshold


class NormalPoint(NamedTuple):
    """A point of the standard normal space: the point ``parent``, moved by ``scale`` towards fresh normals."""

    number: int
    parent: int
    scale: float
    level: int


class Level(NamedTuple):
    """A level of an estimate. bound: of its values, None for all. fraction: of its samples above the next bound.

    cov: coefficient of variation of ``fraction``. acceptance: of its moves, nan without.
    """

    bound: float | None
    fraction: float
    cov: float
    acceptance: float


@dataclass(frozen=True)
class Estimate:
    """Result of a method. probability: None without an estimate, which is then at most ``upper``.

    samples, weights: numbers of the points that met the event, and their weights, with a sum of 1.
    largest_family: part of the weights that descends from the same point of the first level.
    """

    verdict: str
    probability: float | None
    cov: float | None
    upper: float
    low: float
    points: int
    levels: list[Level]
    samples: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    weights: Array = field(default_factory=lambda: np.zeros(0))
    largest_family: float | None = None


Method = Generator[list[NormalPoint], Array, Estimate]


def lognormal_interval(probability: float, cov: float) -> tuple[float, float]:
    """Return the interval of ``CONFIDENCE`` of an estimate whose logarithm is normally distributed."""
    width = normal_quantile(0.5 * (1.0 + CONFIDENCE)) * math.sqrt(elementary.log1p(cov * cov))
    return probability * elementary.exp(-width), min(1.0, probability * elementary.exp(width))


def chain_correlation(indicator: np.ndarray) -> float:
    """Return gamma of Au and Beck (2001), eq. (29): by it chains inflate the variance of a mean, less 1.

    indicator: (chains, steps), 0 or 1.
    """
    values = np.asarray(indicator, dtype=float)
    steps = values.shape[1]
    mean = values.mean()
    variance = mean * (1.0 - mean)
    if variance == 0.0:
        return 0.0
    excess = 0.0
    for lag in range(1, steps):
        covariance = float((values[:, :-lag] * values[:, lag:]).mean()) - mean * mean
        excess += 2.0 * (1.0 - lag / steps) * covariance / variance
    return max(0.0, excess)


def families_cov(shares: Array, size: int, levels: int) -> float:
    """Return the coefficient of variation of an estimate by the families of its samples: Lee and Whiteley, eq. (9).

    A. Lee, N. Whiteley, Biometrika 105 (2018) 609-625. shares: parts of the samples, (n,), that descend from the same
    point of the first level; size: of each level.
    """
    growth = elementary.exp(-levels * elementary.log1p(-1.0 / size))
    return math.sqrt(max(0.0, 1.0 - growth * (1.0 - float((shares * shares).sum()))))


def method_generator(seed: int, level: int) -> np.random.Generator:
    """Return the generator of the choices that a method makes in ``level``."""
    return generator_of(seed, (_METHOD, level))


def mixed_seeds(campaign_seed: int, points: Sequence[NormalPoint], given: dict[int, MixedSeed]) -> dict[int, MixedSeed]:
    """Return the seeds of ``points``; those of their parents are in ``given``."""
    seeds = {}
    for point in points:
        seed = case_seed(campaign_seed, point.number)
        fresh = point.parent == FRESH
        seeds[point.number] = MixedSeed.fresh(seed) if fresh else given[point.parent].moved(seed, point.scale)
    return seeds
