"""Alarms of the bench: latched until acknowledged by the operator and reset."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

from hil.core.observable import ObservableList
from hil.errors import BenchError, DeviceError, DriveFault, LinkLost, LinkTimeout, ProtocolError, SafetyTrip

_KINDS: dict[type[DeviceError], tuple[str, str]] = {
    LinkLost: ("link", "connected"),
    LinkTimeout: ("timeout", "response in time"),
    ProtocolError: ("protocol", "valid message"),
    DriveFault: ("drive fault", "none"),
}


@dataclass(frozen=True, slots=True)
class Alarm:
    """One trip: bench time, device, monitored quantity, its value and its limit, both with units."""

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


def speed_text(device: str, speed: float) -> str:
    """Return the speed of an axis, m/s or rad/s, in the unit of alarms: deg/s for the turntable."""
    return f"{math.degrees(speed):.2f} deg/s" if device == "turntable" else f"{speed:.3f} m/s"


class AlarmLog:
    """Alarms of a session in the order of their occurrence.

    An alarm stays latched until ``reset``, acknowledged or not. Meanwhile the same device and quantity raises no
    second one, so that a repeated fault does not hide the first.
    """

    def __init__(self) -> None:
        self._alarms: list[Alarm] = []
        self.raised: ObservableList[Alarm] = ObservableList()
        """Each alarm as it was raised."""

    def latch(self, alarm: Alarm) -> Alarm:
        """Latch ``alarm``; return it, or the alarm already latched for the same device and quantity."""
        for latched in self._alarms:
            if latched.latched and (latched.device, latched.quantity) == (alarm.device, alarm.quantity):
                return latched
        self._alarms.append(replace(alarm, latched=True, acknowledged=False))
        self.raised.append(self._alarms[-1])
        return self._alarms[-1]

    def acknowledge(self) -> int:
        """Acknowledge all alarms; return the number of new ones."""
        new = sum(not alarm.acknowledged for alarm in self._alarms)
        self._alarms = [replace(alarm, acknowledged=True) for alarm in self._alarms]
        return new

    def reset(self) -> None:
        """Unlatch and acknowledge all alarms; they stay in the list."""
        self._alarms = [replace(alarm, acknowledged=True, latched=False) for alarm in self._alarms]

    def all(self) -> tuple[Alarm, ...]:
        return tuple(self._alarms)

    def latched(self) -> tuple[Alarm, ...]:
        return tuple(alarm for alarm in self._alarms if alarm.latched)
