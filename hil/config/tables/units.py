"""Units at the end of a key's name: how they are written, which of them measure the same, and their factors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final, NamedTuple


class Unit(NamedTuple):
    """A unit. text: as it is written, "" if no key has it. One of it is ``factor`` of the unit ``base``."""

    text: str
    base: str = ""
    factor: float = 1.0


_DEG: Final = math.degrees(1.0)
_RAD: Final = math.radians(1.0)
UNITS: Final = {
    "m": Unit("m", "m"),
    "um": Unit("", "m", 1e-6),
    "mm": Unit("mm", "m", 1e-3),
    "cm": Unit("", "m", 1e-2),
    "km": Unit("km", "m", 1e3),
    "au": Unit("au", "m", 1.495978707e11),
    "s": Unit("s", "s"),
    "us": Unit("us", "s", 1e-6),
    "ms": Unit("", "s", 1e-3),
    "min": Unit("", "s", 60.0),
    "h": Unit("", "s", 3600.0),
    "d": Unit("d", "s", 86_400.0),
    "deg": Unit("deg", "deg"),
    "rad": Unit("rad", "deg", _DEG),
    "mrad": Unit("", "deg", 1e-3 * _DEG),
    "arcsec": Unit("", "deg", 1.0 / 3600.0),
    "kg": Unit("kg", "kg"),
    "g": Unit("", "kg", 1e-3),
    "n": Unit("N", "n"),
    "mn": Unit("", "n", 1e-3),
    "kn": Unit("", "n", 1e3),
    "hz": Unit("Hz", "hz"),
    "khz": Unit("", "hz", 1e3),
    "mps": Unit("m/s", "mps"),
    "mmps": Unit("", "mps", 1e-3),
    "cmps": Unit("", "mps", 1e-2),
    "degps": Unit("deg/s", "degps"),
    "radps": Unit("", "degps", _DEG),
    "mradps": Unit("", "degps", 1e-3 * _DEG),
    "mps2": Unit("m/s²", "mps2"),
    "mmps2": Unit("", "mps2", 1e-3),
    "degps2": Unit("deg/s²", "degps2"),
    "radps2": Unit("", "degps2", _DEG),
    "db": Unit("dB"),
    "m2": Unit("m²"),
    "mps3": Unit("m/s³"),
    "degps3": Unit("deg/s³"),
    "kg_m2": Unit("kg m²"),
    "kgpm2": Unit("kg/m²"),
    "kgpm3": Unit("kg/m³"),
    "km3ps2": Unit("km³/s²"),
    "n_per_mps": Unit("N s/m"),
    "nm": Unit("Nm"),
    "nm_per_degps": Unit("Nm s/deg"),
    "px": Unit("px"),
    "levels": Unit("grey levels"),
    "per_s": Unit("1/s"),
    "per_level": Unit("1/grey level"),
    "cycles": Unit("cycles"),
    "bytes": Unit("bytes"),
}
"""End of a key -> unit."""


def split(key: str) -> tuple[str, str]:
    """Return ``key`` without the unit of a key at its end, and that unit, "" for none."""
    words = key.split("_")
    for start in range(1, len(words)):
        unit = "_".join(words[start:])
        if unit in UNITS and UNITS[unit].text:
            return "_".join(words[:start]), unit
    return key, ""


def si_factor(key: str) -> float:
    """Return what a number of ``key`` is multiplied with for SI units and radians."""
    unit = split(key)[1]
    return _RAD if unit.startswith("deg") else UNITS[unit].factor


def converted(key: str, value: Any, names: Iterable[str]) -> str:
    """Return a key of ``names`` with the name of ``key`` in another unit of the same kind, as ``NAME = VALUE``.

    Returns "" if there is none; only the name if ``value`` is no number.
    """
    stem, _, end = key.rpartition("_")
    unit = UNITS.get(end)
    if not stem or unit is None or not unit.base:
        return ""
    for name in names:
        start, _, other = name.rpartition("_")
        if start == stem and name != key and other in UNITS and UNITS[other].base == unit.base:
            if isinstance(value, bool) or not isinstance(value, int | float):
                return name
            return f"{name} = {value * unit.factor / UNITS[other].factor:.12g}"
    return ""
