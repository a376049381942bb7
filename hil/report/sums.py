"""Sums and samples over the blocks of a run."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.core.messages import Array
from hil.maths.elementary import square

_SAMPLE_MAX: Final = 100_000


class ThinnedSample:
    """Values for percentiles: all of them, then every second, every fourth ...; the largest is exact."""

    def __init__(self) -> None:
        self._parts: list[Array] = []
        self._size = self._seen = 0
        self._every = 1
        self._largest = -math.inf

    def add(self, values: Array) -> None:
        """Add ``values`` (n,)."""
        if not len(values):
            return
        self._largest = max(self._largest, float(values.max()))
        self._parts.append(values[-self._seen % self._every :: self._every].copy())
        self._seen += len(values)
        self._size += len(self._parts[-1])
        if self._size > _SAMPLE_MAX:
            self._parts = [np.concatenate(self._parts)[::2]]
            self._size, self._every = len(self._parts[0]), 2 * self._every

    def values(self) -> Array:
        """Return the sample; of one that was thinned, with the largest value as its last."""
        largest = [self._largest] if self._every > 1 else []
        return np.concatenate([*self._parts, largest])


class Squares:
    """Root mean square and largest magnitude of values (n,), or of three values (n, 3), each alone."""

    def __init__(self) -> None:
        self.n = 0
        self._sum: Any = 0.0
        self._largest: Any = -math.inf

    def add(self, values: Array) -> None:
        """Add the next values."""
        if len(values):
            self.n += len(values)
            self._sum = self._sum + np.sum(square(values), axis=0)
            self._largest = np.maximum(self._largest, np.abs(values).max(axis=0))

    def rms(self) -> Any:
        """Return the root mean square, None without values or if it is not finite."""
        return self._finite(np.sqrt(self._sum / self.n)) if self.n else None

    def largest(self) -> Any:
        """Return the largest magnitude, None without values or if the root mean square is not finite."""
        return self._finite(self._largest) if self.rms() is not None else None

    def as_json(self, name: str, unit: str) -> dict[str, Any]:
        """Return both by the keys ``NAME_rms_UNIT`` and ``NAME_max_UNIT``; without values none."""
        return {f"{name}_rms_{unit}": self.rms(), f"{name}_max_{unit}": self.largest()} if self.n else {}

    @staticmethod
    def _finite(value: Any) -> Any:
        return np.asarray(value).tolist() if np.isfinite(value).all() else None
