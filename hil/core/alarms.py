"""Alarms (ANSI/ISA-18.2): kinds, and alarms of a kind with value and limit as numbers and as texts.

``alarm_table`` lists all kinds.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Final

from hil.errors import SafetyTrip

HIGH, MEDIUM, LOW = "high", "medium", "low"
PRIORITIES: Final = (HIGH, MEDIUM, LOW)
"""Of alarms, in their order: to act on at once, soon, when there is time."""
Digits = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm: bench time, device, monitored quantity, its value and its limit, both with units.

    latched: it stands. active: its condition lasts. number: in its session, from 1. shelved_until_s: bench time, 0 if
    it is not shelved. code: of its kind. measured, allowed: value and limit as numbers in SI ``unit``, None if they
    are none.
    """

    t_s: float
    device: str
    quantity: str
    value: str
    limit: str
    text: str = ""
    latched: bool = True
    acknowledged: bool = False
    priority: str = HIGH
    active: bool = True
    number: int = 0
    acknowledged_by: str = ""
    shelved_until_s: float = 0.0
    code: str = ""
    measured: float | None = None
    allowed: float | None = None
    unit: str = ""

    def __post_init__(self) -> None:
        if not self.text:
            object.__setattr__(self, "text", f"{self.device}: {self.quantity} {self.value}, allowed {self.limit}")

    def trip(self) -> SafetyTrip:
        """Return the error that ends the run."""
        return SafetyTrip(self)

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def slug(text: str) -> str:
    """Return ``text`` as a part of a name."""
    return text.replace(" ", "_").replace("-", "_")


@dataclass(frozen=True)
class AlarmKind:
    """A kind of alarm.

    quantity: what is monitored, {} for a part that varies. code: name in JSON and columns. device: which raises it.
    allowed: limit, key of the rig file, modes. hazard: row of docs/hazards.toml. unit: of the numbers, SI; m and m/s
    are rad and rad/s of an axis that rotates. digits: of the value, without and with rotation; limit_digits: of the
    limit; both as few as possible unless set. value, limit: texts around the numbers. by_guard: raised by the bench
    guard.
    """

    quantity: str
    device: str
    allowed: str
    hazard: str
    unit: str = ""
    digits: Digits | None = None
    limit_digits: Digits | None = None
    value: str = "{}"
    limit: str = "{}"
    priority: str = HIGH
    code: str = ""
    by_guard: bool = False

    def unit_of(self, rotates: bool) -> str:
        """Return the unit, that of an axis if it ``rotates``."""
        return self.unit.replace("m", "rad", 1) if rotates else self.unit

    def alarm(
        self,
        t_s: float,
        device: str,
        value: float | str,
        limit: float | str | tuple[float, float],
        *parts: object,
        rotates: bool = False,
        unit: str | None = None,
        notes: tuple[str, str] = ("", ""),
    ) -> Alarm:
        """Return an alarm at bench time ``t_s``.

        value, limit: SI, or texts; limit: also a range. parts: of the quantity. rotates: it is that of an axis that
        rotates. unit: instead of that of the kind. notes: texts after value and limit.
        """
        unit = self.unit_of(rotates) if unit is None else unit
        number = None if isinstance(value, str) else _finite(value)
        bound: float | None = None
        if isinstance(limit, tuple):
            bound = _finite(limit[0] if number is not None and number < limit[0] else limit[1])
            limit_text = " to ".join(_shown(each, unit, self.limit_digits) for each in limit)
        else:
            bound = None if isinstance(limit, str) else _finite(limit)
            limit_text = limit if isinstance(limit, str) else self.limit.format(_shown(limit, unit, self.limit_digits))
        value_text = value if isinstance(value, str) else self.value.format(_shown(value, unit, self.digits))
        return Alarm(
            t_s,
            device,
            self.quantity.format(*parts),
            value_text + notes[0],
            limit_text + notes[1],
            priority=self.priority,
            code=self.code,
            measured=number,
            allowed=bound,
            unit="" if number is None and bound is None else unit,
        )

    def trip(
        self, device: str, value: float | str, limit: float | str | tuple[float, float], *parts: object, **more: Any
    ) -> SafetyTrip:
        """Return the error that ends a run by such an alarm. Arguments of ``alarm``."""
        return self.alarm(0.0, device, value, limit, *parts, **more).trip()


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _shown(value: float, unit: str, digits: Digits | None) -> str:
    """Return ``value`` with its unit, an angle in degrees."""
    is_angle = unit.startswith("rad")
    value, unit = (math.degrees(value), unit.replace("rad", "deg")) if is_angle else (value, unit)
    return f"{value:g} {unit}".rstrip() if digits is None else f"{value:.{digits[is_angle]}f} {unit}".rstrip()
