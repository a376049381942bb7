"""Random numbers: each random source has its own stream, keyed by the run's seed.

Two runs of the same seed have the same sensor noise, whatever else differs.
"""

from __future__ import annotations

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


class NormalRows:
    """Rows of standard normals, drawn in blocks; the numbers do not depend on the block's length."""

    def __init__(self, generator: np.random.Generator, width: int, block: int = 1024) -> None:
        self._generator = generator
        self._shape = (block, width)
        self._rows = np.empty((0, width))
        self._next = 0

    def next_row(self) -> np.ndarray:
        """Return the next row, shape (width,)."""
        if self._next == len(self._rows):
            self._rows = self._generator.standard_normal(self._shape)
            self._next = 0
        row: np.ndarray = self._rows[self._next]
        self._next += 1
        return row
