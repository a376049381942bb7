"""Drivers of a failure: which dispersed numbers separate the cases that fail from those that pass.

Candidates are terms of one number, its value or its distance from a centre, and of two, their product or ratio; of each
the rank over the cases counts. A term is taken if its correlation with the failure exceeds what the largest of all
candidates reaches when the failures are exchanged at random (max-statistic permutation test, Westfall and Young 1993):
with ``FALSE_ALARM`` probability one is taken without a cause, however many numbers are dispersed. The next one has to
explain what is left. The score is the area under the ROC curve for cases that were not used to choose the terms.

A random forest (scikit-learn, 300 trees) was tried on the same campaigns of 200 cases with the numbers of the stress
set: thresholds and two-sided effects come first in 10 of 10, the numbers of a product in 3 of 10, with these terms in
9 of 10.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Final

import numpy as np
import scipy  # its parts are imported when they are used
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
VALUE, DISTANCE, PRODUCT, DISTANCE_PRODUCT, RATIO = "value", "distance", "product", "distance product", "ratio"
FALSE_ALARM: Final = 0.04
"""Probability of a driver without a cause, half of it for terms of one number, half for terms of two."""
LEAST: Final = 4  # failing and passing cases, below which nothing is looked for
_CENTRES: Final = (0.35, 0.5, 0.65)  # quantiles
_PERMUTATIONS: Final = 400
_TERMS_MAX: Final = 4
_FOLDS: Final = 5
_REPEATS: Final = 5  # repetitions of a permutation importance
_PAIR_GAIN: Final = 0.03  # of explained variance, by which a term of two numbers has to be better
_PAIR_NUMBERS: Final = 60  # with more of them, only terms of one are candidates


@dataclass(frozen=True)
class Term:
    """A candidate. numbers: their places among the names. centres: of each, subtracted before it is used."""

    kind: str
    numbers: tuple[int, ...]
    centres: tuple[float, ...] = (0.0, 0.0)

    def of(self, values: Array) -> Array:
        """Return the term of each row of ``values`` (n, d)."""
        x: Array = values[:, self.numbers[0]] - self.centres[0]
        if len(self.numbers) == 2:
            y = values[:, self.numbers[1]] - self.centres[1]
            x = x / y if self.kind == RATIO else x * y
        return np.abs(x) if self.kind in (DISTANCE, DISTANCE_PRODUCT) else x


class Candidates:
    """Terms of the dispersed numbers ``values`` (n, d), with their ranks in all cases, (terms, n), 0 to 1."""

    def __init__(self, values: Array) -> None:
        self.values = values
        varied = [j for j in range(values.shape[1]) if np.ptp(values[:, j]) > 0.0]
        self.terms = [term for j in varied for term in _single(values[:, j], j)]
        self.singles = len(self.terms)
        if len(varied) <= _PAIR_NUMBERS:
            for j, k in combinations(varied, 2):
                self.terms += _pairs(values, j, k)
        self.ranks = np.empty((len(self.terms), len(values)), np.float32)
        for i, term in enumerate(self.terms):
            self.ranks[i] = (scipy.stats.rankdata(term.of(values)) - 0.5) / len(values)


def _single(x: Array, j: int) -> list[Term]:
    terms = [Term(VALUE, (j,))]
    centres = [float(c) for c in np.quantile(x, _CENTRES)]
    if x.min() < 0.0 < x.max():
        centres.insert(0, 0.0)
    return terms + [Term(DISTANCE, (j,), (centre,)) for centre in centres]


def _pairs(values: Array, j: int, k: int) -> list[Term]:
    x, y = values[:, j], values[:, k]
    centres = (float(np.median(x)), float(np.median(y)))
    terms = [Term(kind, (j, k), centres) for kind in (PRODUCT, DISTANCE_PRODUCT)]
    signs = [bool(np.all(v > 0.0)) for v in (x, y)]
    if any(signs):
        terms += [Term(PRODUCT, (j, k)), Term(DISTANCE_PRODUCT, (j, k))]
    if all(signs):
        terms.append(Term(RATIO, (j, k)))
    return terms


@dataclass(frozen=True)
class Drivers:
    """Result. terms: the first one explains most. score: area under the ROC curve, 0.5 for chance, with its interval.

    importance: dispersed number -> loss of the score if it is exchanged between the cases, largest first.
    """

    terms: list[Term] = field(default_factory=list)
    score: float | None = None
    low: float | None = None
    importance: dict[str, float] = field(default_factory=dict)

    @property
    def nothing_found(self) -> bool:
        """Whether no term predicts the failures better than chance."""
        return not self.terms


def find_drivers(
    candidates: Candidates, names: list[str], failed: np.ndarray, used: np.ndarray, seed: int = 0
) -> Drivers:
    """Return what separates the cases ``failed`` (n,) from the others of ``used`` (n,), both of bool."""
    rows = np.flatnonzero(used)
    y = failed[rows].astype(np.float32)
    if min(int(y.sum()), int((1.0 - y).sum())) < LEAST or not candidates.terms:
        return Drivers()
    rng = np.random.default_rng(seed)
    ranks = candidates.ranks[:, rows]
    chosen = _select(candidates, ranks, y, rng)
    if not chosen:
        return Drivers()
    score, importance = _cross_validated(candidates, rows, y, len(chosen), rng)
    n1, n0 = float(y.sum()), float((1.0 - y).sum())
    low = score - scipy.stats.norm.ppf(0.95) * _auc_sigma(score, n1, n0)
    if low <= 0.5:
        return Drivers(score=score, low=low)
    terms = [candidates.terms[i] for i in chosen]
    numbers = {j for term in terms for j in term.numbers}
    order = sorted(numbers, key=lambda j: -importance.get(j, 0.0))
    return Drivers(terms, score, low, {names[j]: importance.get(j, 0.0) for j in order})


def _correlations(ranks: Array, residual: Array) -> Array:
    """Return the correlation of each row of ``ranks`` (t, n) with each column of ``residual`` (n, p), centred."""
    spread = ranks.std(axis=1)
    scale = len(residual) * np.where(spread > 0.0, spread, np.inf)
    correlations: Array = (ranks @ residual) / scale[:, None] / np.maximum(residual.std(axis=0), 1e-12)
    return correlations


def _residual(ranks: Array, y: Array, chosen: list[int]) -> Array:
    """Return what the ``chosen`` terms leave of ``y``, centred."""
    basis = np.vstack([np.ones(len(y), np.float32), *ranks[chosen]]).T
    residual: Array = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
    return residual


def _select(candidates: Candidates, ranks: Array, y: Array, rng: np.random.Generator) -> list[int]:
    """Return the terms that are significant, in the order in which they were taken."""
    chosen: list[int] = []
    while len(chosen) < _TERMS_MAX:
        residual = _residual(ranks, y, chosen).astype(np.float32)
        exchanged = np.stack([rng.permutation(residual) for _ in range(_PERMUTATIONS)], axis=1)
        chance = np.abs(_correlations(ranks, exchanged))
        limits = [
            float(np.quantile(part.max(axis=0), 1.0 - 0.5 * FALSE_ALARM)) if len(part) else np.inf
            for part in (chance[: candidates.singles], chance[candidates.singles :])
        ]
        best = _best(candidates, ranks, residual, (limits[0], limits[1]))
        if best is None or best in chosen:
            break
        chosen.append(best)
    return chosen


def _best(candidates: Candidates, ranks: Array, residual: Array, limits: tuple[float, float]) -> int | None:
    """Return the term that explains most of ``residual``, None if no correlation is above the ``limits``.

    A term of two numbers is taken if it is better than each of its numbers alone, by ``_PAIR_GAIN``.
    """
    strength = np.abs(_correlations(ranks, residual[:, None])[:, 0])
    n = candidates.singles
    single = int(np.argmax(strength[:n]))
    if len(strength) > n:
        pair = n + int(np.argmax(strength[n:]))
        if strength[pair] > limits[1] and strength[pair] ** 2 > strength[single] ** 2 + _PAIR_GAIN:
            return pair
    return single if strength[single] > limits[0] else None


def _cross_validated(
    candidates: Candidates, rows: np.ndarray, y: Array, terms: int, rng: np.random.Generator
) -> tuple[float, dict[int, float]]:
    """Return score and importance of each number; in each fold ``terms`` are chosen without its cases."""
    fold = np.empty(len(y), int)
    for value in (0.0, 1.0):
        members = np.flatnonzero(y == value)
        fold[rng.permutation(members)] = np.arange(len(members)) % _FOLDS
    predicted, models = np.zeros(len(y)), []
    ranks = candidates.ranks[:, rows]
    for k in range(_FOLDS):
        learnt = fold != k
        chosen: list[int] = []
        while len(chosen) < terms:
            residual = _residual(ranks[:, learnt], y[learnt], chosen).astype(np.float32)
            best = _best(candidates, ranks[:, learnt], residual, (0.0, 0.0))
            if best is None or best in chosen:
                break
            chosen.append(best)
        basis = np.vstack([np.ones(int(learnt.sum())), *ranks[chosen][:, learnt]]).T
        weights = np.linalg.lstsq(basis, y[learnt], rcond=None)[0]
        models.append((chosen, weights))
        predicted[~learnt] = weights[0] + weights[1:] @ ranks[chosen][:, ~learnt]
    score = auc(predicted, y)
    numbers = {j for chosen, _ in models for i in chosen for j in candidates.terms[i].numbers}
    importance = {}
    for j in numbers:
        losses = []
        for _ in range(_REPEATS):
            values = candidates.values[rows].copy()
            values[:, j] = rng.permutation(values[:, j])
            moved = np.zeros(len(y))
            for k, (chosen, weights) in enumerate(models):
                at = fold == k
                moved[at] = weights[0] + sum(
                    w * _rank_of(candidates, i, values[at]) for w, i in zip(weights[1:], chosen, strict=True)
                )
            losses.append(score - auc(moved, y))
        importance[j] = float(np.mean(losses))
    return score, importance


def _rank_of(candidates: Candidates, i: int, values: Array) -> Array:
    """Return the rank of term ``i`` of ``values`` (m, d) among all cases, 0 to 1."""
    term = candidates.terms[i]
    ordered = np.sort(term.of(candidates.values))
    ranks: Array = np.searchsorted(ordered, term.of(values)) / len(ordered)
    return ranks


def auc(score: Array, y: Array) -> float:
    """Return the area under the ROC curve: the probability that a failing case has the larger ``score``."""
    ranks, n1 = scipy.stats.rankdata(score), float(y.sum())
    n0 = len(y) - n1
    return float((ranks[y > 0.5].sum() - 0.5 * n1 * (n1 + 1.0)) / (n1 * n0))


def _auc_sigma(area: float, n1: float, n0: float) -> float:
    """Return the standard deviation of an area under the ROC curve (Hanley and McNeil 1982)."""
    a = min(max(area, 0.5), 0.999)
    q1, q2 = a / (2.0 - a), 2.0 * a * a / (1.0 + a)
    return float(np.sqrt((a * (1 - a) + (n1 - 1) * (q1 - a * a) + (n0 - 1) * (q2 - a * a)) / (n1 * n0)))


def threshold(term: Term, values: Array, failed: np.ndarray) -> dict[str, Any]:
    """Return the cut of ``term`` that separates ``failed`` (n,) best, with the cases and passes on both sides.

    values: (n, d). No case beyond the cut passes, if most failures are there; otherwise it is the best separation.
    """
    x = term.of(values)
    order = np.argsort(x, kind="stable")
    x, bad = x[order], failed[order]
    above = np.mean(x[bad]) >= np.mean(x[~bad])
    if not above:
        x, bad = x[::-1], bad[::-1]
    failures_beyond = bad[::-1].cumsum()[::-1]  # at and beyond each place
    passes_beyond = (~bad)[::-1].cumsum()[::-1]
    total_bad, total_good = int(bad.sum()), int((~bad).sum())
    places = np.flatnonzero(np.diff(x, prepend=x[0] - (1.0 if above else -1.0)) != 0.0)
    clean = places[passes_beyond[places] == 0]
    if len(clean) and failures_beyond[clean[0]] >= 0.5 * total_bad:
        cut = int(clean[0])
    else:
        cut = int(places[np.argmax(failures_beyond[places] / total_bad - passes_beyond[places] / total_good)])
    beyond, others = len(x) - cut, cut
    edge = float(x[cut]) if cut == 0 else float(0.5 * (x[cut] + x[cut - 1]))
    return {
        "side": "above" if above else "below",
        "value": edge,
        "cases": beyond,
        "passes": int(passes_beyond[cut]),
        "other_cases": others,
        "other_passes": total_good - int(passes_beyond[cut]),
    }
