"""Watches over the filters while they run: are they as good as they say?"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from hil.core.messages import Event
from hil.core.observable import ObservableList

WINDOWS = (64, 512)  # updates that a mean is taken over: quick, and fine
_TAIL = 1e-6  # of that mean, on either side: what chance may do in a long campaign
_SETTLED_TAIL = 0.1  # an alarm ends well inside the band, so that it does not chatter at its edge


def nis_band(updates: int, tail: float) -> tuple[float, float]:
    """Return the band of the mean of ``updates`` three-component NIS, ``tail`` left out on each side."""
    return (
        float(2.0 * gammaincinv(1.5 * updates, tail)) / updates,  # chi-square of 3 a value
        float(2.0 * gammainccinv(1.5 * updates, tail)) / updates,
    )


class NisMonitor:
    """Tells when the mean of the last ``window`` NIS leaves the band that honest covariances keep it in."""

    def __init__(self, name: str, window: int) -> None:
        self.name = name
        self.low, self.high = nis_band(window, _TAIL)
        self._settled = nis_band(window, _SETTLED_TAIL)
        self._values: deque[float] = deque(maxlen=window)
        self._sum = 0.0
        self.inconsistent = False

    def add(self, nis: float) -> str | None:
        """Take the NIS of an update; return what to tell when the judgement changes."""
        window = self._values.maxlen
        assert window is not None
        if len(self._values) == window:
            self._sum -= self._values[0]
        self._values.append(nis)
        self._sum += nis
        if len(self._values) < window:
            return None
        mean = self._sum / window
        if self.inconsistent and self._settled[0] <= mean <= self._settled[1]:
            self.inconsistent = False
            return f"innovations are as large as expected again: mean NIS {mean:.2f} over {window} poses"
        if self.inconsistent or self.low <= mean <= self.high:
            return None
        self.inconsistent = True
        size, belief = ("larger", "small") if mean > self.high else ("smaller", "large")
        return (
            f"innovations are {size} than expected: mean NIS {mean:.2f} over {window} poses, "
            f"allowed {self.low:.2f} to {self.high:.2f}; Q or R is too {belief}"
        )


class FilterMonitor:
    """NIS monitors, and the shadow filter where it is wanted.

    navigation: NAVIGATION_PARAMS. shadow_limits: largest parting in m and rad, None for no shadow.
    """

    def __init__(self, navigation: np.record, shadow_limits: tuple[float, float] | None) -> None:
        self.events: ObservableList[Event] = ObservableList()
        self.largest_parting = (0.0, 0.0)  # m, rad
        self._dt = float(navigation.fusion.pkf.dt_s)
        self._position = [NisMonitor("pkf", window) for window in WINDOWS]
        self._attitude = [NisMonitor("akf", window) for window in WINDOWS]
        self._limits = shadow_limits
        self._parted = False
        if shadow_limits is not None:
            from hil.gnc.shadow_filter import ShadowFilter  # filterpy takes a second to import

            self._shadow: ShadowFilter | None = ShadowFilter(navigation.fusion)
        else:
            self._shadow = None

    @property
    def looks_always(self) -> bool:
        """Whether ``look`` has something to do in cycles without a pose."""
        return self._shadow is not None

    def look(self, cycle: int, imu: np.record, poses: np.ndarray, estimate: np.record, memory: np.ndarray) -> None:
        """Look at what came in ``cycle`` and what the filters made of it. poses: of POSE, the new ones alone."""
        if len(poses):
            for monitors, nis in ((self._position, estimate.nis_position), (self._attitude, estimate.nis_attitude)):
                for monitor in monitors if math.isfinite(nis) else ():
                    said = monitor.add(nis)
                    if said:
                        self.events.append(Event(float(round(cycle * self._dt, 6)), monitor.name, said))
        if self._shadow is not None:
            self._compare(cycle, imu, poses, memory)

    def _compare(self, cycle: int, imu: np.record, poses: np.ndarray, memory: np.ndarray) -> None:
        assert self._shadow is not None
        assert self._limits is not None
        parting = self._shadow.step(cycle, imu, poses, memory)
        if parting is None:
            return
        self.largest_parting = (
            max(self.largest_parting[0], parting.position),
            max(self.largest_parting[1], parting.angle),
        )
        parted = parting.position > self._limits[0] or parting.angle > self._limits[1]
        if parted and not self._parted:
            text = (
                f"parts from the filters by {parting.position:.4f} m and {math.degrees(parting.angle):.4f} deg, "
                f"allowed {self._limits[0]:g} m and {math.degrees(self._limits[1]):g} deg"
            )
            self.events.append(Event(float(round(cycle * self._dt, 6)), "shadow", text))
        self._parted = parted
