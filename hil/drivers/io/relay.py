"""Safety relay of emulator and mock. No I/O, time is an argument."""

from __future__ import annotations

import math
from typing import Final

DROP_OUT_S: Final = 0.005


class SafetyRelay:
    """Enables torque while the emergency stop is released, the charge pump toggles and enable is on.

    It opens ``DROP_OUT_S`` after one of the conditions fails, and closes only at a rising edge of enable at which all
    of them hold: a released button or a restarted program never starts the bench. ``update`` must be called more often
    than the pump toggles.
    pump_timeout_s: longest time between two edges of the charge pump.
    """

    def __init__(self, pump_timeout_s: float) -> None:
        self.closed = False
        self._pump_timeout_s = pump_timeout_s
        self._edge_s = -math.inf
        self._pump = self._enable = False
        self._open_at_s = math.inf

    def update(self, t_s: float, pump: bool, enable: bool, contacts_closed: bool) -> bool:
        """Update with the levels at ``t_s``; contacts_closed: emergency stop and interlocks. Return ``closed``."""
        if pump != self._pump:
            self._pump = pump
            self._edge_s = t_s
        risen = enable and not self._enable
        self._enable = enable
        failed_at_s = t_s if not (enable and contacts_closed) else self._edge_s + self._pump_timeout_s
        if t_s < failed_at_s:
            self._open_at_s = math.inf
            self.closed = self.closed or risen
        elif self.closed:
            self._open_at_s = min(self._open_at_s, failed_at_s + DROP_OUT_S)
            self.closed = t_s < self._open_at_s
        return self.closed
