"""Base of the configuration models.

The name of a key ends in its unit (``_m``, ``_mps``, ``_deg`` ...), numbers are finite, unknown keys are
errors. Angles are in degrees; ``hil.params`` converts them to radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, field_validator

from hil.config.tables.units import si_factor, split

SMALLEST: Final = 1e-50
LARGEST: Final = 1e9
"""Range of the magnitude of each number that is not 0, in its unit: beyond it, squares and quotients of the models
leave the range of a double. Most keys have a narrower range of their own."""


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError(f"{text!r}: must consist of printable characters")
    if "/" in text or "\\" in text or text.startswith("."):
        raise ValueError(f"{text!r}: must have no / or \\ and not begin with a dot")
    return text


@dataclass(frozen=True)
class Live:
    """Range in which a number may be changed during a run, declared with the type of its key.

    Neither gate nor supervision can be switched off by a number within it.
    """

    low: float
    high: float


Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
DELAY_MAX_S: Final = 1.0
Delay = Annotated[float, Field(ge=0.0, le=DELAY_MAX_S)]
Probability = Annotated[float, Field(ge=0.0, lt=1.0)]
Name = Annotated[str, StringConstraints(max_length=100), AfterValidator(_printable)]
"""Text for a page, a terminal and the name of a file."""
Triple = tuple[float, float, float]
NotNegativeTriple = tuple[NotNegative, NotNegative, NotNegative]
Matrix3 = tuple[Triple, Triple, Triple]
AngleTriple = tuple[
    Annotated[float, Field(gt=-180.0, le=180.0)],
    Annotated[float, Field(gt=-90.0, lt=90.0)],
    Annotated[float, Field(gt=-180.0, le=180.0)],
]


class ConfigModel(BaseModel):
    """Base of all tables of configuration files."""

    # a table is built with the file that holds it, not at import: most are parts of others. Their defaults are
    # therefore constructed, not validated.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True, defer_build=True)

    @classmethod
    def key_of(cls, stem: str) -> str:
        """Return the key that is ``stem`` with a unit at its end."""
        return _key_of(cls, stem)

    def in_file(self, stem: str) -> Any:
        """Return the value of ``key_of(stem)`` as the file has it."""
        return getattr(self, _key_of(type(self), stem))

    def si(self, stem: str) -> Any:
        """Return the number, or the numbers, of ``key_of(stem)`` in SI units, angles in radians."""
        value, factor = self.in_file(stem), si_factor(_key_of(type(self), stem))
        return tuple(factor * each for each in value) if isinstance(value, tuple) else factor * value

    @field_validator("*")
    @classmethod
    def _numbers_are_in_range(cls, value: Any) -> Any:
        _check_magnitudes(value)
        return value


@cache
def _key_of(model: type[ConfigModel], stem: str) -> str:
    (key,) = (name for name in model.model_fields if split(name)[0] == stem)
    return key


def _check_magnitudes(value: Any) -> None:
    if isinstance(value, float):
        if value and not SMALLEST <= abs(value) <= LARGEST:
            raise ValueError(f"{value:g}: must be 0, or {SMALLEST:g} to {LARGEST:g} in magnitude")
    elif isinstance(value, tuple):
        for inner in value:
            _check_magnitudes(inner)
