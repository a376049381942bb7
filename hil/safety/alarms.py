"""Log of the alarms of the bench and of its consistency monitors (ANSI/ISA-18.2).

A *trip*, of high priority, ends in a safe stop and stays latched until a reset. A *condition*, of medium or low
priority, stands while it lasts, and until it is acknowledged; it may be shelved for a time. Each alarm is acknowledged
by itself.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from hil.core.alarms import HIGH, PRIORITIES, Alarm
from hil.core.observable import ObservableList

SHELVED_MAX_S: Final = 3600.0
"""Longest time for which an alarm can be shelved."""


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
