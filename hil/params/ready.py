"""Parameters of the ready phase: bench paper Table III, from the scenario's units to the kernels' record."""

from __future__ import annotations

import numpy as np

from hil.config.scenario import Requirements
from hil.core.messages import Array, new
from hil.gnc import ready_phase

ROW_NAMES = ("position_m", "velocity_mps", "attitude_deg", "rate_degps")
SETTLED_S = 100.0  # navigation errors count from here on, as in the paper's numerical simulation


def settled_s(duration_s: float) -> float:
    """Return the time of a run of ``duration_s`` from which on errors of the navigation count, s; a short one whole."""
    return SETTLED_S if duration_s >= SETTLED_S else 0.0


def ready_params(requirements: Requirements) -> np.record:
    """Return READY_PARAMS."""
    params = new(ready_phase.READY_PARAMS)
    params.axial_distance = requirements.axial_distance_m
    params.dwell_s = requirements.dwell_s
    params.tolerance = all_tolerances(requirements)
    return params


def all_tolerances(requirements: Requirements) -> Array:
    """Return the tolerances of all rows one after the other, (12,)."""
    allowed = tolerances(requirements)
    return np.concatenate([allowed[name] for name in ROW_NAMES])


def tolerances(requirements: Requirements) -> dict[str, Array]:
    """Return the allowed |deviation| of each row and axis (Table III)."""
    r = requirements
    return {
        "position_m": np.array([r.axial_tolerance_m, r.radial_distance_m, r.radial_distance_m]),
        "velocity_mps": np.array([r.axial_rate_mps, r.radial_rate_mps, r.radial_rate_mps]),
        "attitude_deg": np.full(3, r.angle_deg),
        "rate_degps": np.full(3, r.angular_rate_degps),
    }
