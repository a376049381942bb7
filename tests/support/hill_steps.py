"""Motion of the Hill frame over one step of the filters, for tests that call them alone."""

from __future__ import annotations

import numpy as np

from hil.core.messages import new
from hil.gnc.estimation.target_orbit import HILL_STEP, TARGET_ORBIT, move_hill_frame


def on_circle(rate: float, dt_s: float) -> np.record:
    """Return HILL_STEP of a circular orbit with ``rate``, rad/s."""
    orbit, step = new(TARGET_ORBIT), new(HILL_STEP)
    orbit.mean_motion = rate
    move_hill_frame(orbit, 0.0, dt_s, step)
    return step
