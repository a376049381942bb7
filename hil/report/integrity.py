"""Integrity part of the verdict, and what detected the faults of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hil.config.scenario import REACTION_NAMES, Scenario
from hil.config.tables.faults import TimedFault
from hil.gnc.estimation.plane import filter_states
from hil.gnc.integrity_verdict import MONITOR_DISAGREES
from hil.maths import chi_square
from hil.maths.limits import finite_or_none
from hil.report import results

SAFE_STOP: Final = "safe stop"
_NEES_TAIL: Final = 2.5e-4  # of either filter
_NEES_MAX: Final = {
    planar: tuple(chi_square.upper_quantile(_NEES_TAIL, n) for n in filter_states(planar)) for planar in (False, True)
}
"""Largest mean NEES of position and attitude filter, by whether the chaser is planar."""


@dataclass(frozen=True)
class SafeStop:
    """Safe stop of a run at ``t_s``, by the bench guard ("guard") or another alarm ("device")."""

    t_s: float
    by: str


def integrity_part(state: np.record, scenario: Scenario) -> results.IntegrityResults:
    """Return the integrity part of the verdict. state: INTEGRITY_STATE at the end of a run.

    A GNC that reports no protection levels is judged by the distance to the target alone.
    """
    reported = bool(state.reported)
    nearest_m, keep_out_m = finite_or_none(state.nearest), scenario.keep_out.radius_m
    has_estimate = state.worst_limit > 0.0 or state.worst_error > 0.0
    return results.IntegrityResults(
        passed=bool(state.hmi_cycles == 0 and nearest_m is not None and nearest_m >= keep_out_m),
        hmi_cycles=int(state.hmi_cycles) if reported else None,
        hmi_by_line1_only=int(state.hmi_by_line1_only) if reported else None,
        worst_error_m=float(state.worst_error) if has_estimate else None,
        alert_limit_m=float(state.worst_limit) if has_estimate else None,
        protection_level_m=[finite_or_none(level) for level in state.worst_level],
        availability=float(state.available / state.judged) if reported and state.judged else None,
        time_to_alert_s=float(state.longest_unnoticed_s),
        nearest_m=nearest_m,
        false_alerts=int(state.false_alerts),
        sensors=sensor_set(scenario),
    )


def decision_part(state: np.record, scenario: Scenario) -> results.Decision:
    """Return the part of the verdict about docking's go. state: INTEGRITY_STATE at the end of a run.

    A mean NEES may be as large as that of a consistent filter whose errors stay the same for the whole run: a quantile
    of chi-square with as many degrees of freedom as it has states.
    """
    decision = state.decision
    counted = [mean <= limit for mean, limit in mean_nees(state, scenario.chaser.planar)]
    nees_ok = all(counted) if counted else None
    return results.Decision(
        passed=bool(decision.error == 0 and decision.beyond + decision.pending == 0 and nees_ok is not False),
        go_s=finite_or_none(decision.go_s),
        error=bool(decision.error),
        nees_ok=nees_ok,
        beyond_level_cycles=int(decision.beyond + decision.pending),
        error_over_level=float(decision.over_level),
    )


def mean_nees(state: np.record, planar: bool) -> list[tuple[float, float]]:
    """Return mean NEES and its limit of position and attitude filter, those that have one."""
    decision = state.decision
    means = decision.nees / np.maximum(decision.fused, 1)
    return [(float(mean), limit) for mean, limit, n in zip(means, _NEES_MAX[planar], decision.fused, strict=True) if n]


def sensor_set(scenario: Scenario) -> str:
    """Return "A" for vision unit, IMU and docking monitor, "B" without the docking monitor."""
    return "B" if scenario.monitor.source == "none" else "A"


def detection(state: np.record, k: int, fault: TimedFault, stop: SafeStop | None) -> dict[str, Any]:
    """Return when and by what fault number ``k`` was detected, and the reaction; None if nothing detected it.

    state: INTEGRITY_STATE. stop: of the run, if it ended with one.
    """
    detections: list[tuple[float, str]] = []
    reactions: list[tuple[float, str]] = []
    if not math.isnan(state.detected_s[k]):
        by = "monitor" if state.detected_health[k] == MONITOR_DISAGREES else "navigation"
        detections.append((float(state.detected_s[k]), by))
    if not math.isnan(state.reacted_s[k]):
        reactions.append((float(state.reacted_s[k]), REACTION_NAMES[int(state.reaction[k])]))
    if stop is not None and stop.t_s >= fault.at_s:
        detections.append((stop.t_s, stop.by))
        reactions.append((stop.t_s, SAFE_STOP))
    detected_s, by_whom = min(detections, default=(None, None))
    reaction_s, reaction = min(reactions, default=(None, None))
    return {"detected_s": detected_s, "detected_by": by_whom, "reaction": reaction, "reaction_s": reaction_s}
