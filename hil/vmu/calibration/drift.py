"""Drift check: whether the cameras still match a calibration, from a few views, and if not, which part moved.

Today's pixels minus those predicted by the calibration are linear in the possible changes. Their covariance is that
of the spots, of the encoders and of the calibration itself; with it every explanation has a chi-square: the reduction
of today's square sum (docs/explanation/calibration.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import f

from hil.core.messages import Array
from hil.vmu.calibration.files import MOST_LEDS, StoredCalibration
from hil.vmu.calibration.model import PARTS, Observations, Setup, TurntableModel, project_view
from hil.vmu.calibration.refine import information, layout_basis
from hil.vmu.kernels.chain import COMMON

_AS_GOOD = 10.0  # of the square sum: explanations closer than this to the best are not distinguishable from it
_LEAST_SHARE = 1e-9  # of the largest eigenvalue, below which a direction is not observable


@dataclass(frozen=True, slots=True)
class Explanation:
    """One part that may have moved.

    square: reduction of today's square sum. freedom: number of parameters. chance: probability of such a reduction
    by noise alone. change, sigma: (COMMON,) or (COMMON + 3 m,), of all parameters, zero for those of other parts.
    shift_px: RMS of its effect on the pixels.
    """

    part: str
    square: float
    freedom: int
    chance: float
    change: Array
    sigma: Array
    shift_px: float


@dataclass(frozen=True, slots=True)
class Drift:
    """Today's views compared with a calibration.

    rms_px: of today's residuals, including the encoders' errors. noise: of today's pixels relative to the calibration.
    square, freedom: of all parts together. chance: probability of such a drift, of all parts or of one, by noise alone.
    explanations: best first. alike: the parts that explain about as much as the best one, including it.
    """

    views: int
    points: int
    rms_px: float
    noise: float
    square: float
    freedom: int
    chance: float
    explanations: tuple[Explanation, ...]
    alike: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Score:
    """Gradient and information (both of all parameters) of today's square sum ``square``, priors included."""

    gradient: Array
    matrix: Array
    square: float

    def best(self, directions: Array) -> tuple[float, int, Array, Array]:
        """Return the best reduction along ``directions`` (n, k), the rank, the change and its covariance."""
        matrix = directions.T @ self.matrix @ directions
        scale = 1.0 / np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
        values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
        observed = values > _LEAST_SHARE * max(float(values[-1]), 1e-300)
        along = directions @ (scale[:, None] * vectors[:, observed] / np.sqrt(values[observed]))
        components = along.T @ self.gradient
        return float(components @ components), int(observed.sum()), along @ components, along @ along.T

    def freed(self, directions: Array) -> _Score:
        """Return the remaining score if ``directions`` are unconstrained."""
        gain, _, change, covariance = self.best(directions)
        moved = self.matrix @ covariance
        return _Score(self.gradient - self.matrix @ change, self.matrix - moved @ self.matrix, self.square - gain)


def check(stored: StoredCalibration, observed: Observations, setup: Setup, target_moved: bool) -> Drift:
    """Return the deviation of ``observed`` from the prediction of ``stored``.

    setup: that of ``stored``, with the points of today's target; if ``target_moved`` the target's pose is only
    approximate, and unconstrained.
    """
    on_leds = len(setup.points) <= MOST_LEDS
    info = information(observed, setup, stored.turntable, stored.axis_sigma, stored.noise, on_leds)
    size = len(info.score)
    score = _with_prior(info.matrix, info.score, info.square, stored.covariance, size)
    parts = _directions(setup, size)
    rows = info.rows
    target = parts.pop("target")
    if target_moved:
        rows -= score.best(target)[1]
        score = score.freed(target)
    else:
        parts["target"] = target
    square, freedom, _, _ = score.best(np.hstack(list(parts.values())))
    residual_freedom = max(rows - freedom, 1)
    noise2 = max(score.square - square, 1e-12) / residual_freedom
    explanations = []
    for name, directions in parts.items():
        gain, rank, change, covariance = score.best(directions)
        sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        shift = _shift_px(observed, setup, stored.turntable, change)
        chance = float(f.sf(gain / rank / noise2, rank, residual_freedom))
        explanations.append(Explanation(name, gain / noise2, rank, chance, change, sigma, shift))
    worth = {e.part: e.square - e.freedom * math.log(max(rows, 3)) for e in explanations}
    explanations.sort(key=lambda e: -worth[e.part])
    alike = tuple(e.part for e in explanations if worth[e.part] > worth[explanations[0].part] - _AS_GOOD)
    together = float(f.sf(square / freedom / noise2, freedom, residual_freedom))
    # correction for testing all parts at once and each alone (Bonferroni)
    chance = min(1.0, (1 + len(explanations)) * min(together, *(e.chance for e in explanations)))
    counts = (len(observed.names), int(observed.visible.sum()))
    return Drift(*counts, info.rms_px, math.sqrt(noise2), square / noise2, freedom, chance, tuple(explanations), alike)


def _with_prior(matrix: Array, score: Array, square: float, covariance: Array, size: int) -> _Score:
    """Return the score with the calibration's own uncertainty included in the pixels' covariance (Woodbury)."""
    prior = np.zeros((size, size))
    n = min(size, len(covariance))
    prior[:n, :n] = covariance[:n, :n]
    scale = np.sqrt(np.maximum(np.diagonal(prior), 1e-300))
    values, vectors = np.linalg.eigh(prior / scale[:, None] / scale)
    factor = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    inner = np.eye(size) + factor.T @ matrix @ factor
    through = np.linalg.solve(inner, factor.T @ np.column_stack([matrix, score]))
    mixed = matrix @ factor
    projected = float(score @ factor @ through[:, -1])
    return _Score(score - mixed @ through[:, -1], matrix - mixed @ through[:, :-1], square - projected)


def _directions(setup: Setup, size: int) -> dict[str, Array]:
    """Return the directions in which each part may move, (size, k)."""
    directions = {name: np.eye(size)[:, columns] for name, columns in PARTS.items() if name != "scale"}
    if size > COMMON:
        basis = layout_basis(setup.points)
        directions["leds"] = np.vstack([np.zeros((COMMON, basis.shape[1])), basis])
    return directions


def _shift_px(observed: Observations, setup: Setup, turntable: TurntableModel, change: Array) -> float:
    """Return the RMS effect of ``change`` on the coordinates of all measured pixels."""
    moves = []
    for axes, here in zip(observed.axes, observed.visible, strict=True):
        slopes = project_view(setup, turntable, axes)
        by_point = np.zeros(3 * len(setup.points)) if len(change) == COMMON else change[COMMON:]
        along = slopes.by_common @ change[:COMMON]
        along += np.einsum("cmab,mb->cma", slopes.by_point, by_point.reshape(-1, 3))
        moves.append(along[here].ravel())
    return float(np.sqrt(np.mean(np.concatenate(moves) ** 2)))
