"""Importance density of a deviation's first passage: standard normals with the means that lead to it at any time.

S. K. Au and J. L. Beck, Probabilistic Engineering Mechanics 16 (2001) 193-207: the event that a deviation exceeds a
level at any time is the union of as many elementary ones as there are times and signs, and for a nearly linear system
the normals that most likely lead to one of them are the response to an impulse, reversed in time. The response comes
from pilot cases by reverse correlation: the mean of the normals before their largest deviations. The density is a
mixture of standard normals with these means, and for a tenth without any.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from hil.core.messages import Array
from hil.maths import elementary, linear
from hil.maths.elementary import square
from hil.maths.random_streams import MixedSeed, generator_of
from hil.maths.special import log_sum_exp
from hil.parts.campaigns.dispersions import case_seed

LOG_WEIGHT: Final = "log_weight"
"""Column of the cases: log ratio of the densities of the scenario's noise and the campaign's."""
LEAD_S: Final = 64.0
"""Time before a deviation in which its noise has means."""
CHANNELS: Final = {
    "imu": tuple(f"imu {kind} {axis}" for kind in ("gyro", "accelerometer", "gyro drift", "bias") for axis in "xyz"),
    "vision": tuple(f"vision {kind} {axis}" for kind in ("position", "rotation") for axis in "xyz"),
}
"""Names of the columns of each source's normals."""
_BLOCK_S: Final = 0.64  # of normals that have one mean
_NOMINAL: Final = 0.1  # fraction of the cases without means
_COMPONENT: Final = 5  # of the spawn keys of a campaign's seed
_LEAST_SIGNAL: Final = 0.35  # of the estimated means' power in a channel: others have none
_LEAST_SIGMAS: Final = 3.0  # of the effect of a dispersed number
_LARGEST: Final = 2  # deviations per pilot case
_PER_BLOCK: Final = 1e-9  # rounding of a row's block


@dataclass(frozen=True)
class PilotCases:
    """Cases without means. normals: by source, (cases, blocks, width), of each block. dispersions: (cases, d), normals.

    peaks: (n, 3), case, block and signed value of the largest deviations, several per case.
    """

    normals: Mapping[str, Array]
    dispersions: Array
    peaks: Array


@dataclass(frozen=True)
class ImportanceDensity:
    """Mixture over the blocks ``first`` .. ``blocks`` at which the deviation may occur, and both signs.

    means: by source, (leads, width), of the block of the deviation and those before. rates_hz: rows of normals per
    second, by source. dispersions: means of their normals, (d,).
    """

    block_s: float
    first: int
    blocks: int
    means: dict[str, Array]
    rates_hz: dict[str, float]
    dispersions: Array

    def text(self) -> str:
        """Return the density as JSON."""
        means = {name: mean.tolist() for name, mean in self.means.items()}
        return json.dumps(vars(self) | {"means": means, "dispersions": self.dispersions.tolist()}) + "\n"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the density that ``text`` returned. Raises ValueError, TypeError or KeyError for any other text."""
        table = json.loads(text)
        means = {str(name): np.array(mean, dtype=float) for name, mean in table.pop("means").items()}
        return cls(means=means, dispersions=np.array(table.pop("dispersions"), dtype=float), **table)

    @property
    def distance(self) -> float:
        """Norm of the means, in standard deviations."""
        return math.sqrt(linear.total(float(square(mean).sum()) for mean in self.means.values()))

    def seed(self, campaign_seed: int, case: int) -> MixedSeed:
        """Return the seed of a case: its number determines time and sign of its means."""
        generator = generator_of(campaign_seed, (_COMPONENT, case))
        fresh = MixedSeed.fresh(case_seed(campaign_seed, case))
        nominal, at, sign = (
            generator.random() < _NOMINAL,
            generator.integers(self.first, self.blocks),
            generator.random(),
        )
        if nominal:
            return fresh
        means = {name: self._row_means(name, int(at), 1.0 if sign < 0.5 else -1.0) for name in self.means}
        return fresh.shifted(means | {"dispersions": self.dispersions})

    def _row_means(self, name: str, at: int, sign: float) -> Array:
        """Return the means of a source's rows up to block ``at``, flat."""
        mean = self.means[name]
        of_blocks = np.zeros((at + 1, mean.shape[1]))
        leads = min(at + 1, len(mean))
        of_blocks[at + 1 - leads :] = sign * mean[:leads][::-1]
        index = block_of_row(self.rates_hz[name], self.block_s, at + 1)
        counts = np.bincount(index)
        of_rows: Array = (of_blocks / np.sqrt(counts)[:, None])[index]
        return of_rows.ravel()

    def log_weight(self, normals: Mapping[str, Array], dispersions: Array) -> float:
        """Return the logarithm of the density of standard normals over this one.

        normals: by source, (blocks, width), of each block of a case. dispersions: (d,), their normals.
        """
        products, squares = np.zeros(self.blocks), np.zeros(self.blocks)
        for name, mean in self.means.items():
            for channel in np.flatnonzero(mean.any(axis=0)):
                leads, rows = mean[:, channel], normals[name][: self.blocks, channel]
                for lead in range(min(len(leads), self.blocks)):
                    products[lead:] += leads[lead] * rows[: self.blocks - lead]
            power = np.zeros(self.blocks)
            power[: len(mean)] = square(mean).sum(axis=1)[: self.blocks]
            squares += np.cumsum(power)
        products, squares = products[self.first :], squares[self.first :]
        own = float((self.dispersions * dispersions).sum()) - 0.5 * float((self.dispersions * self.dispersions).sum())
        exponents = np.concatenate([products, -products]) + own - 0.5 * np.tile(squares, 2)
        shifted = log_sum_exp(exponents) + elementary.log((1.0 - _NOMINAL) / len(exponents))
        return -log_sum_exp(np.array([shifted, elementary.log(_NOMINAL)]))


def block_length_s(rates_hz: Mapping[str, float]) -> float:
    """Return the length of a block with a row or more of each source."""
    return max(_BLOCK_S, *(1.0 / rate for rate in rates_hz.values()))


def block_of_row(rate_hz: float, block_s: float, blocks: int) -> np.ndarray:
    """Return the block of each row of a source, of those of the first ``blocks``."""
    rows = np.arange(math.ceil(blocks * block_s * rate_hz - _PER_BLOCK))
    return np.floor(rows / (rate_hz * block_s) + _PER_BLOCK).astype(int)


def block_normals(normals: Array, rate_hz: float, block_s: float, blocks: int) -> Array:
    """Return the normals of blocks, (blocks, width): sums of the rows ``normals`` over the roots of their numbers."""
    index = block_of_row(rate_hz, block_s, blocks)
    starts = np.searchsorted(index, np.arange(blocks))
    sums = np.add.reduceat(normals[: len(index)], starts, axis=0)
    scaled: Array = sums / np.sqrt(np.bincount(index))[:, None]
    return scaled


def fitted_density(
    pilot: PilotCases, level: float, first: int, block_s: float, rates_hz: dict[str, float]
) -> ImportanceDensity | None:
    """Return the density for deviations beyond ``level``; None if no noise leads to the pilot cases' largest ones."""
    largest = np.argsort(-np.abs(pilot.peaks[:, 2]), kind="stable")[: _LARGEST * len(pilot.dispersions)]
    peaks = pilot.peaks[np.sort(largest)]
    leads = round(LEAD_S / block_s)
    means = {name: _means(normals, peaks, level, leads) for name, normals in pilot.normals.items()}
    power = linear.total(float(square(mean).sum()) for mean in means.values())
    if power == 0.0:
        return None
    blocks = next(iter(pilot.normals.values())).shape[1]
    return ImportanceDensity(block_s, first, blocks, means, rates_hz, _dispersion_means(pilot, power))


def _means(normals: Array, peaks: Array, level: float, leads: int) -> Array:
    """Return the mean of the normals before a deviation of ``level``, (leads, width), by regression on the peaks.

    Each channel is shrunk by the part of its power that the scatter over the cases explains (James and Stein, 1961).
    """
    width = normals.shape[2]
    aligned = np.zeros((len(peaks), leads, width))
    for row, (case, block, _) in zip(aligned, peaks, strict=True):
        window = normals[int(case), max(0, int(block) + 1 - leads) : int(block) + 1][::-1]
        row[: len(window)] = window
    value = peaks[:, 2]
    power = float((value * value).sum())
    per_unit = (value[:, None, None] * aligned).sum(axis=0) / power
    scatter = np.zeros((len(normals), leads, width))
    np.add.at(scatter, peaks[:, 0].astype(int), value[:, None, None] * (aligned - value[:, None, None] * per_unit))
    noise = square(scatter).sum(axis=(0, 1)) / (power * power)
    signal = np.maximum(0.0, 1.0 - noise / square(per_unit).sum(axis=0))
    means: Array = level * per_unit * np.where(signal < _LEAST_SIGNAL, 0.0, signal)
    return means


def _dispersion_means(pilot: PilotCases, power: float) -> Array:
    """Return the means of the dispersed numbers: of those on which the logarithm of the largest deviation depends.

    With ln x = a + c z, the event at distance beta has the density exp(-z^2/2 - beta^2 exp(-2 c z)/2) of z, whose mean
    is about beta^2 c / (1 + 2 beta^2 c^2).
    """
    cases, d = pilot.dispersions.shape
    largest = np.zeros(cases)
    np.maximum.at(largest, pilot.peaks[:, 0].astype(int), np.abs(pilot.peaks[:, 2]))
    positive = largest > 0.0
    if d == 0 or np.count_nonzero(positive) < 2 * d:
        return np.zeros(d)
    matrix = np.column_stack([np.ones(np.count_nonzero(positive)), pilot.dispersions[positive]])
    inverse = linear.inverse(linear.product(matrix.T, matrix))
    logarithms = elementary.each(elementary.log, largest[positive])
    slopes = linear.product(inverse, linear.product(matrix.T, logarithms))
    residual = logarithms - linear.product(matrix, slopes)
    sigmas = np.sqrt((residual * residual).sum() / (len(residual) - d - 1) * np.diag(inverse))
    slope = np.where(np.abs(slopes) > _LEAST_SIGMAS * sigmas, slopes, 0.0)[1:]
    means: Array = power * slope / (1.0 + 2.0 * power * float((slope * slope).sum()))
    return means


def noise_drivers(density: ImportanceDensity) -> list[dict[str, Any]]:
    """Return the channels of noise that lead to the deviation, by the keys of ``rare.noise``, the largest part first.

    part: of the squared distance, as for the variance of a linear system. halved_by: factor on the channel's standard
    deviation that halves the probability, which for a first passage goes with exp(-distance^2 / 2); None if the channel
    is too small for that.
    """
    power = {
        names[channel]: float(square(mean[:, channel]).sum())
        for source, mean in density.means.items()
        for names in (CHANNELS[source],)
        for channel in np.flatnonzero(mean.any(axis=0))
    }
    total = linear.total(power.values())
    lost = 1.0 - 1.0 / (1.0 + 2.0 * elementary.log(2.0) / total)  # part of the variance without which it is halved
    rows = []
    for name, own in sorted(power.items(), key=lambda item: -item[1]):
        kept = 1.0 - lost * total / own
        rows.append({"noise": name, "part": own / total, "halved_by": math.sqrt(kept) if kept > 0.0 else None})
    return rows
