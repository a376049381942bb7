"""Anomalies of an elliptic orbit (Battin 1999, section 5.2)."""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.maths import elementary

_NEWTON_STEPS = 4  # from an error below e^2: each squares it; 2e-13 rad are left at e = 0.7


def mean_anomaly(eccentricity: float, nu: float) -> float:
    """Return the mean anomaly, rad, within half a turn of zero, at the true anomaly ``nu``, rad."""
    root = math.sqrt((1.0 - eccentricity) / (1.0 + eccentricity))
    eccentric = 2.0 * elementary.atan2(root * elementary.sin(0.5 * nu), elementary.cos(0.5 * nu))
    eccentric = math.remainder(eccentric, 2.0 * math.pi)
    return eccentric - eccentricity * elementary.sin(eccentric)


@kernel
def true_anomaly(eccentricity, mean_anomaly):
    """Return the true anomaly, rad, continuous with the mean anomaly, rad; ``eccentricity`` up to 0.7."""
    turns = math.floor(mean_anomaly / (2.0 * math.pi) + 0.5) * 2.0 * math.pi
    m = mean_anomaly - turns
    e_anomaly = m + eccentricity * elementary.sin(m)
    for _ in range(_NEWTON_STEPS):
        excess = e_anomaly - eccentricity * elementary.sin(e_anomaly) - m
        e_anomaly -= excess / (1.0 - eccentricity * elementary.cos(e_anomaly))
    root = math.sqrt((1.0 + eccentricity) / (1.0 - eccentricity))
    return turns + 2.0 * elementary.atan(root * elementary.tan(0.5 * e_anomaly))
