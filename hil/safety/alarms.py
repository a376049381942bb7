"""Alarms: what stopped the bench, latched until somebody has seen it and the bench was reset."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from hil.core.observable import ObservableList
from hil.errors import BenchError, DeviceError, DriveFault, LinkLost, LinkTimeout, ProtocolError, SafetyTrip

_KINDS: dict[type[DeviceError], tuple[str, str]] = {
    LinkLost: ("link", "connected"),
    LinkTimeout: ("silence", "an answer in time"),
    ProtocolError: ("protocol", "bytes that mean what they should"),
    DriveFault: ("drive fault", "none"),
}


@dataclass(frozen=True, slots=True)
class Alarm:
    """One trip: bench time, device, what was watched, what it was and what it may be, both with their units."""

    t_s: float
    device: str
    quantity: str
    value: str
    limit: str
    text: str = ""
    latched: bool = True
    acknowledged: bool = False

    def __post_init__(self) -> None:
        if not self.text:
            object.__setattr__(self, "text", f"{self.device}: {self.quantity} {self.value}, allowed {self.limit}")

    def trip(self) -> SafetyTrip:
        """Return the error that ends the run for this alarm."""
        return SafetyTrip(self.device, self.quantity, self.value, self.limit)

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def alarm_from_error(error: BenchError, t_s: float) -> Alarm:
    """Return the alarm that belongs to an error of the bench; its text is the error's."""
    if isinstance(error, SafetyTrip):
        return Alarm(t_s, error.device, error.quantity, error.value, error.limit, str(error))
    if isinstance(error, DeviceError):
        quantity, limit = _KINDS.get(type(error), ("device", "no error"))
        return Alarm(t_s, error.device, quantity, error.what, limit, str(error))
    return Alarm(t_s, "bench", "error", str(error), "none", str(error))


class AlarmLog:
    """All alarms of a session in the order in which they came.

    One that is latched stays until ``reset``, acknowledged or not; the same device and quantity does
    not raise a second one meanwhile, so a fault that repeats does not bury the first.
    """

    def __init__(self) -> None:
        self._alarms: list[Alarm] = []
        self.raised: ObservableList[Alarm] = ObservableList()
        """Each alarm as it came, whatever became of it."""

    def latch(self, alarm: Alarm) -> Alarm:
        """Latch ``alarm``; return it, or the one that is latched for the same device and quantity already."""
        for known in self._alarms:
            if known.latched and (known.device, known.quantity) == (alarm.device, alarm.quantity):
                return known
        self._alarms.append(replace(alarm, latched=True, acknowledged=False))
        self.raised.append(self._alarms[-1])
        return self._alarms[-1]

    def acknowledge(self) -> int:
        """Say that all alarms have been seen; return how many were new."""
        new = sum(not alarm.acknowledged for alarm in self._alarms)
        self._alarms = [replace(alarm, acknowledged=True) for alarm in self._alarms]
        return new

    def reset(self) -> None:
        """Let go of all alarms; whoever resets has seen them. They stay in the list."""
        self._alarms = [replace(alarm, acknowledged=True, latched=False) for alarm in self._alarms]

    def all(self) -> tuple[Alarm, ...]:
        return tuple(self._alarms)

    def latched(self) -> tuple[Alarm, ...]:
        return tuple(alarm for alarm in self._alarms if alarm.latched)
