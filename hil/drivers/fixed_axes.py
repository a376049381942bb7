"""Axes without a drive, as a part of their group."""

from __future__ import annotations

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.core.messages import Array, AxisFeedback
from hil.drivers.base import accepted_setpoint, full_names


class FixedAxes:
    """AxisGroup of the fixed axes of ``table``: they stand where the rig file has them, whatever is sent."""

    def __init__(self, name: str, table: AxisGroupTable) -> None:
        fixed = [axis for axis in table.axis_names if axis not in table.driven]
        self.name = name
        self.axis_names = full_names(name, fixed)
        self._at = np.array([getattr(table, axis).si("park") for axis in fixed])

    def open(self, now_s: float) -> None:
        """Do nothing, as in all other orders."""

    def home(self, now_s: float) -> None:
        """Do nothing: the position is known."""

    def set_jogging(self, on: bool) -> None:
        """Do nothing."""

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Return where the axes stand. Raises SafetyTrip for a value that is not finite."""
        return accepted_setpoint(self.axis_names, position, self._at, self._at)

    def move_to(self, position: Array, rate: Array, now_s: float) -> Array:
        """Return where the axes stand."""
        return self.send(position, rate, now_s)

    def read(self, now_s: float) -> AxisFeedback:
        """Return where the axes stand, at rest."""
        return AxisFeedback(now_s, self._at.copy(), np.zeros_like(self._at))

    def stop(self, now_s: float) -> None:
        """Do nothing."""

    def disable(self, now_s: float) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""
