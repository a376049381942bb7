"""Settings that an operator may change during a run, and their ranges."""

from __future__ import annotations

import difflib
import json
from typing import Any, Final

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
"""Keys that each cycle reads again. All others determine the initial state (vehicle, step, geometry, plan, filters) or
the verdict (requirements): they are fixed for the whole run."""


class LiveTuning(ConfigModel):
    """Table ``[console]`` of a scenario: settings that the operator may change during a run."""

    adjustable: tuple[str, ...] = ()
    """Dotted keys that the operator may change during a run."""

    @field_validator("adjustable")
    @classmethod
    def _each_is_live_tunable(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for key in value:
            if key not in LIVE_TUNABLE:
                close = difflib.get_close_matches(key, LIVE_TUNABLE, n=1, cutoff=0.8)
                hint = f"did you mean {close[0]}? " if close else ""
                allowed = ", ".join(LIVE_TUNABLE)
                raise ValueError(f"{json.dumps(key)}: cannot be changed in flight: {hint}allowed: {allowed}")
            if value.count(key) > 1:
                raise ValueError(f"{json.dumps(key)}: is listed twice")
        return value


def range_of(model: type[BaseModel], key: str) -> dict[str, Any]:
    """Return the limits of the number at the dotted ``key`` of ``model``.

    low, high: None if unlimited. low_open, high_open: the limit itself is excluded. words: the range as text.
    """
    *tables, last = key.split(".")
    for table in tables:
        inner = model.model_fields[table].annotation
        assert isinstance(inner, type)
        assert issubclass(inner, BaseModel)
        model = inner
    schema = model.model_json_schema()["properties"][last]
    low, low_open = schema.get("exclusiveMinimum", schema.get("minimum")), "exclusiveMinimum" in schema
    high, high_open = schema.get("exclusiveMaximum", schema.get("maximum")), "exclusiveMaximum" in schema
    if low is not None and high is not None:
        words = f"{'above ' if low_open else ''}{low:g} to {'below ' if high_open else ''}{high:g}"
    elif low is not None:
        words = f"above {low:g}" if low_open else f"{low:g} or more"
    elif high is not None:
        words = f"below {high:g}" if high_open else f"{high:g} or less"
    else:
        words = "any number"
    return {"low": low, "high": high, "low_open": low_open, "high_open": high_open, "words": words}


def value_of(table: BaseModel, key: str) -> float:
    """Return the number at the dotted ``key`` of ``table``."""
    found: Any = table
    for name in key.split("."):
        found = getattr(found, name)
    return float(found)
