"""Filter monitor: consistency of the innovations (NIS), and comparison with the shadow filter, in the loop."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.messages import Event
from hil.core.observable import ObservableList
from hil.maths import chi_square

WINDOWS = (64, 512)  # updates per mean: a fast and a sensitive one
_TAIL = 1e-6  # false-alarm probability of a mean, on either side
_CLEAR_TAIL = 0.1  # an alarm clears well inside the band: hysteresis against chatter


def nis_band(updates: int, tail: float) -> tuple[float, float]:
    """Return the band of the mean of ``updates`` three-component NIS, ``tail`` outside on each side."""
    return chi_square.band_of_mean(updates, 3, tail)


class NisMonitor:
    """Detects when the mean of the last ``window`` NIS leaves the band of a consistent filter."""

    def __init__(self, name: str, window: int) -> None:
        self.name = name
        self.low, self.high = nis_band(window, _TAIL)
        self._clear = nis_band(window, _CLEAR_TAIL)
        self._values: deque[float] = deque(maxlen=window)
        self._sum = 0.0
        self.inconsistent = False
        self._mean = math.nan

    def add(self, nis: float) -> str | None:
        """Add the NIS of an update; return a message if the result of the check changes."""
        window = self._values.maxlen
        assert window is not None
        if len(self._values) == window:
            self._sum -= self._values[0]
        self._values.append(nis)
        self._sum += nis
        if len(self._values) < window:
            return None
        self._mean = mean = self._sum / window
        if self.inconsistent and self._clear[0] <= mean <= self._clear[1]:
            self.inconsistent = False
            return f"innovations are as large as expected again: mean NIS {mean:.2f} over {window} poses"
        if self.inconsistent or self.low <= mean <= self.high:
            return None
        self.inconsistent = True
        size, tuning = ("larger", "small") if mean > self.high else ("smaller", "large")
        return (
            f"innovations are {size} than expected: mean NIS {mean:.2f} over {window} poses, "
            f"allowed {self.low:.2f} to {self.high:.2f}; Q or R is too {tuning}"
        )

    def condition(self) -> Alarm:
        """Return the result of the check as an alarm, at no time, that is active if the filter is inconsistent."""
        band, window = (self.low, self.high), self._values.maxlen
        alarm = table.MEAN_NIS.alarm(0.0, "navigation", self._mean, band, self.name, window)
        return replace(alarm, active=self.inconsistent)


class FilterMonitor:
    """NIS monitors and, if enabled, the shadow filter.

    navigation: NAVIGATION_PARAMS. shadow_limits: largest divergence in m and rad, None for no shadow filter.
    """

    def __init__(self, navigation: np.record, shadow_limits: tuple[float, float] | None) -> None:
        self.events: ObservableList[Event] = ObservableList()
        self.conditions: ObservableList[Alarm] = ObservableList()
        """Checks as they begin and cease to fail: alarms at no time, active or not."""
        self.largest_divergence = (0.0, 0.0)  # m, rad
        self._cycle_s = float(navigation.dt_s)
        self._position = [NisMonitor("pkf", window) for window in WINDOWS]
        self._attitude = [NisMonitor("akf", window) for window in WINDOWS]
        self._limits = shadow_limits
        self._diverged = False
        if shadow_limits is not None:
            from hil.gnc.estimation.shadow_filter import ShadowFilter  # filterpy takes a second to import

            self._shadow: ShadowFilter | None = ShadowFilter(navigation.fusion)
        else:
            self._shadow = None

    @property
    def needs_every_cycle(self) -> bool:
        """Whether ``update`` is needed in cycles without a pose as well."""
        return self._shadow is not None

    def update(
        self, cycle: int, samples: np.ndarray, poses: np.ndarray, estimate: np.record, memory: np.ndarray
    ) -> None:
        """Check the filters after ``cycle``. samples: of IMU. poses: of POSE, the new ones. estimate: NAVIGATION."""
        if len(poses):
            self.add_innovations(cycle, estimate.nis_position, estimate.nis_attitude)
        if self._shadow is not None:
            self._compare(cycle, samples, poses, memory)

    def add_innovations(self, cycle: int, nis_position: float, nis_attitude: float) -> None:
        """Check the NIS of the update in ``cycle``; nan for a filter without one."""
        for monitors, nis in ((self._position, nis_position), (self._attitude, nis_attitude)):
            for monitor in monitors if math.isfinite(nis) else ():
                text = monitor.add(nis)
                if text:
                    self.events.append(Event(float(round(cycle * self._cycle_s, 6)), monitor.name, text))
                    self.conditions.append(monitor.condition())

    def _compare(self, cycle: int, samples: np.ndarray, poses: np.ndarray, memory: np.ndarray) -> None:
        assert self._shadow is not None
        assert self._limits is not None
        divergence = self._shadow.step(cycle, samples, poses, memory)
        if divergence is None:
            return
        self.largest_divergence = (
            max(self.largest_divergence[0], divergence.position),
            max(self.largest_divergence[1], divergence.angle),
        )
        diverged = divergence.position > self._limits[0] or divergence.angle > self._limits[1]
        if diverged == self._diverged:
            return
        self._diverged = diverged
        value = f"{divergence.position:.4f} m and {math.degrees(divergence.angle):.4f} deg"
        limit = f"{self._limits[0]:g} m and {math.degrees(self._limits[1]):g} deg"
        self.conditions.append(replace(table.SHADOW.alarm(0.0, "navigation", value, limit), active=diverged))
        if diverged:
            text = f"diverges from the filters by {value}, allowed {limit}"
            self.events.append(Event(float(round(cycle * self._cycle_s, 6)), "shadow", text))
