"""Settings that an operator may change during a run, and their ranges."""

from __future__ import annotations

import difflib
import json
from functools import cache
from typing import Any, Final

from pydantic import BaseModel, field_validator

from hil.config.model import ConfigModel

LIVE_TUNABLE: Final = {
    "gnc.control.deadband_m": (0.0, 0.2),
    "gnc.control.lead_s": (0.0, 100.0),
    "gnc.control.period_s": (0.0, 60.0),
    "gnc.control.deadband_sigmas": (0.0, 10.0),
    "gnc.control.correction_rate_mps": (1e-4, 0.5),
    "gnc.control.deadband_deg": (0.0, 5.0),
    "gnc.control.attitude_lead_s": (0.0, 100.0),
    "gnc.control.attitude_period_s": (0.0, 60.0),
    "gnc.control.attitude_deadband_sigmas": (0.0, 10.0),
    "gnc.control.slew_rate_degps": (0.01, 5.0),
    "gnc.corridor.half_angle_deg": (0.5, 30.0),
    "gnc.corridor.minimum_radius_m": (0.01, 1.0),
    "gnc.corridor.closing_rate_mps": (1e-3, 0.5),
    "gnc.corridor.closing_rate_slope_per_s": (0.0, 1.0),
    "gnc.corridor.closing_rate_max_mps": (1e-2, 0.5),
    "gnc.corridor.confidence": (0.0, 10.0),
    "gnc.corridor.persistence_s": (0.0, 5.0),
    "gnc.navigation.gate_sigma": (2.0, 10.0),
    "gnc.navigation.noise_scale": (0.1, 10.0),
    "gnc.akf.gyro_noise_degps": (1e-8, 1.0),
    "gnc.akf.gyro_drift_noise_degps2": (0.0, 0.1),
    "gnc.pkf.accelerometer_noise_mps2": (1e-8, 0.1),
    "gnc.pkf.accelerometer_bias_noise_mps3": (0.0, 0.01),
}
"""Key -> range during a run: neither gate nor supervision can be switched off by a number.

Each cycle reads these keys again. All others determine the initial state (vehicle, step, geometry, plan, filters) or
the verdict (requirements): they are fixed for the whole run."""

BACKEND_SETTINGS: Final = ("gnc.navigation.settings.", "gnc.control.settings.")
"""Beginnings of the keys that backends declare; each may change, within the range that its backend declares."""


class LiveTuning(ConfigModel):
    """Table ``[console]`` of a scenario: settings that the operator may change during a run."""

    adjustable: tuple[str, ...] = ()
    """Dotted keys that the operator may change during a run."""

    @field_validator("adjustable")
    @classmethod
    def _each_is_live_tunable(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for key in value:
            if key not in LIVE_TUNABLE and not key.startswith(BACKEND_SETTINGS):
                close = difflib.get_close_matches(key, LIVE_TUNABLE, n=1, cutoff=0.8)
                hint = f"did you mean {close[0]}? " if close else ""
                allowed = ", ".join(LIVE_TUNABLE)
                raise ValueError(f"{json.dumps(key)}: cannot be changed in flight: {hint}allowed: {allowed}")
            if value.count(key) > 1:
                raise ValueError(f"{json.dumps(key)}: is listed twice")
        return value


@cache
def range_of(model: type[BaseModel], key: str) -> dict[str, Any]:
    """Return the limits of the number at the dotted ``key`` of ``model``; those of a run, if it is in LIVE_TUNABLE.

    low, high: None if unlimited. low_open, high_open: the limit itself is excluded. words: the range as text.
    """
    whole = key
    *tables, last = key.split(".")
    for table in tables:
        inner = model.model_fields[table].annotation
        assert isinstance(inner, type)
        assert issubclass(inner, BaseModel)
        model = inner
    schema = model.model_json_schema()["properties"][last]
    low, low_open = schema.get("exclusiveMinimum", schema.get("minimum")), "exclusiveMinimum" in schema
    high, high_open = schema.get("exclusiveMaximum", schema.get("maximum")), "exclusiveMaximum" in schema
    if (live := LIVE_TUNABLE.get(whole)) is not None:
        if low is None or live[0] > low:
            low, low_open = live[0], False
        if high is None or live[1] < high:
            high, high_open = live[1], False
    if low is not None and high is not None:
        words = f"{'above ' if low_open else ''}{low:g} to {'below ' if high_open else ''}{high:g}"
    elif low is not None:
        words = f"above {low:g}" if low_open else f"{low:g} or more"
    elif high is not None:
        words = f"below {high:g}" if high_open else f"{high:g} or less"
    else:
        words = "any number"
    return {"low": low, "high": high, "low_open": low_open, "high_open": high_open, "words": words}


def within(allowed: dict[str, Any], value: float) -> bool:
    """Return whether ``value`` is in a range of ``range_of``."""
    low, high = allowed["low"], allowed["high"]
    too_low = low is not None and (value < low or (value == low and allowed["low_open"]))
    too_high = high is not None and (value > high or (value == high and allowed["high_open"]))
    return not (too_low or too_high)


def value_of(table: BaseModel, key: str) -> float:
    """Return the number at the dotted ``key`` of ``table``."""
    found: Any = table
    for name in key.split("."):
        found = found[name] if isinstance(found, dict) else getattr(found, name)
    return float(found)
