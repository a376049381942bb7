"""Random numbers: each random source has its own stream, keyed by the run's seed.

Two runs of the same seed have the same sensor noise, whatever else differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Protocol, Self

import numpy as np

from hil.maths.normals import Generator
from hil.maths.special import normal_probabilities

_STREAMS = {
    "initial": 0,
    "imu": 1,
    "vision": 2,
    "transport": 3,
    "thrusters": 4,
    "encoders": 5,
    "wire": 6,
    "monitor": 7,
    "pictures": 8,
    "dispersions": 9,
    "geometry": 10,
}
_NO_MEANS = np.zeros(0)


def generator_of(seed: int, key: tuple[int, ...]) -> Generator:
    """Return the generator of ``key`` for ``seed``."""
    return Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def stream(seed: int, name: str, device: str = "") -> Generator:
    """Return the generator of the source ``name`` for a run of ``seed``; each ``device`` has one of its own."""
    return generator_of(seed, (_STREAMS[name], *device.encode()))


class NoiseSource(Protocol):
    """Source of independent random numbers, filled into ``out`` if it is given: the methods of numpy's Generator."""

    def standard_normal(self, size: Any = None, *, out: Any = None) -> Any:
        """Return standard normals."""

    def random(self, size: Any = None, *, out: Any = None) -> Any:
        """Return numbers that are uniform in [0, 1)."""


class MixedSeed(int):
    """Seed of a run whose noise is a weighted sum of the noise of several seeds; the integer is the first of them.

    seeds: newest first. weights: of their standard normals, with a sum of squares of 1. means: added to the first
    normals of a source, by its name, flat. Random numbers that are not drawn by ``noise_source`` are those of the first
    seed.
    """

    seeds: tuple[int, ...]
    weights: tuple[float, ...]
    means: Mapping[str, np.ndarray] = MappingProxyType({})

    def __new__(cls, seeds: Sequence[int], weights: Sequence[float]) -> Self:
        mixed = super().__new__(cls, seeds[0])
        mixed.seeds, mixed.weights = tuple(seeds), tuple(weights)
        return mixed

    def __getnewargs__(self) -> tuple[tuple[int, ...], tuple[float, ...]]:  # type: ignore[override]
        return self.seeds, self.weights

    @classmethod
    def fresh(cls, seed: int) -> Self:
        """Return the mixed seed with the normals of ``seed`` alone."""
        return cls((seed,), (1.0,))

    def moved(self, seed: int, scale: float) -> Self:
        """Return sqrt(1 - scale^2) times this noise plus ``scale`` times the noise of ``seed``: standard normals."""
        kept = math.sqrt(1.0 - scale * scale)
        return type(self)((seed, *self.seeds), (scale, *(kept * weight for weight in self.weights)))

    def shifted(self, means: Mapping[str, np.ndarray]) -> Self:
        """Return this noise with ``means`` added to its standard normals."""
        mixed = type(self)(self.seeds, self.weights)
        mixed.means = means
        return mixed


class _MixedNoise:
    """Weighted sum of generators' standard normals; uniform numbers are their distribution function.

    means: added to the first normals that are drawn.
    """

    def __init__(self, generators: list[np.random.Generator], weights: tuple[float, ...], means: np.ndarray) -> None:
        self._generators = generators
        self._weights = weights
        self._means = means
        self._drawn = np.empty(0)

    def standard_normal(self, size: Any = None, *, out: Any = None) -> Any:
        shape = size if out is None else out.shape
        total = np.empty(() if shape is None else shape) if out is None else out
        if self._drawn.shape != total.shape:
            self._drawn = np.empty(total.shape)
        first, *others = zip(self._generators, self._weights, strict=True)
        np.multiply(first[0].standard_normal(total.shape, out=total), first[1], out=total)
        for generator, weight in others:
            drawn = generator.standard_normal(total.shape, out=self._drawn)
            np.multiply(drawn, weight, out=drawn)
            np.add(total, drawn, out=total)
        if len(self._means):
            flat = total.reshape(-1)
            flat[: len(self._means)] += self._means[: flat.size]
            self._means = self._means[flat.size :]
        return total

    def random(self, size: Any = None, *, out: Any = None) -> Any:
        return normal_probabilities(self.standard_normal(size, out=out), out)


def noise_source(seed: int, name: str) -> NoiseSource:
    """Return the source of the numbers that a rare-event campaign may mix: of ``stream`` unless ``seed`` is mixed."""
    if isinstance(seed, MixedSeed):
        means = seed.means.get(name, _NO_MEANS)
        return _MixedNoise([stream(each, name) for each in seed.seeds], seed.weights, means)
    return stream(seed, name)


class RandomRows:
    """Rows of random numbers, drawn in blocks; the numbers do not depend on the block's length.

    draw: returns an array of a shape, filled with the next numbers of a generator.
    """

    def __init__(self, draw: Callable[[tuple[int, int]], np.ndarray], width: int, block: int = 1024) -> None:
        self._draw = draw
        self._width = width
        self._block = block
        self._rows = np.empty((0, width))
        self._next = 0

    def next_row(self) -> np.ndarray:
        """Return the next row, shape (width,)."""
        if self._next == len(self._rows):
            self._rows = self._draw((self._block, self._width))
            self._next = 0
        row: np.ndarray = self._rows[self._next]
        self._next += 1
        return row

    def next_rows(self, n: int) -> np.ndarray:
        """Return the next ``n`` rows, (n, width)."""
        rows = self.peek(n)
        self.skip(n)
        return rows

    def peek(self, n: int) -> np.ndarray:
        """Return the next ``n`` rows, (n, width), without taking them."""
        if missing := max(0, self._next + n - len(self._rows)):
            drawn = self._draw((max(self._block, missing), self._width))
            self._rows = np.concatenate([self._rows[self._next :], drawn])
            self._next = 0
        return self._rows[self._next : self._next + n]

    def skip(self, n: int) -> None:
        """Take ``n`` rows that ``peek`` has returned."""
        self._next += n


class NormalRows(RandomRows):
    """Rows of standard normals."""

    def __init__(self, generator: NoiseSource, width: int, block: int = 1024) -> None:
        super().__init__(generator.standard_normal, width, block)


class UniformRows(RandomRows):
    """Rows of numbers that are uniform in [0, 1)."""

    def __init__(self, generator: NoiseSource, width: int, block: int = 1024) -> None:
        super().__init__(generator.random, width, block)
