"""Random numbers: each random source has its own stream, keyed by the run's seed.

Two runs of the same seed have the same sensor noise, whatever else differs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

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
}


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the generator of the source ``name`` for a run of ``seed``."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(_STREAMS[name],))))


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

    def __init__(self, generator: np.random.Generator, width: int, block: int = 1024) -> None:
        super().__init__(generator.standard_normal, width, block)


class UniformRows(RandomRows):
    """Rows of numbers that are uniform in [0, 1)."""

    def __init__(self, generator: np.random.Generator, width: int, block: int = 1024) -> None:
        super().__init__(generator.random, width, block)
