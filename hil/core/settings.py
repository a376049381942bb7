"""Numbers that an extension, a backend or a sensor, declares as keys of the scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hil.core.gnc_records import MAX_SETTINGS
from hil.core.public import public


@public
@dataclass(frozen=True, slots=True)
class Setting:
    """A number that an extension declares: a key of the scenario, in ``unit``.

    A backend's key is ``gnc.control.settings.NAME``, a sensor's ``sensors.SENSOR.NAME``. low, high: range of the value,
    both included. Raises ValueError if the declaration contradicts itself.
    """

    name: str
    default: float
    unit: str = "1"
    low: float = -math.inf
    high: float = math.inf
    doc: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ValueError(f"setting {self.name!r}: must be an identifier")
        if not self.low <= self.default <= self.high:
            raise ValueError(f"setting {self.name}: default {self.default:g}, allowed {self.allowed}")

    @property
    def allowed(self) -> str:
        """Range as text."""
        if math.isinf(self.low) and math.isinf(self.high):
            return "any number"
        if math.isinf(self.high):
            return f"{self.low:g} or more"
        return f"{self.high:g} or less" if math.isinf(self.low) else f"{self.low:g} to {self.high:g}"

    def problem(self, value: float) -> str:
        """Return why ``value`` is not allowed, "" if it is."""
        if self.low <= value <= self.high:
            return ""
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        return f"{value:g}: must be {self.allowed}{unit}"


def checked_settings(declared: Any) -> tuple[Setting, ...]:
    """Return the declared settings. Raises ValueError for anything but a sequence of Setting with different names."""
    settings = tuple(declared) if isinstance(declared, Sequence) else (declared,)
    for setting in settings:
        if not isinstance(setting, Setting):
            raise ValueError(f"settings: {setting!r:.60} is no hil.Setting")
    names = [setting.name for setting in settings]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"settings: {twice[0]} is declared twice")
    if len(settings) > MAX_SETTINGS:
        raise ValueError(f"settings: {len(settings)} are declared, allowed {MAX_SETTINGS}")
    return settings
