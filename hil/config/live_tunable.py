"""Settings that an operator may change while a scenario is flown: which are sound, in what range, in what unit."""

from __future__ import annotations

import difflib
import json
from dataclasses import asdict, dataclass
from typing import Any, Final

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel, field_validator

from hil.config.model import ConfigModel

_CONTROL: Final = (
    "deadband_m",
    "lead_s",
    "period_s",
    "deadband_sigmas",
    "correction_rate_mps",
    "deadband_deg",
    "attitude_lead_s",
    "attitude_period_s",
    "attitude_deadband_sigmas",
    "slew_rate_degps",
)
_CORRIDOR: Final = (
    "half_angle_deg",
    "minimum_radius_m",
    "closing_rate_mps",
    "closing_rate_slope_per_s",
    "closing_rate_max_mps",
    "confidence",
    "persistence_s",
)
_VISION_ONLY: Final = ("position_lag_s", "velocity_lag_s", "attitude_lag_s", "rate_lag_s")

LIVE_TUNABLE: Final = (
    *(f"gnc.control.{name}" for name in _CONTROL),
    *(f"gnc.corridor.{name}" for name in _CORRIDOR),
    "gnc.navigation.gate_sigma",
    "gnc.akf.gyro_noise_degps",
    "gnc.akf.gyro_drift_noise_degps2",
    "gnc.pkf.accelerometer_noise_mps2",
    "gnc.pkf.accelerometer_bias_noise_mps3",
    *(f"gnc.vision_only.{name}" for name in _VISION_ONLY),
)
"""Keys whose number each cycle reads anew. All others shape what has begun (vehicle, step, geometry, plan, the filters'
start), or what the run is judged by (requirements): they stand for the whole run."""


class InFlight(ConfigModel):
    """What a scenario lets the operator change at the console while it is flown."""

    adjustable: tuple[str, ...] = ()

    @field_validator("adjustable")
    @classmethod
    def _each_is_sound(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for key in value:
            if key not in LIVE_TUNABLE:
                close = difflib.get_close_matches(key, LIVE_TUNABLE, n=1, cutoff=0.8)
                hint = f"did you mean {close[0]}? " if close else ""
                allowed = ", ".join(LIVE_TUNABLE)
                raise ValueError(f"{json.dumps(key)}: cannot be changed in flight: {hint}allowed: {allowed}")
            if value.count(key) > 1:
                raise ValueError(f"{json.dumps(key)}: stands here twice")
        return value


@dataclass(frozen=True)
class Range:
    """What a number may be: low, high: None for no end there; *_open: the end itself is not allowed."""

    low: float | None = None
    high: float | None = None
    low_open: bool = False
    high_open: bool = False

    def __contains__(self, value: float) -> bool:
        above = self.low is None or (value > self.low if self.low_open else value >= self.low)
        below = self.high is None or (value < self.high if self.high_open else value <= self.high)
        return above and below

    def __str__(self) -> str:
        if self.low is not None and self.high is not None:
            words = (
                f"{'above ' if self.low_open else ''}{self.low:g} to {'below ' if self.high_open else ''}{self.high:g}"
            )
        elif self.low is not None:
            words = f"above {self.low:g}" if self.low_open else f"{self.low:g} or more"
        elif self.high is not None:
            words = f"below {self.high:g}" if self.high_open else f"{self.high:g} or less"
        else:
            words = "any number"
        return words

    def as_json(self) -> dict[str, Any]:
        """Return what a page needs to check a number."""
        return asdict(self) | {"words": str(self)}


def range_of(model: type[BaseModel], key: str) -> Range:
    """Return the range of the number at the dotted ``key`` of ``model``, by its model's own limits."""
    *tables, last = key.split(".")
    for table in tables:
        inner = model.model_fields[table].annotation
        assert isinstance(inner, type)
        assert issubclass(inner, BaseModel)
        model = inner
    found: dict[str, Any] = {}
    for limit in model.model_fields[last].metadata:
        match limit:
            case Gt(gt=number):
                found |= {"low": number, "low_open": True}
            case Ge(ge=number):
                found |= {"low": number}
            case Lt(lt=number):
                found |= {"high": number, "high_open": True}
            case Le(le=number):
                found |= {"high": number}
            case _:
                pass
    return Range(**found)


def value_of(table: BaseModel, key: str) -> float:
    """Return the number at the dotted ``key`` of ``table``."""
    found: Any = table
    for name in key.split("."):
        found = getattr(found, name)
    return float(found)
