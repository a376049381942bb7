"""Units at the end of a key's name: which of them measure the same, and the factor between them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

_DEG: Final = math.degrees(1.0)
_DIMENSIONS: Final[tuple[dict[str, float], ...]] = (
    {"m": 1.0, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "au": 1.495978707e11},
    {"s": 1.0, "us": 1e-6, "ms": 1e-3, "min": 60.0, "h": 3600.0, "d": 86_400.0},
    {"deg": 1.0, "rad": _DEG, "mrad": 1e-3 * _DEG, "arcsec": 1.0 / 3600.0},
    {"kg": 1.0, "g": 1e-3},
    {"n": 1.0, "mn": 1e-3, "kn": 1e3},
    {"hz": 1.0, "khz": 1e3},
    {"mps": 1.0, "mmps": 1e-3, "cmps": 1e-2},
    {"degps": 1.0, "radps": _DEG, "mradps": 1e-3 * _DEG},
    {"mps2": 1.0, "mmps2": 1e-3},
    {"degps2": 1.0, "radps2": _DEG},
)
_UNITS: Final = {unit for dimension in _DIMENSIONS for unit in dimension}


def unit_at_end(key: str) -> str:
    """Return the unit with which ``key`` ends, "" for none that is known here."""
    unit = key.rpartition("_")[2]
    return unit if unit != key and unit in _UNITS else ""


def converted(key: str, value: Any, known: Iterable[str]) -> str:
    """Return a key of ``known`` with the name of ``key`` in another unit of the same dimension, as ``NAME = VALUE``.

    Returns "" if there is none; only the name if ``value`` is no number.
    """
    unit = unit_at_end(key)
    stem = key.removesuffix(f"_{unit}")
    for dimension in _DIMENSIONS:
        for other, factor in dimension.items():
            name = f"{stem}_{other}"
            if unit in dimension and name in known and name != key:
                if isinstance(value, bool) or not isinstance(value, int | float):
                    return name
                return f"{name} = {value * dimension[unit] / factor:.12g}"
    return ""
