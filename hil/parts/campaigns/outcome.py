"""A case's outcome as a row of numbers, under the names that docs/reference/columns.md lists."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.config.scenario import Scenario
from hil.config.tables.verdict import PART_COLUMNS
from hil.core.alarms import Alarm
from hil.core.messages import Array
from hil.gnc.decision_verdict import ACCUSED
from hil.gnc.limits import CLOSING, CORRIDOR
from hil.gnc_backends.approach_events import ABORT_CAUSES
from hil.loop.compiled.run_cycles import COMPLETED as COMPLETED_CODE
from hil.loop.compiled.run_stats import SETTLED
from hil.loop.runner import COMPLETED
from hil.maths import linear
from hil.maths.limits import finite_or_none
from hil.params.ready import ROW_NAMES
from hil.report.integrity import SafeStop, decision_part, detection, integrity_part
from hil.report.limits import (
    LIMITS,
    RunNumbers,
    Stop,
    alarms_before,
    first_violated,
    margins_of,
    stop_of_alarm,
)
from hil.report.results import Energy
from hil.report.verdict import control_precision, is_accepted, verdict_of
from hil.report.verdict_parts import energy_part, navigation_means, propellant_kg, security_part
from hil.safety.motion_guards import is_of_guard

_AXES: Final = ("x", "y", "z")
_TRIPLES: Final = (
    *ROW_NAMES, "force_on_time_s", "torque_on_time_s", "position_rmse_m", "velocity_rmse_mps", "attitude_rmse_deg",
)  # fmt: skip
_SINGLE: Final = (
    "ready_time_s", "held_since_s", "control_margin", "corridor_margin_m", "closing_margin_mps", "nearest_m",
    "aborted_at_s", "hmi_cycles", "worst_error_m", "alert_limit_m", "protection_level_m", "availability",
    "time_to_alert_s", "view_margin_px", "propellant_kg", "propellant_share", "propellant_over_bound",
    "thruster_on_time_s", "nees_pkf", "nees_akf", "go_s", "propellant_limit_kg", "error_over_level",
    "first_violated_s", "first_violated_value", "first_violated_limit",
)  # fmt: skip
_TEXTS_OF_FAULT: Final = ("fault_device", "fault_kind", "detected_by", "reaction")
_OF_FAULT: Final = ("fault_at_s", "fault_size", "detected_s", "reaction_s")
FLAGS: Final = (
    "accepted", *dict.fromkeys(("passed", "passed_all_parts", *PART_COLUMNS.values())), "decision_error", "nees_ok",
)  # fmt: skip
"""Columns of the verdict: the whole one first, then those of its parts."""
COUNTS: Final = (
    "firings", "limited_cycles", "cycles", "false_alerts", "beyond_level_cycles",
    *(f"false_alarm_{name}" for name in ACCUSED),
)  # fmt: skip
_TERM_COLUMNS: Final = tuple(f"margin_{name}_term" for name in LIMITS)
TEXTS: Final = (
    "stop", "abort", *_TEXTS_OF_FAULT, "first_violated", "first_violated_term", "first_violated_phase", "alarms_before",
    *_TERM_COLUMNS,
)  # fmt: skip
NUMBERS: Final = (*_SINGLE, *_OF_FAULT, *(f"{name}_{axis}" for name in _TRIPLES for axis in _AXES))
"""Columns with floats; null where a run did not get far enough."""
MARGINS: Final = tuple(f"margin_{name}{what}" for name in LIMITS for what in ("", "_s", "_value", "_limit"))
"""Columns with the least margin to each limit, its time, value and limit there; null where a limit does not act."""
NUMERIC: Final = (*NUMBERS, *COUNTS, *FLAGS)
"""Columns that can be compared with a limit."""


def row_of(
    stats: np.record, stop: str, scenario: Scenario, truth: Scenario, alarm: Alarm | None = None
) -> dict[str, Any]:
    """Return the outcome of a run by the names of FLAGS, COUNTS, TEXTS, NUMBERS and MARGINS.

    scenario: as the GNC has it, with the requirements; truth: as it was flown. alarm: that ended the run, if it has
    numbers.
    """
    ended = None if stop == COMPLETED else stop_of_alarm(alarm, stop, int(stats.cycles) * scenario.step_s)
    verdict = verdict_of(stats.ready, scenario.requirements)
    integrity, decision = integrity_part(stats.integrity, scenario), decision_part(stats.integrity, scenario)
    limits = stats.integrity.limits
    aborted = int(limits.aborted)
    used_kg = propellant_kg(stats, truth)
    energy, security = energy_part(stats, scenario, used_kg), security_part(stats)
    flown, view_px = int(stats.cycles) > 0, _view_margin(stats, scenario)
    passed = bool(verdict.passed and stop == COMPLETED and not aborted)
    parts = {
        "control_precision": passed,
        "security": security.passed,
        "energy": energy.passed,
        "field_of_view": bool(flown and view_px >= 0.0),
        "integrity": bool(flown and integrity.passed),
        "decision": bool(flown and decision.passed),
    }
    row: dict[str, Any] = {
        "passed": passed,
        "passed_all_parts": all(parts.values()),
        **{column: parts[name] for name, column in PART_COLUMNS.items()},
        "accepted": is_accepted(stop == COMPLETED, bool(aborted), parts, scenario.requirements),
        "false_alerts": integrity.false_alerts,
        "decision_error": decision.error,
        "nees_ok": decision.nees_ok,
        "go_s": decision.go_s,
        "beyond_level_cycles": decision.beyond_level_cycles,
        "error_over_level": decision.error_over_level,
        **{f"false_alarm_{name}": int(n) for name, n in zip(ACCUSED, stats.integrity.decision.false, strict=True)},
        "propellant_limit_kg": energy.factor * energy.least_propellant_kg,
        "hmi_cycles": integrity.hmi_cycles,
        "worst_error_m": integrity.worst_error_m,
        "alert_limit_m": integrity.alert_limit_m,
        "protection_level_m": finite_or_none(stats.integrity.worst_bound),
        "availability": integrity.availability,
        "time_to_alert_s": integrity.time_to_alert_s,
        "firings": energy.firings,
        "limited_cycles": int(stats.limited_cycles),
        "cycles": int(stats.cycles),
        "stop": stop,
        "abort": ABORT_CAUSES[aborted],
        "ready_time_s": verdict.ready_time_s,
        "held_since_s": verdict.held_since_s,
        "aborted_at_s": float(limits.aborted_at_s) if aborted else None,
        "propellant_kg": used_kg,
        "propellant_share": used_kg / energy.least_propellant_kg if energy.least_propellant_kg else None,
        "propellant_over_bound": used_kg / energy.impulsive_bound_kg if energy.impulsive_bound_kg else None,
        "thruster_on_time_s": scenario.step_s * float(np.sum(stats.thruster_open)),
        "control_margin": control_precision(verdict, scenario).margin,
        **{
            name: finite_or_none(value) if flown else None
            for name, value in (
                ("corridor_margin_m", limits.margin[CORRIDOR]),
                ("closing_margin_mps", limits.margin[CLOSING]),
                ("view_margin_px", view_px),
                ("nearest_m", stats.integrity.nearest),
            )
        },
        **_three("force_on_time_s", scenario.step_s * stats.force_cycles),
        **_three("torque_on_time_s", scenario.step_s * stats.torque_cycles),
        **_navigation(stats),
        **_fault(truth, stats),
    }
    for name in ROW_NAMES:
        row |= _three(name, np.full(3, np.nan) if verdict.worst is None else verdict.worst[name])
    return row | _limits(stats, parts, energy, row["accepted"], ended, scenario)


def _view_margin(stats: np.record, scenario: Scenario) -> float:
    """Return the least margin of the LEDs to an image's edge, px; infinite if no LED has to be in view."""
    return float(stats.view_margin) if scenario.vmu.errors.needs_view else math.inf


def _limits(
    stats: np.record,
    parts: dict[str, bool],
    energy: Energy,
    accepted: bool,
    ended: Stop | None,
    scenario: Scenario,
) -> dict[str, Any]:
    """Return the first violated limit, the alarms before it and the margins to all limits."""
    view = tuple(
        finite_or_none(value) for value in (_view_margin(stats, scenario), stats.view_margin_s, stats.view_lost_s)
    )
    end_s = max(0, int(stats.cycles) - 1) * scenario.step_s
    run = RunNumbers(stats, parts, (view[0], view[1], view[2]), energy, end_s, accepted, ended)
    margins = margins_of(run, scenario) if stats.cycles else []
    reason = first_violated(run, scenario, margins)
    columns = reason | {"alarms_before": alarms_before(stats.integrity.limits, reason["first_violated_s"])}
    columns |= dict.fromkeys(MARGINS) | dict.fromkeys(_TERM_COLUMNS, "")
    for each in margins:
        if each.name in LIMITS:
            at = f"margin_{each.name}"
            columns |= {at: finite_or_none(each.margin), f"{at}_s": each.at_s, f"{at}_value": each.value}
            columns |= {f"{at}_limit": each.limit, f"{at}_term": each.term}
    return columns


def failed_row(reason: str) -> dict[str, Any]:
    """Return the outcome of a case that could not be flown at all."""
    row: dict[str, Any] = dict.fromkeys((*NUMBERS, *MARGINS))
    row |= dict.fromkeys(FLAGS, False) | dict.fromkeys(COUNTS, 0)
    return row | dict.fromkeys(TEXTS, "") | {"stop": reason}


def _navigation(stats: np.record) -> dict[str, float | None]:
    means = navigation_means(stats.navigation, SETTLED)
    triples = {
        name: means[name] or [None] * 3 for name in ("position_rmse_m", "velocity_rmse_mps", "attitude_rmse_deg")
    }
    return {
        **{f"{name}_{axis}": value for name, of in triples.items() for axis, value in zip(_AXES, of, strict=True)},
        "nees_pkf": means["nees_pkf"],
        "nees_akf": means["nees_akf"],
    }


def _fault(truth: Scenario, stats: np.record) -> dict[str, Any]:
    """Return the last fault of a run, the one that a campaign draws; its size is the magnitude of its value."""
    if not truth.faults:
        return dict.fromkeys(_OF_FAULT) | dict.fromkeys(_TEXTS_OF_FAULT, "")
    fault, stop = truth.faults[-1], None
    if stats.ended != COMPLETED_CODE:
        by = "guard" if is_of_guard(int(stats.ended)) else "device"
        stop = SafeStop(int(stats.cycles) * truth.step_s, by)
    detected = detection(stats.integrity, len(truth.faults) - 1, fault, stop)
    return {
        **{name: value or "" if name in _TEXTS_OF_FAULT else value for name, value in detected.items()},
        "fault_device": fault.device,
        "fault_kind": fault.kind,
        "fault_at_s": fault.at_s,
        "fault_size": linear.length(fault.values) if fault.values else None,
    }


def _three(name: str, values: Array) -> dict[str, float | None]:
    return {f"{name}_{axis}": finite_or_none(value) for axis, value in zip(_AXES, values, strict=True)}
