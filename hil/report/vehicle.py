"""Numbers of navigation and thrusters, by their keys in the JSON of a run, from what is counted of its rows."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.dynamics.thrusters import STANDARD_GRAVITY_MPS2
from hil.loop.compiled.run_stats import BEFORE, SETTLED

_RMS_KEYS: Final = (
    "position_rmse_m",
    "velocity_rmse_mps",
    "attitude_rmse_deg",
    "position_sigma_m",
    "attitude_sigma_deg",
)
_DEGREES: Final = np.array([1.0, 1.0, np.degrees(1.0), 1.0, np.degrees(1.0)])


def navigation_numbers(sums: np.record) -> dict[str, Any]:
    """Return errors of the estimate, and the filters' own sigmas, once settled (over all, if the run ended before).

    sums: NAVIGATION_SUMS. Root mean squares, three values each, and mean NEES; None for those that are unknown.
    """
    return navigation_means(sums, SETTLED if sums.estimates[SETTLED] else BEFORE)


def navigation_means(sums: np.record, span: int) -> dict[str, Any]:
    """Return ``navigation_numbers`` of one ``span``, SETTLED or BEFORE."""
    n, updates = int(sums.estimates[span]), sums.updates[span]
    squares = np.concatenate([sums.square_error[span], sums.square_sigma[span]]).reshape(5, 3)
    rms = np.sqrt(squares / n) if n else np.full((5, 3), np.nan)
    found: dict[str, Any] = {
        name: (values * unit).tolist() if np.isfinite(values).all() else None
        for name, values, unit in zip(_RMS_KEYS, rms, _DEGREES, strict=True)
    }
    for k, name in enumerate(("nees_pkf", "nees_akf")):
        found[name] = float(sums.nees[span, k] / updates[k]) if updates[k] else None
    return found


def attitude_error(history: np.ndarray) -> Array:
    """Return the small-angle rotation from the estimated to the true attitude in each row, (n, 3), rad, in c."""
    q, p = history["truth"]["q_CH"], history["navigation"]["q_CH"]
    # twice the vector part of q_true * conj(q_estimate)
    vector = p[:, 3:] * q[:, :3] - q[:, 3:] * p[:, :3] + np.cross(q[:, :3], p[:, :3])
    rotation: Array = 2.0 * vector * np.sign(np.sum(p * q, axis=1))[:, None]
    return rotation


def thruster_numbers(stats: np.record, scenario: Scenario) -> dict[str, Any]:
    """Return the use of the thrusters: demands, open times, firings, propellant. stats: RUN_STATS."""
    n, step_s = len(scenario.chaser.thrusters.position_m), scenario.step_s
    return {
        "force_on_time_s": (step_s * stats.force_cycles).tolist(),
        "torque_on_time_s": (step_s * stats.torque_cycles).tolist(),
        "torque_on_time_360_400_s": (step_s * stats.torque_cycles_360_400_s).tolist(),
        "thruster_on_time_s": (step_s * stats.thruster_open[:n]).tolist(),
        "thruster_firings": stats.thruster_firings[:n].tolist(),
        "propellant_kg": propellant_kg(stats, scenario),
    }


def propellant_kg(stats: np.record, truth: Scenario) -> float:
    """Return the propellant used, kg; if the truth loses no mass, that of the valves for the time they were open."""
    if truth.truth.mass_loss:
        return float(stats.mass_start - stats.mass_end)
    thrusters, open_s = truth.chaser.thrusters, truth.step_s * float(np.sum(stats.thruster_open))
    return open_s * thrusters.force_n / (thrusters.specific_impulse_s * STANDARD_GRAVITY_MPS2)
