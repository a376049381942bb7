"""Long sample: the spots of successive pairs that are too faint to be solved one by one, joined to lights.

The target moves at a nearly constant rate during a sample, so each light moves on a straight line in the image. Its
place at the last exposure is that of the line, with the covariance that follows from those of its spots; noise, which
appears at random places, does not form lines.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.vmu.kernels.match import chi_square_limit
from hil.vmu.kernels.records import SPOT

_LONGEST_S: Final = 1.0
_FEWEST: Final = 4  # spots of a light
_SHARE: Final = 0.5  # of the pairs that show a light
_REACH_PX, _REACH_SIGMAS = 1.0, 4.0  # between a light and its next spot
_SPEED_PXPS: Final = 20.0  # of a light in the image
_MPS2, _RADPS2 = 0.05, 0.05  # standard deviation of the target's acceleration


class LongSample:
    """Pairs of the last second. Not thread-safe."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._pairs: list[tuple[np.ndarray, np.ndarray]] = []

    def clear(self) -> None:
        """Forget all pairs."""
        self._times, self._pairs = [], []

    def add(self, t_s: float, spots: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
        """Add the spots (SPOT) of a pair; return the lights of each image at ``t_s`` as SPOT, None if there are none.

        A pair that does not follow the last one in time begins a new sample. Images equal to the last ones, as from a
        camera that repeats them, are no new ones and do not count.
        """
        if self._pairs and not t_s > self._times[-1]:
            self.clear()
        if self._pairs and all(
            np.array_equal(here[name], last[name])
            for here, last in zip(spots, self._pairs[-1], strict=True)
            for name in ("u", "v")
        ):
            return None
        first = next((k for k, at in enumerate(self._times) if t_s - at <= _LONGEST_S), len(self._times))
        self._times, self._pairs = [*self._times[first:], t_s], [*self._pairs[first:], spots]
        misfit, degrees, combined = 0.0, 0, []
        for images in zip(*self._pairs, strict=True):
            lights = []
            for rows in self._chains(images):
                light, square = line_of(rows, np.array([self._times[k] for k, _ in rows]), images, t_s)
                misfit, degrees = misfit + square, degrees + 2 * len(rows) - 4
                lights.append(light)
            combined.append(np.array(lights, SPOT))
        if not degrees or misfit > chi_square_limit(degrees):
            return None
        return combined[0], combined[1]

    def accelerated(self, fit: np.void) -> np.void:
        """Return the pose ``fit`` (FIT) of the lights with the covariance of a motion that is not of constant rates.

        At the end of the straight line through a motion of acceleration a over a time T the error is ``a T^2 / 12``.
        """
        off = (self._times[-1] - self._times[0]) ** 2 / 12.0
        widened = fit.copy()
        for name in ("covariance", "noise"):
            widened[name] += np.diag(np.repeat([(_MPS2 * off) ** 2, (_RADPS2 * off) ** 2], 3))
        return widened

    def _chains(self, images: tuple[np.ndarray, ...]) -> list[list[tuple[int, int]]]:
        """Return the lights of one camera's spots ``images``: of each, the pairs and the indices of its spots."""
        chains: list[list[tuple[int, int]]] = []
        for k, spots in enumerate(images):
            free = np.ones(len(spots), bool)
            for chain in sorted(chains, key=len, reverse=True):
                image, last = chain[-1]
                away = np.hypot(spots["u"] - images[image][last]["u"], spots["v"] - images[image][last]["v"])
                sigma = np.sqrt(spots["var_u"] + spots["var_v"])
                reach = _REACH_PX + _REACH_SIGMAS * sigma + _SPEED_PXPS * (self._times[k] - self._times[image])
                inside = np.flatnonzero(free & (away < reach))
                if len(inside):
                    nearest = int(inside[np.argmin(away[inside])])
                    free[nearest] = False
                    chain.append((k, nearest))
            chains.extend([(k, int(n))] for n in np.flatnonzero(free))
        return [chain for chain in chains if len(chain) >= max(_FEWEST, _SHARE * len(images))]


def line_of(
    rows: list[tuple[int, int]], times: Array, images: tuple[np.ndarray, ...], t_s: float
) -> tuple[np.void, float]:
    """Return the light (SPOT) at ``t_s`` of spots on a straight line, and their squared distances over the variances.

    rows: indices of image and spot. times: (n,), s, of the images.
    """
    spots = np.array([images[k][n] for k, n in rows], SPOT)
    x = times - times.mean()
    part = 1.0 / len(rows) + (t_s - times.mean()) * x / (x @ x)
    hat = 1.0 / len(rows) + np.outer(x, x) / (x @ x)
    light, square = spots[-1].copy(), 0.0
    for name, variance in (("u", "var_u"), ("v", "var_v")):
        off = spots[name] - hat @ spots[name]
        square += float((off**2 / spots[variance]).sum())
        light[name] = part @ spots[name]
    for name in ("var_u", "var_v", "cov_uv"):
        light[name] = part**2 @ spots[name]
    return light, square
