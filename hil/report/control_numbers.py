"""Leads and dead bands of the built-in control, with the numbers from which they follow."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.config.scenario import Scenario
from hil.gnc.control import rule_of
from hil.params import gnc as gnc_params

_AXES: Final = ("x", "y", "z", "roll", "pitch", "yaw")


def control_numbers(history: np.ndarray, scenario: Scenario) -> dict[str, Any] | None:
    """Return what control used at the end of ``history`` (n,) of CYCLE, None if it was not the built-in one.

    The shortest firing is that of the configuration, not that which was measured in flight.
    """
    valid = np.flatnonzero(history["navigation"]["valid"])
    if scenario.gnc.foreign.get("control") or scenario.gnc.binary is not None or not len(valid):
        return None
    params = gnc_params.control(scenario, gnc_params.allocation(scenario.chaser)[1])
    last, rows = history["navigation"][valid[-1]], []
    sigma = [*last["sigma_r_m"], *last["sigma_attitude_rad"]]
    sigma_rate = [*last["sigma_v_mps"], 0.0, 0.0, 0.0]
    for axis, name in enumerate(_AXES):
        pulse = float(params.acceleration[axis] * params.pulse_s)
        lead_s, noise, coast, band = rule_of(params, axis, float(sigma[axis]), float(sigma_rate[axis]), pulse)
        numbers = {"smallest_change": pulse, "noise": noise, "coast": coast, "dead_band": band}
        unit, scale = ("mm", 1e3) if axis < 3 else ("deg", math.degrees(1.0))
        rows.append(
            {"axis": name, "unit": unit, "lead_s": lead_s, "period_s": float(params.period[axis] * params.dt_s)}
            | {key: scale * value for key, value in numbers.items()}
        )
    return {"shortest_firing_s": float(params.pulse_s), "axes": rows}
