"""Alarms of the bench and of its consistency monitors (ANSI/ISA-18.2).

A *trip*, of high priority, ends in a safe stop and stays latched until a reset. A *condition*, of medium or low
priority, stands while it lasts, and until it is acknowledged; it may be shelved for a time. Each alarm is acknowledged
by itself.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from hil.core.observable import ObservableList
from hil.errors import BenchError, DeviceError, DriveFault, LinkLost, LinkTimeout, ProtocolError, SafetyTrip

_KINDS: dict[type[DeviceError], tuple[str, str]] = {
    LinkLost: ("link", "connected"),
    LinkTimeout: ("timeout", "response in time"),
    ProtocolError: ("protocol", "valid message"),
    DriveFault: ("drive fault", "none"),
}


HIGH, MEDIUM, LOW = "high", "medium", "low"
PRIORITIES: Final = (HIGH, MEDIUM, LOW)
"""Of alarms, in their order: to act on at once, soon, when there is time."""
SHELVED_MAX_S: Final = 3600.0
"""Longest time for which an alarm can be shelved."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm: bench time, device, monitored quantity, its value and its limit, both with units.

    latched: it stands. active: its condition lasts. number: in its session, from 1. shelved_until_s: bench time, 0 if
    it is not shelved.
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

    def __post_init__(self) -> None:
        if not self.text:
            object.__setattr__(self, "text", f"{self.device}: {self.quantity} {self.value}, allowed {self.limit}")

    def trip(self) -> SafetyTrip:
        """Return the error that ends the run."""
        return SafetyTrip(self.device, self.quantity, self.value, self.limit)

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def alarm_from_error(error: BenchError, t_s: float) -> Alarm:
    """Return the alarm of a bench error; its text is the text of the error."""
    if isinstance(error, SafetyTrip):
        return Alarm(t_s, error.device, error.quantity, error.value, error.limit, str(error))
    if isinstance(error, DeviceError):
        quantity, limit = _KINDS.get(type(error), ("device", "no error"))
        return Alarm(t_s, error.device, quantity, error.what, limit, str(error))
    return Alarm(t_s, "bench", "error", str(error), "none", str(error))


def speed_text(speed: float, rotates: bool) -> str:
    """Return the speed of an axis, m/s or rad/s, in the unit of alarms: deg/s for one that rotates."""
    return f"{math.degrees(speed):.2f} deg/s" if rotates else f"{speed:.3f} m/s"


class AlarmLog:
    """Alarms of a session in the order of their occurrence.

    A trip stays latched until ``reset``, acknowledged or not. Meanwhile the same device and quantity raises no
    second one, so that a repeated fault does not hide the first.
    """

    def __init__(self) -> None:
        self._alarms: list[Alarm] = []
        self.raised: ObservableList[Alarm] = ObservableList()
        """Each alarm as it was raised."""
        self.changes: ObservableList[tuple[Alarm, str]] = ObservableList()
        """Each further change of an alarm, with its text: acknowledged, returned to normal, shelved."""

    def latch(self, alarm: Alarm) -> Alarm:
        """Latch ``alarm``; return it, or the alarm already latched for the same device and quantity."""
        k = self._standing(alarm.device, alarm.quantity)
        if k is not None:
            return self._alarms[k]
        number = len(self._alarms) + 1
        self._alarms.append(replace(alarm, latched=True, acknowledged=False, active=True, number=number))
        self.raised.append(self._alarms[-1])
        return self._alarms[-1]

    def raise_condition(self, alarm: Alarm) -> None:
        """Raise ``alarm``, of medium or low priority, unless it stands; one that returned to normal is new again."""
        k = self._standing(alarm.device, alarm.quantity)
        if k is None:
            self.latch(alarm)
        elif not self._alarms[k].active:
            self._change(k, "active again", active=True, acknowledged=False, acknowledged_by="")

    def return_to_normal(self, device: str, quantity: str) -> None:
        """Take note that a condition has ended; its alarm stands until it is acknowledged."""
        k = self._standing(device, quantity)
        if k is not None and self._alarms[k].active:
            self._change(k, "returned to normal", active=False, latched=not self._alarms[k].acknowledged)

    def acknowledge(self, number: int | None = None, by: str = "") -> int:
        """Acknowledge alarm ``number``, None for all; return how many were new."""
        new = 0
        for k, alarm in enumerate(self._alarms):
            if alarm.acknowledged or number not in (None, alarm.number):
                continue
            new += 1
            text = f"acknowledged by {by}" if by else "acknowledged"
            self._change(k, text, acknowledged=True, acknowledged_by=by, latched=alarm.latched and alarm.active)
        return new

    def shelve(self, number: int, now_s: float, lasting_s: float, by: str = "") -> str:
        """Shelve alarm ``number`` for a time, 0 to end it; return why it cannot be shelved, "" if it is."""
        k = next((k for k, alarm in enumerate(self._alarms) if alarm.number == number and alarm.latched), None)
        if k is None:
            return f"alarm {number}: does not stand"
        if self._alarms[k].priority == HIGH:
            return f"alarm {number}: of high priority, which cannot be shelved"
        if not 0.0 <= lasting_s <= SHELVED_MAX_S:
            return f"{lasting_s:g} s: allowed 0 to {SHELVED_MAX_S:g} s"
        who = f" by {by}" if by else ""
        if lasting_s > 0.0:
            self._change(k, f"shelved for {lasting_s:g} s{who}", shelved_until_s=now_s + lasting_s)
        elif self._alarms[k].shelved_until_s:
            self._change(k, f"unshelved{who}", shelved_until_s=0.0)
        return ""

    def poll(self, now_s: float) -> None:
        """End the shelving of alarms whose time is over."""
        for k, alarm in enumerate(self._alarms):
            if 0.0 < alarm.shelved_until_s <= now_s:
                self._change(k, "unshelved: its time is over", shelved_until_s=0.0)

    def reset(self) -> None:
        """Unlatch and acknowledge all alarms; they stay in the list."""
        self._alarms = [replace(alarm, acknowledged=True, latched=False, active=False) for alarm in self._alarms]

    def all(self) -> tuple[Alarm, ...]:
        """Return all alarms of the session, those of high priority first."""
        return tuple(sorted(self._alarms, key=lambda alarm: PRIORITIES.index(alarm.priority)))

    def latest_trip(self) -> Alarm:
        """Return the newest alarm of high priority: the reason of a safe stop."""
        return [alarm for alarm in self._alarms if alarm.priority == HIGH][-1]

    def latched(self) -> tuple[Alarm, ...]:
        return tuple(alarm for alarm in self.all() if alarm.latched)

    def _standing(self, device: str, quantity: str) -> int | None:
        """Return the index of the alarm that stands for a quantity of a device."""
        for k, alarm in enumerate(self._alarms):
            if alarm.latched and (alarm.device, alarm.quantity) == (device, quantity):
                return k
        return None

    def _change(self, k: int, text: str, **values: Any) -> None:
        self._alarms[k] = replace(self._alarms[k], **values)
        self.changes.append((self._alarms[k], text))
