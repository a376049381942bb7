"""Consistency of the images with the geometry file over many poses.

A single pair has noise of a tenth of a pixel or so, and what does not fit is hidden in it. The residuals of many poses
together either are within the tolerances of cameras and LEDs, with the noise averaged, or contradict them:
with ``p`` the considered parameters of covariance P, the estimate ``x`` of their observable part V p has the covariance
``V P V.T + D^-1``, D the information. Its square is chi-square distributed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.special import chdtri

from hil.core.messages import Array
from hil.vmu.kernels.consistency import add_information
from hil.vmu.kernels.records import SHARED, RingScene, View
from hil.vmu.reflections import Doubt

FALSE_ALARMS: Final = 1e-6
"""Probability of a false alarm per test, for errors as stated."""
SIZE, EPIPOLAR, RADIAL, SHAPE = "size_against_disparity", "epipolar", "radial", "shape"

_EVERY: Final = 4  # poses: the next one is hardly another measurement
_FIRST: Final = 8  # poses, all of which count
_TESTED: Final = 4  # of them before each test
_KEPT: Final = 0.96  # of the information, with each: that of the last 25, 100 poses
_ALIKE: Final = 25.0  # of its square, as that of an error that is the same in all of them and is not averaged
_PARTLY: Final = 9.0  # of the square of the estimated floor, part of which is alike
_OBSERVED: Final = 0.05  # information relative to usual tolerances
_OPTICS_PX: Final = 0.01  # least error of a spot that is the same in all poses
_REFUSED: Final = 3  # tests in a row


class Consistency:
    """Accumulates the residuals of the poses of one track, and tests them against the tolerances.

    With a time between the exposures of the cameras (``sync_s``) images differ with the motion: nothing is tested.
    """

    def __init__(self, scene: RingScene, sync_s: float) -> None:
        self._scene, self._tested = scene, sync_s == 0.0
        size = len(scene.tolerance)
        self._information, self._product = np.zeros((size, size)), np.zeros(size)
        self._tolerance = scene.tolerance.copy()
        self._usual = _usual_sigmas(scene)
        self._poses = 0
        self._contradicted = 0
        self.doubt: Doubt | None = None
        """What does not fit by the last test, None if it passed."""

    @property
    def refuses(self) -> bool:
        """Return whether several tests in a row have failed."""
        return self._contradicted >= _REFUSED

    def restart(self) -> None:
        """Forget all poses, of an earlier track, unless they contradict the tolerances."""
        if self.doubt is None:
            self._information[:], self._product[:], self._poses = 0.0, 0.0, 0

    def add(self, view: View, fit: np.void) -> None:
        """Add a pose (FIT) that has passed the tests of its own; test them all from time to time."""
        if not self._tested:
            return
        self._poses += 1
        if self._poses > _FIRST and self._poses % _EVERY:
            return
        self._information *= _KEPT
        self._product *= _KEPT
        floor = max(_ALIKE * _OPTICS_PX**2, _PARTLY * float(fit["floor"]) ** 2)
        add_information(self._scene, view, fit, floor, self._information, self._product)
        if self._poses % (_EVERY * _TESTED) == 0 or self._poses == _FIRST:
            self.doubt = self._test()
            self._contradicted = self._contradicted + 1 if self.doubt is not None else 0

    def _test(self) -> Doubt | None:
        values, vectors = np.linalg.eigh(self._usual[:, None] * self._information * self._usual)
        seen = values > _OBSERVED
        directions = self._usual[:, None] * vectors[:, seen]
        estimate = (directions.T @ self._product) / values[seen]
        back = vectors[:, seen] / self._usual[:, None]
        expected = back.T @ self._tolerance @ back + np.diag(1.0 / values[seen])
        square = float(estimate @ np.linalg.solve(expected, estimate))
        return None if square <= float(chdtri(len(estimate), FALSE_ALARMS)) else self._cause()

    def _cause(self) -> Doubt:
        """Return the kind of error that explains the residuals best, with its size."""
        best, cause = -math.inf, Doubt(SHAPE)
        for name, unit, directions in causes(self._scene):
            prior = self._tolerance + directions @ directions.T
            root = _root(prior)
            values, vectors = np.linalg.eigh(root.T @ self._information @ root)
            values = np.maximum(values, 0.0)
            y = vectors.T @ (root.T @ self._product)
            likelihood = 0.5 * float((y**2 / (1.0 + values)).sum() - np.log1p(values).sum())
            if likelihood > best:
                best = likelihood
                estimate = root @ (vectors @ (y / (1.0 + values)))
                cause = Doubt(name, _size(self._scene, name, estimate), unit)
        return cause


def causes(scene: RingScene) -> Iterator[tuple[str, str, Array]]:
    """Yield the kinds of errors: name, unit of their size, and directions (p, k) of 1 sigma of what is looked for."""
    p, lens = len(scene.tolerance), scene.lens
    leds = scene.leds - scene.leds.mean(axis=0)
    size = np.zeros((p, 1))
    size[SHARED:, 0] = 0.02 * leds.ravel()
    yield SIZE, "%", size
    epipolar = np.zeros((p, 3))
    epipolar[18:21] = math.radians(0.3) * np.eye(3)
    yield EPIPOLAR, "px", epipolar
    radial = np.zeros((p, 2))
    for c in range(2):
        radial[9 * c + 4, c] = 3.0 / _swell(lens[c])
    yield RADIAL, "px", radial
    shape = np.zeros((p, p - SHARED))
    shape[SHARED:] = 2e-3 * np.eye(p - SHARED)
    yield SHAPE, "mm", shape


def _usual_sigmas(scene: RingScene) -> Array:
    """Return errors (p,) of a usual size, by which parameters of different units are compared."""
    sigmas = np.full(len(scene.tolerance), 1e-4)
    for c in range(2):
        lens = scene.lens[c]
        corner = 0.5 * math.hypot(float(lens["width"]), float(lens["height"])) / float(lens["fx"])
        bend = 0.2 / _swell(lens)
        sigmas[9 * c : 9 * c + 9] = (
            1e-3 * lens["fx"], 1e-3 * lens["fy"], 0.2, 0.2, bend, bend / corner**2, bend * corner, bend * corner,
            bend / corner**4,
        )  # fmt: skip
    sigmas[18:21] = math.radians(0.02)
    return sigmas


def _swell(lens: np.void) -> float:
    """Return the pixels at the image's corner per unit of k1."""
    corner = 0.5 * math.hypot(float(lens["width"]), float(lens["height"])) / float(lens["fx"])
    return float(lens["fx"]) * corner**3


def _size(scene: RingScene, name: str, estimate: Array) -> float:
    """Return the size of an error: of the ring, %, of the right camera, px, at the corner, px, of the worst LED, mm."""
    leds = scene.leds - scene.leds.mean(axis=0)
    if name == SIZE:
        return 100.0 * float(estimate[SHARED:] @ leds.ravel() / (leds**2).sum())
    if name == EPIPOLAR:
        return float(scene.lens[1]["fx"] * np.linalg.norm(estimate[18:21]))
    if name == RADIAL:
        return max((float(estimate[9 * c + 4]) * _swell(scene.lens[c]) for c in range(2)), key=abs)
    return 1e3 * float(np.linalg.norm(estimate[SHARED:].reshape(-1, 3), axis=1).max())


def _root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is ``covariance``, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
