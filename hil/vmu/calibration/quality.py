"""Quality of a calibration: errors at working ranges, coverage of the images, warnings about the views."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.vmu.calibration.model import PARTS, SIDES, Observations, Setup, TurntableModel, parameters, project_view
from hil.vmu.calibration.refine import Prior, RefinementFit
from hil.vmu.kernels.chain import COMMON, SCALE

RANGES_M: Final = (0.6, 1.0, 2.0, 5.0, 10.0)
_CELLS = 8
_FIELD = np.linspace(-0.8, 0.8, 9)  # of half the field of view
_CAMERAS = slice(0, PARTS["mounting"].start)
_PLACED = np.r_[0 : PARTS["target"].start, PARTS["target"].start + 3 : SCALE]  # all but the target's rotation


@dataclass(frozen=True, slots=True)
class RangeAccuracy:
    """Standard deviations of the position of a point at ``range_m``, mm: of one measurement, and of the calibration."""

    range_m: float
    noise_across_mm: float
    noise_depth_mm: float
    calibration_across_mm: float
    calibration_depth_mm: float


def _both_cameras(setup: Setup, p_v: Array) -> tuple[Array, Array, Array]:
    """Return pixels (4,) of ``p_v``, derivatives by the shared parameters (4, COMMON) and by ``p_v`` (4, 3), px/m."""
    still = TurntableModel(np.zeros(3), np.array([2, 1, 0]))
    theta = setup.theta.copy()
    theta[PARTS["mounting"]] = 0.0
    theta[PARTS["target"]] = 0.0
    theta[SCALE] = 1.0
    back = np.ascontiguousarray(setup.camera_axes.T)
    at_origin = Setup(theta, setup.camera_axes, back, p_v.reshape(1, 3), setup.sizes)
    slopes = project_view(at_origin, still, np.zeros(6))
    return slopes.pixels.ravel(), slopes.by_common.reshape(4, COMMON), slopes.by_point.reshape(4, 3)


def field(setup: Setup, range_m: float, by_hand: bool = False) -> list[tuple[Array, Array]]:
    """Return the derivatives of a triangulated position by pixels and parameters, over the common field at ``range_m``.

    Each (3, 4), m/px, and (3, COMMON): the position that is triangulated from the same pixels with other parameters.
    by_hand: without the rotation of all positions alike, as the calibration alone defines the cameras' axes.
    """
    return [(inverse, gain) for inverse, gain, _ in _sensitivities(setup, range_m, by_hand)]


def _sensitivities(setup: Setup, range_m: float, by_hand: bool) -> list[tuple[Array, Array, Array]]:
    """Return what ``field`` does, and the pixels of each point by the parameters, (4, COMMON)."""
    rows, turns = [], []
    for p_v in _field_points(setup, range_m):
        pixels, by_numbers, by_place = _both_cameras(setup, p_v)
        if _in_both(pixels, setup):
            inverse: Array = np.linalg.pinv(by_place).astype(float)
            rows.append((inverse, -inverse @ by_numbers, by_numbers, by_place))
            turns.append(-np.cross(np.eye(3), p_v))  # of e x p, by e: transposed
    if not rows or not by_hand:
        return [row[:3] for row in rows]
    by_turn = np.array(turns).transpose(0, 2, 1)
    gains = np.array([row[1] for row in rows])
    turn = np.linalg.lstsq(by_turn.reshape(-1, 3), gains.reshape(-1, COMMON), rcond=None)[0]
    common = by_turn @ turn
    return [
        (inverse, gain - moved, by_numbers + by_place @ moved)
        for (inverse, gain, by_numbers, by_place), moved in zip(rows, common, strict=True)
    ]


def _field_points(setup: Setup, range_m: float) -> Iterator[Array]:
    """Yield points (3,), m, in v, over the left camera's field at ``range_m``, around the middle of both cameras."""
    focal, size = setup.theta[:2], setup.sizes[0]
    middle = 0.5 * setup.theta[PARTS["stereo"]][3:] * np.array([1.0, 1.0, 0.0])
    for across in _FIELD:
        for down in _FIELD:
            ray = np.array([across * 0.5 * size[0] / focal[0], down * 0.5 * size[1] / focal[1], 1.0])
            yield range_m * ray + middle


def _in_both(pixels: Array, setup: Setup) -> bool:
    both = pixels.reshape(2, 2)
    return bool(np.isfinite(both).all() and ((both > 0.0) & (both < setup.sizes - 1.0)).all())


def at_range(
    setup: Setup, covariance: Array, sigma_px: float, range_m: float, by_hand: bool = False
) -> RangeAccuracy | None:
    """Return the accuracy of a point at ``range_m``; None if the cameras have no common field there.

    by_hand: as in ``field``.
    """
    positions = field(setup, range_m, by_hand)
    if not positions:
        return None
    cameras = covariance[_CAMERAS, _CAMERAS]
    noise = np.mean([np.diagonal(p @ p.T) * sigma_px**2 for p, _ in positions], axis=0)
    numbers = np.mean([np.diagonal(g[:, _CAMERAS] @ cameras @ g[:, _CAMERAS].T) for _, g in positions], axis=0)
    spread = [1e3 * float(np.sqrt(v)) for v in (noise[:2].mean(), noise[2], numbers[:2].mean(), numbers[2])]
    return RangeAccuracy(range_m, *spread)


def dominant(setup: Setup, covariance: Array, range_m: float, by_hand: bool) -> str:
    """Return the parameter whose uncertainty adds most to that of a point's position at ``range_m``, "" for none."""
    cameras = covariance[_CAMERAS, _CAMERAS]
    variance = np.diagonal(cameras)
    gains = [gain[:, _CAMERAS] @ cameras for _, gain in field(setup, range_m, by_hand)]
    if not gains or not variance.any():
        return ""
    lessened = np.sum(np.square(gains), axis=(0, 1)) / np.where(variance > 0.0, variance, np.inf)
    return parameters()[int(np.argmax(lessened))].name


def without_scale(covariance: Array) -> Array:
    """Return ``covariance`` for a known size of the board."""
    if covariance[SCALE, SCALE] <= 0.0:
        return covariance
    column = covariance[:, SCALE]
    reduced: Array = covariance - np.outer(column, column) / covariance[SCALE, SCALE]
    return reduced


def spot_error_px(setup: Setup, covariance: Array, range_m: float, by_hand: bool = False) -> float:
    """Return the standard deviation of a point's pixel, px, by the calibration of its camera; the worse camera's.

    RMS over the field at ``range_m`` of what the vision unit has to allow for; inf without a common field. by_hand: as
    in ``field``.
    """
    cameras = covariance[_CAMERAS, _CAMERAS]
    variances = [
        np.diagonal(pixels[:, _CAMERAS] @ cameras @ pixels[:, _CAMERAS].T)
        for _, _, pixels in _sensitivities(setup, range_m, by_hand)
    ]
    return float(np.sqrt(np.mean(variances, axis=0).max())) if variances else float("inf")


def displacement(setup: Setup, change: Array, range_m: float, by_hand: bool = False) -> tuple[float, float]:
    """Return the displacement of a point at ``range_m``, across and in depth, mm RMS over the field.

    change: (COMMON,), of cameras, mounting and the target's position from their values. The position is that in the
    chaser's axes as measured by the left camera. by_hand: as in ``field``.
    """
    moves = np.array([g[:, _PLACED] @ change[_PLACED] for _, g in field(setup, range_m, by_hand)]).reshape(-1, 3)
    if not len(moves):
        return 0.0, 0.0
    square = np.mean(moves**2, axis=0)
    return 1e3 * float(np.sqrt(square[:2].mean())), 1e3 * float(np.sqrt(square[2]))


def coverage(observed: Observations, sizes: Array) -> list[float]:
    """Return the fraction of the left and of the right image, in 8 x 8 fields, that contains points."""
    shares = []
    for side in range(2):
        points = observed.pixels[:, side].reshape(-1, 2)
        points = points[np.isfinite(points).all(axis=1)]
        edges = [np.linspace(-0.5, size - 0.5, _CELLS + 1) for size in sizes[side]]
        counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=edges)
        shares.append(float(np.mean(counts > 0)))
    return shares


def coverage_warnings(shares: list[float]) -> list[str]:
    """Return a sentence for each image of which the target has covered less than half."""
    return [
        f"the {side} image is covered to {100 * share:.0f} % only: bring the target to its edges and corners too"
        for side, share in zip(SIDES, shares, strict=True)
        if share < 0.5
    ]


def exchange_warnings(setup: Setup, held: Prior) -> list[str]:
    """Return a sentence if the right camera is to the left of the left one, as with exchanged images."""
    baseline = setup.theta[PARTS["stereo"]][3:]
    if not held.free[PARTS["stereo"]].any() or baseline[0] > -0.5 * float(np.linalg.norm(baseline)):
        return []
    return [
        f"baseline x is {1e3 * baseline[0]:+.0f} mm, the right camera is to the left of the left one: images exchanged?"
    ]


def sigma_px(fit: RefinementFit, observed: Observations) -> float:
    """Return the standard deviation of one coordinate of a spot or corner, px, as estimated by the fit."""
    variances = np.einsum("...ii->...", observed.covariance)[observed.visible] / 2.0
    return fit.noise * float(np.sqrt(np.median(variances)))


def warnings_of(fit: RefinementFit, observed: Observations, held: Prior, shares: list[float], rigid: bool) -> list[str]:
    """Return the deficiencies of the views, one sentence each. rigid: the target is a board of known size."""
    warnings = []
    if len(observed.names) < 10:
        warnings.append(f"few views: {len(observed.names)}, 15 or more are recommended")
    warnings += coverage_warnings(
        [s if held.free[PARTS[side]].any() else 1.0 for side, s in zip(SIDES, shares, strict=True)]
    )
    warnings += exchange_warnings(fit.setup, held)
    rails, gimbals = np.ptp(observed.axes[:, :3], axis=0), np.degrees(np.ptp(observed.axes[:, 3:], axis=0))
    turned = int((gimbals >= 8.0).sum())
    if held.free[PARTS["mounting"]].any() and turned < 2:
        warnings.append("no tilt: fewer than two gimbals were moved by 8 deg: the camera's mounting is not determined")
    if rails.max() < 0.1:
        rest = "scale rests on the board's size alone" if rigid else "nothing fixes the scale"
        warnings.append(f"the rails moved by {1e3 * rails.max():.0f} mm only: {rest}")
    elif rails[0] < 0.3:
        warnings.append(f"little change of range: x moved by {1e3 * rails[0]:.0f} mm")
    prior_sigma = np.where(held.free, held.sigma, np.inf)
    names = parameters()[:SCALE]
    open_ = [
        p.name
        for p, s, b in zip(names, fit.sigma, prior_sigma, strict=False)
        if np.isfinite(b) and s > 0.3 * b and not p.name.endswith(".k3")  # whose prior is that of lenses
    ]
    if open_:
        warnings.append(f"not determined by these views: {', '.join(open_)}")
    if len(fit.sigma) > COMMON and fit.sigma[COMMON:].max() > 0.5 * held.layout_sigma:
        warnings.append("the layout of the LEDs is hardly more accurate than before")
    for name, ratio, redundancy in zip(("rails", "gimbals"), fit.axis_ratio, fit.axis_redundancy, strict=True):
        if ratio > 1.0 + 3.0 / np.sqrt(2.0 * max(redundancy, 1.0)):
            warnings.append(f"errors of the {name}' encoders are {ratio:.1f} times the assumed sigma")
    return warnings
