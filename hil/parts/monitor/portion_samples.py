"""Portions of a docking monitor that measures on images, as samples of its sensor in the loop."""

from __future__ import annotations

import math
from collections import Counter
from typing import Protocol

import numpy as np

from hil.core.sensor_records import SENSOR_SAMPLE
from hil.maths import elementary, linear
from hil.maths.elementary import square
from hil.params.sensors import MONITOR
from hil.parts.monitor.results import NO_TARGET, Portion
from hil.parts.monitor.sensor import UNOBSERVED_RAD


class PortionSource(Protocol):
    """Docking monitor whose results arrive while the loop runs."""

    def poll(self) -> list[Portion]:
        """Return the portions that have been completed since the last call; never waits."""


class PortionSamples:
    """Samples of the docking monitor from ``source``. number: of the sensor in the loop."""

    def __init__(self, source: PortionSource, number: int) -> None:
        self._source, self._number, self._count = source, number, 0
        self.refused: Counter[str] = Counter()
        self.name, self.failure, self.last_s = MONITOR, "", math.inf  # never an alarm: no target, no samples

    def poll(self, now_s: float, run_zero_s: float) -> np.ndarray:
        """Return what has arrived since the last call, (n,) of SENSOR_SAMPLE, in the run's time."""
        rows = [np.zeros(0, SENSOR_SAMPLE)]
        for portion in self._source.poll():
            row = np.zeros(1, SENSOR_SAMPLE)
            if portion.status == NO_TARGET or not write_sample(portion, row[0]):
                continue
            row["sensor"], row["number"] = self._number, self._count
            row["t_s"], row["received_s"] = portion.t_s, now_s - run_zero_s
            self._count += 1
            rows.append(row)
        return np.concatenate(rows)

    def close(self) -> None:
        """Do nothing: the monitor belongs to the session."""


def write_sample(portion: Portion, sample: np.void) -> bool:
    """Write value and covariance of ``portion`` to ``sample`` (SENSOR_SAMPLE); return whether it has range and sight.

    Angles that the portion does not have get a standard deviation with which they do not count.
    """
    range_m, right, up = (portion.value(name) for name in ("range_m", "los_right_rad", "los_up_rad"))
    if not np.isfinite([range_m, right, up]).all():
        return False
    sight = np.array([elementary.tan(right), elementary.tan(up), 1.0])
    sight /= linear.length(sight)
    along, across = portion.sigma("range_m"), np.array([portion.sigma("los_right_rad"), portion.sigma("los_up_rad")])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = square(along) * np.outer(sight, sight)
    covariance[0, 0] += square(range_m * across[0])
    covariance[1, 1] += square(range_m * across[1])
    phi = np.array([portion.value(name) for name in ("phi1_rad", "phi2_rad", "phi3_rad")])
    sigmas = np.array([portion.sigma(name) for name in ("phi1_rad", "phi2_rad", "phi3_rad")])
    observed = np.isfinite(phi) & np.isfinite(sigmas)
    covariance[3:, 3:] = np.diag(square(np.where(observed, sigmas, UNOBSERVED_RAD)))
    sample["value"][:3], sample["value"][3:] = range_m * sight, np.where(observed, phi, 0.0)
    sample["covariance"] = covariance
    return True
