"""Ghosts of a lens: two reflections inside it show each light once more, weaker, on the line through a fixed point.

``ghost = offset + magnification light``, with the fixed point near the principal point: a magnification and a fraction
of the light for each camera. They are learnt from pairs in which the lights of the LEDs all have their ghosts, and hold
for later pairs. A pattern that lenses alone make is no second ring.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array

_FEWEST: Final = 4  # LEDs with a ghost
_SOURCES: Final = 8  # brightest LEDs that are compared
_REACH_PX: Final = 2.5
_CENTRE_PX: Final = 16.0  # of the fixed point from the principal point
_BRIGHTEST: Final = 0.6  # fraction of its light; a brighter one may be a light of its own
_ALIKE: Final = 0.35  # of ln of the fraction
_LEAST: Final = 0.05  # magnification: smaller ones are of a point
_LIKE_ITSELF: Final = (0.75, 1.35)  # those of a plate behind the ring
_WEIGHT: Final = 0.2  # of the last pair


@dataclass(frozen=True, slots=True)
class Ghost:
    """Ghost of each light: magnification, offset (2,), px, and fraction of its light."""

    magnification: float
    offset: Array
    fraction: float

    def shows(self, sources: np.ndarray, lights: np.ndarray) -> np.ndarray:
        """Return for each of ``sources`` (SPOT_RAY) which of ``lights`` is its ghost, -1 for none."""
        at = self.offset + self.magnification * _pixels(sources)
        away = np.linalg.norm(at[:, None] - _pixels(lights), axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.log(lights["flux"] / (self.fraction * sources["flux"][:, None]))
        away[~(np.abs(relative) < 2.0 * _ALIKE)] = np.inf
        nearest = away.argmin(axis=1)
        return np.where(away.min(axis=1) < _REACH_PX, nearest, -1)


class LensGhosts:
    """Ghosts of one camera, with its principal point, px (2,). known: of the pairs so far, None before any."""

    def __init__(self, principal: Array) -> None:
        self._principal = principal
        self.known: Ghost | None = None

    def among(self, leds: np.ndarray, lights: np.ndarray) -> np.ndarray:
        """Return which of ``lights`` (n,) of SPOT_RAY are ghosts of ``leds`` or of each other; learns from them."""
        if not len(leds) or not len(lights):
            return np.zeros(len(lights), bool)
        fitted = self._fitted(leds, lights)
        if fitted is not None:
            self.known = fitted if self.known is None else _mean(self.known, fitted)
        if self.known is None:
            return np.zeros(len(lights), bool)
        shown = np.concatenate([self.known.shows(leds, lights), self.known.shows(lights, lights)])
        return np.isin(np.arange(len(lights)), shown[shown >= 0])

    def _fitted(self, leds: np.ndarray, lights: np.ndarray) -> Ghost | None:
        """Return the ghost that most of ``leds`` have among ``lights``, None if there is none."""
        leds = leds[np.argsort(leds["flux"])[-_SOURCES:]]
        lights = lights[lights["flux"] < _BRIGHTEST * leds["flux"].max()]
        needed = max(_FEWEST, len(leds) - 1)
        if len(lights) < needed or len(leds) < needed:
            return None
        best, most = None, needed - 1
        for ghost in self._candidates(leds, lights):
            shown = ghost.shows(leds, lights)
            if len(set(shown[shown >= 0])) > most:
                most, best = len(set(shown[shown >= 0])), _refined(leds, lights, shown)
        return best

    def _candidates(self, leds: np.ndarray, lights: np.ndarray) -> Iterator[Ghost]:
        """Yield the ghosts by which two LEDs far apart have two of ``lights``."""
        places, pixels = _pixels(leds), _pixels(lights)
        apart = np.linalg.norm(places[:, None] - places, axis=2)
        a, b = np.unravel_index(int(apart.argmax()), apart.shape)
        pairs = {(int(a), int(b)), (int(b), int(np.argsort(apart[b])[-2]))}  # one of them may have its ghost elsewhere
        first, second = pixels[:, None], pixels[None]
        for one, other in pairs:
            along = places[other] - places[one]
            scale = (second - first) @ along / (along @ along)
            offset = first - scale[..., None] * places[one]
            fixed = np.linalg.norm(offset - (1.0 - scale[..., None]) * self._principal, axis=2)
            missed = np.linalg.norm(second - offset - scale[..., None] * places[other], axis=2)
            part = np.log(lights["flux"][:, None] / leds["flux"][one]), np.log(lights["flux"] / leds["flux"][other])
            fits = (np.abs(scale) >= _LEAST) & ((scale <= _LIKE_ITSELF[0]) | (scale >= _LIKE_ITSELF[1]))
            fits &= (missed <= _REACH_PX) & (fixed < _CENTRE_PX * np.abs(1.0 - scale))
            fits &= np.abs(part[0] - part[1]) < _ALIKE
            for i, j in np.argwhere(fits):
                fraction = math.exp(0.5 * float(part[0][i, 0] + part[1][j]))
                yield Ghost(float(scale[i, j]), offset[i, j], fraction)


def _refined(leds: np.ndarray, lights: np.ndarray, shown: np.ndarray) -> Ghost:
    """Return the ghost by least squares of all LEDs that show it."""
    has = shown >= 0
    source, light = _pixels(leds[has]), _pixels(lights[shown[has]])
    of_source, of_light = source - source.mean(axis=0), light - light.mean(axis=0)
    magnification = float((of_source * of_light).sum() / (of_source**2).sum())
    fraction = float(np.exp(np.mean(np.log(lights["flux"][shown[has]] / leds["flux"][has]))))
    return Ghost(magnification, light.mean(axis=0) - magnification * source.mean(axis=0), fraction)


def _mean(known: Ghost, last: Ghost) -> Ghost:
    if abs(known.magnification - last.magnification) > 0.1:
        return known
    a, b = 1.0 - _WEIGHT, _WEIGHT
    return Ghost(
        a * known.magnification + b * last.magnification, a * known.offset + b * last.offset,
        known.fraction**a * last.fraction**b,
    )  # fmt: skip


def _pixels(spots: np.ndarray) -> Array:
    return np.column_stack([spots["u"], spots["v"]])
