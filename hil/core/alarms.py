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
    """A kind of alarm; its code is its name in JSON and columns.

    quantity: what is monitored, {} for a part that varies. device: which raises it. hazard: row of docs/hazards.toml.
    unit: of the numbers, SI; m and m/s are rad and rad/s of an axis that rotates. value, limit: texts around them.
    digits, limit_digits: theirs, without and with rotation, as few as possible unless set. by_guard: raised by the
    bench guard.
    """

    quantity: str
    device: str
    hazard: str
    unit: str = ""
    value: str = "{}"
    limit: str = "{}"
    digits: Digits | None = None
    limit_digits: Digits | None = None
    priority: str = HIGH
    code: str = ""
    by_guard: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "code", self.code or slug(self.quantity.replace("{}", "").strip().replace("'", "")))

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
        bounds = limit if isinstance(limit, tuple) else (limit,)
        measured, low, high = map(_finite, (value, bounds[0], bounds[-1]))
        allowed = low if low is not None and measured is not None and measured < low else high
        texts = (
            _shown(value, unit, self.digits, self.value) + notes[0],
            " to ".join(_shown(bound, unit, self.limit_digits, self.limit) for bound in bounds) + notes[1],
        )
        unit = "" if measured is None and allowed is None else unit
        numbers: dict[str, Any] = {"code": self.code, "measured": measured, "allowed": allowed, "unit": unit}
        return Alarm(t_s, device, self.quantity.format(*parts), *texts, priority=self.priority, **numbers)

    def trip(self, device: str, value: float | str, limit: float | str, *parts: object, **more: Any) -> SafetyTrip:
        """Return the error that ends a run by such an alarm. Arguments of ``alarm``."""
        return self.alarm(0.0, device, value, limit, *parts, **more).trip()


def _finite(value: float | str) -> float | None:
    return None if isinstance(value, str) or not math.isfinite(value) else float(value)


def _shown(value: float | str, unit: str, digits: Digits | None, text: str) -> str:
    """Return ``value`` with its unit in ``text``, an angle in degrees."""
    if isinstance(value, str):
        return value
    if is_angle := unit.startswith("rad"):
        value, unit = math.degrees(value), unit.replace("rad", "deg")
    form = "g" if digits is None else f".{digits[is_angle]}f"
    return text.format(f"{value:{form}} {unit}".rstrip())
