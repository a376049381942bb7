"""Units of FMI variables: conversion to the SI units of the records."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final

from hil.parts.fmi.archive import FmuError

_SYMBOLS: Final = {
    "1": ({}, 1.0),
    "-": ({}, 1.0),
    "%": ({}, 0.01),
    "rad": ({}, 1.0),
    "deg": ({}, math.pi / 180.0),
    "rev": ({}, 2.0 * math.pi),
    "m": ({"m": 1}, 1.0),
    "mm": ({"m": 1}, 1e-3),
    "cm": ({"m": 1}, 1e-2),
    "km": ({"m": 1}, 1e3),
    "s": ({"s": 1}, 1.0),
    "ms": ({"s": 1}, 1e-3),
    "min": ({"s": 1}, 60.0),
    "h": ({"s": 1}, 3600.0),
    "Hz": ({"s": -1}, 1.0),
    "kg": ({"kg": 1}, 1.0),
    "g": ({"kg": 1}, 1e-3),
    "N": ({"kg": 1, "m": 1, "s": -2}, 1.0),
}
_FACTOR: Final = re.compile(r"([A-Za-z%]+|-|1)(?:\^?\(?([+-]?\d)\)?)?")


@dataclass(frozen=True)
class FmiUnit:
    """A unit: a value in SI is ``factor * value + offset``. exponents: of the SI base units but rad; None: unknown."""

    exponents: tuple[tuple[str, int], ...] | None
    factor: float = 1.0
    offset: float = 0.0


def unit_of_bases(exponents: dict[str, int], factor: float, offset: float) -> FmiUnit:
    """Return the unit with these exponents; rad counts as 1, because tools disagree about it. Raises FmuError."""
    if factor == 0.0:
        raise FmuError("its model description has a unit with factor 0")
    bases = tuple(sorted((name, n) for name, n in exponents.items() if n and name != "rad"))
    return FmiUnit(bases, factor, offset)


def parse_unit(text: str) -> FmiUnit:
    """Return the unit ``text``, such as "deg/s" or "kg m^2"; its exponents are None if it is unknown."""
    exponents: dict[str, int] = {}
    factor = 1.0
    for i, side in enumerate(text.replace("**", "^").replace("·", ".").replace("*", ".").split("/")):
        for part in re.split(r"[.\s]+", side.strip().strip("()")):
            match = _FACTOR.fullmatch(part)
            if match is None or match[1] not in _SYMBOLS:
                return FmiUnit(None)
            bases, size = _SYMBOLS[match[1]]
            power = int(match[2] or 1) * (-1 if i else 1)
            factor *= size**power
            for name, n in bases.items():
                exponents[name] = exponents.get(name, 0) + n * power
    return unit_of_bases(exponents, factor, 0.0)


def to_si(defined: FmiUnit, name: str, expected: str) -> tuple[float, float]:
    """Return (factor, offset) from the unit ``name`` to ``expected``, the SI unit of a record's field.

    defined: by the FMU; the unit's name decides if that has no base units. Raises FmuError.
    """
    unit = defined if defined.exponents is not None else parse_unit(name)
    if unit.exponents is None:
        raise FmuError(f"has the unit {name!r}, which neither the FMU nor this program defines")
    if unit.exponents != parse_unit(expected).exponents:
        raise FmuError(f"has the unit {name!r}, the bench has {expected!r}")
    return unit.factor, unit.offset
