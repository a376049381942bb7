"""Safety relay of emulator and mock, with holding brakes. No I/O, time is an argument."""

from __future__ import annotations

import math
from typing import Final

DROP_OUT_S: Final = 0.005


class SafetyRelay:
    """Enables torque while the emergency stop is released, the charge pump toggles and enable is on.

    It opens ``DROP_OUT_S`` after one of the conditions fails, and closes only at a rising edge of enable at which all
    of them hold: a released button or a restarted program never starts the bench. ``update`` must be called more often
    than the pump toggles.
    Its delayed contacts, which carry the torque, open ``torque_delay_s`` after the others, which carry the current of
    the brakes. pump_timeout_s: longest time between two edges of the charge pump.
    """

    def __init__(self, pump_timeout_s: float, torque_delay_s: float = 0.0) -> None:
        self.closed = False
        self._torque_delay_s = torque_delay_s
        self._torque_until_s = -math.inf
        self._pump_timeout_s = pump_timeout_s
        self._edge_s = -math.inf
        self._pump = self._enable = False
        self._open_at_s = math.inf

    def update(self, t_s: float, pump: bool, enable: bool, contacts_closed: bool, may_close: bool = True) -> bool:
        """Update with the levels at ``t_s``; return ``closed``.

        contacts_closed: emergency stop and interlocks. may_close: contact in the relay's reset circuit.
        """
        if pump != self._pump:
            self._pump = pump
            self._edge_s = t_s
        risen = enable and not self._enable and may_close
        self._enable = enable
        failed_at_s = t_s if not (enable and contacts_closed) else self._edge_s + self._pump_timeout_s
        if t_s < failed_at_s:
            self._open_at_s = math.inf
            self.closed = self.closed or risen
        elif self.closed:
            self._open_at_s = min(self._open_at_s, failed_at_s + DROP_OUT_S)
            self.closed = t_s < self._open_at_s
        if self.closed:
            self._torque_until_s = t_s + self._torque_delay_s
        return self.closed

    def torque(self, t_s: float) -> bool:
        """Return whether the delayed contacts are closed: the drives have torque."""
        return self.closed or t_s < self._torque_until_s


class HoldingBrakes:
    """Holding brakes of all axes that have one: released by current, closed by springs after ``close_s``."""

    def __init__(self, close_s: float, open_s: float = 0.1) -> None:
        self.close_s = close_s
        self._open_s = open_s
        self._released = False
        self._changed_s = -math.inf

    def update(self, t_s: float, released: bool) -> bool:
        """Update with the current at ``t_s``; return whether the brakes are closed."""
        if released != self._released:
            self._released = released
            self._changed_s = t_s
        passed_s = t_s - self._changed_s
        return passed_s < self._open_s if released else passed_s >= self.close_s
