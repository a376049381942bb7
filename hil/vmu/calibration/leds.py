"""Spots of the views, and their assignment to LEDs by the projected layout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from hil.config.vmu_geometry import Sensor
from hil.core.messages import Array
from hil.vmu.calibration.model import Observations, Setup, TurntableModel, project_view
from hil.vmu.calibration.views import Views, read_pair
from hil.vmu.detect import SpotDetector
from hil.vmu.kernels.records import AT_BORDER, MERGED

_FLOOR_PX = 0.01
"""lower limit of a centre's sigma, due to differences between pixels"""
LEAST_VIEWS = 4
_SEARCH_PX = 150.0
"""largest error of the LEDs' images due to the nominal mounting"""


@dataclass(frozen=True, slots=True)
class Spots:
    """Spots in one image: positions (k, 2), px, and covariances (k, 2, 2), px^2."""

    positions: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class SpotViews:
    """Spots of both images of all views. axes: (n, 6), rails, m, gimbals, rad."""

    names: tuple[str, ...]
    axes: Array
    spots: tuple[tuple[Spots, Spots], ...]


def spot_views(views: Views, sizes: Array, sensor: Sensor | None, progress: Callable[[str, float], None]) -> SpotViews:
    """Return the spots in both images of all views, without those cut by the edge or overlapping.

    sizes: (2, 2), width and height, px. Raises BadInput for images of another size.
    """
    detectors = [SpotDetector((int(height), int(width)), sensor=sensor) for width, height in sizes]
    pairs = []
    for k, name in enumerate(views.names):
        progress(f"spots of view {name}", k / len(views.names))
        pair = read_pair(views, k, sizes)
        pairs.append(tuple(_spots(detector, image) for detector, image in zip(detectors, pair, strict=True)))
    return SpotViews(views.names, views.axes, tuple((left, right) for left, right in pairs))


def _spots(detector: SpotDetector, image: np.ndarray) -> Spots:
    points, usable = measured(detector.spots(image, None))
    return Spots(points.positions[usable], points.covariance[usable])


def measured(spots: np.ndarray) -> tuple[Spots, np.ndarray]:
    """Return SPOT records as measurements, and which of them count: neither cut by the edge nor overlapping."""
    covariance = np.empty((len(spots), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = spots["var_u"] + _FLOOR_PX**2, spots["var_v"] + _FLOOR_PX**2
    covariance[:, 0, 1] = covariance[:, 1, 0] = spots["cov_uv"]
    usable = (spots["flags"] & (AT_BORDER | MERGED)) == 0
    return Spots(np.stack([spots["u"], spots["v"]], axis=1), covariance), usable


def identify(views: SpotViews, setup: Setup, turntable: TurntableModel, gate_px: float | None = None) -> Observations:
    """Return the observations of the LEDs.

    gate_px: largest distance of a spot from its projection by ``setup``. None: the layout may be displaced as a whole
    in each image, as by an inaccurate mounting; this displacement must be common to the views.
    """
    expected = [project_view(setup, turntable, axes).pixels for axes in views.axes]
    shape = (len(views.names), 2, len(setup.points))
    pixels = np.full((*shape, 2), np.nan)
    covariance = np.broadcast_to(np.eye(2), (*shape, 2, 2)).copy()
    for side in range(2):
        shift, gate = np.zeros(2), gate_px or 0.0
        if gate_px is None:
            shift = _common_shift([e[side] for e in expected], [s[side].positions for s in views.spots])
        for k, (positions, pair) in enumerate(zip(expected, views.spots, strict=True)):
            spots = pair[side]
            if gate_px is None:
                gate = max(4.0, 0.3 * _least_distance(positions[side]))
                shift_here = _own_shift(positions[side] + shift, spots.positions, 2.0 * gate, gate)
            else:
                shift_here = np.zeros(2)
            for led, spot in _nearest(positions[side] + shift + shift_here, spots.positions, gate):
                pixels[k, side, led] = spots.positions[spot]
                covariance[k, side, led] = spots.covariance[spot]
    return Observations(views.names, views.axes, pixels, covariance)


def _least_distance(positions: Array) -> float:
    apart = cdist(positions, positions)
    apart[np.diag_indices(len(apart))] = np.inf
    least = float(np.min(apart))
    return least if np.isfinite(least) else 0.0


def _nearest(positions: Array, spots: Array, gate: float) -> list[tuple[int, int]]:
    """Return pairs (LED, spot), each once, with distances within ``gate`` and the smallest sum."""
    if not len(spots):
        return []
    apart = np.nan_to_num(cdist(positions, spots), nan=1e6)
    rows, columns = linear_sum_assignment(np.minimum(apart, 2.0 * gate))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if apart[i, j] < gate]


def _candidates(positions: Array, spots: Array, reach: float) -> Array:
    """Return all displacements, (c, 2), that move an LED onto a spot."""
    shifts = (spots[None] - positions[:, None]).reshape(-1, 2)
    near: Array = shifts[np.linalg.norm(shifts, axis=1) < reach]
    return near


def _hits(positions: Array, spots: Array, gate: float) -> int:
    return len(_nearest(positions, spots, gate))


def _common_shift(expected: list[Array], spots: list[Array]) -> Array:
    """Return the displacement, (2,), px, common to most LEDs of all views."""
    votes = []
    for positions, observed in zip(expected, spots, strict=True):
        if not np.isfinite(positions).all() or not len(observed):
            continue
        gate = max(4.0, 0.3 * _least_distance(positions))
        shifts = _candidates(positions, observed, _SEARCH_PX)
        counts = np.array([_hits(positions + shift, observed, gate) for shift in shifts])
        if len(counts) and counts.max() >= min(3, len(positions)):
            best = shifts[counts == counts.max()]
            votes.append((best.mean(axis=0), best.std(axis=0).max()))
    if not votes:
        return np.zeros(2)
    centres = np.array([centre for centre, _ in votes])
    middle: Array = np.median(centres, axis=0)
    return middle


def _own_shift(positions: Array, spots: Array, reach: float, gate: float) -> Array:
    """Return the additional displacement of this view alone: the part of the error that grows at short range."""
    shifts = _candidates(positions, spots, reach) if np.isfinite(positions).all() and len(spots) else np.empty((0, 2))
    if not len(shifts):
        return np.zeros(2)
    tight = 0.5 * gate
    counts = np.array([_hits(positions + shift, spots, tight) for shift in shifts])
    best: Array = shifts[counts == counts.max()].mean(axis=0)
    return best if counts.max() >= 3 else np.zeros(2)
