"""Limits of a run: the least margin to each, and the one that was broken first, which is the cause of a failure.

The margins are those that ``hil.gnc.limits`` and the ready phase record, and those of the parts of the verdict. A limit
of a part that the scenario does not require is no cause, and an accepted run has none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from hil.config.rig import BENCH_AXES
from hil.config.scenario import Scenario
from hil.config.tables.verdict import PART_COLUMNS, required_parts
from hil.core.alarm_table import ALARMS
from hil.core.alarms import Alarm, slug
from hil.core.gnc_records import GncHealth
from hil.gnc.approach_monitor import (
    BENCH_DISAGREES,
    CAUSE_UNKNOWN,
    FIRST_BITS,
    FIRST_HEALTH_CAUSE,
    HELD_TOO_LONG,
    ORDERED,
    SENSOR_SUSPECT,
)
from hil.gnc.ready_phase import DEVIATIONS
from hil.maths.limits import finite_or_none
from hil.params.ready import all_tolerances
from hil.report.integrity import mean_nees
from hil.report.results import Energy

_DIRECTIONS: Final = ("along", "across", "attitude")
_SHORT_AXES: Final = tuple(name.split(".")[-1] for name in BENCH_AXES)
_OF_KERNEL: Final = (
    "corridor", "closing_rate", *(f"level_{d}" for d in _DIRECTIONS), *(f"error_{d}" for d in _DIRECTIONS),
    "corridor_of_estimate", "closing_rate_of_estimate", "pose_age", *(f"tracking_{axis}" for axis in _SHORT_AXES),
)  # fmt: skip
_OF_READY: Final = tuple(f"{row}_{axis}" for row in ("deviation", "velocity", "attitude", "rate") for axis in "xyz")
LIMITS: Final = (*_OF_KERNEL, *_OF_READY, "keep_out", "field_of_view", "propellant")
"""Limits with a margin in each run, by their names in JSON and columns."""
TERMS: Final = (
    "", "noise", "undetected fault of the poses", "age of the last pose", "reopened gate", "second sensor",
    "navigation error", "control error", "protection level",
)  # fmt: skip
_HEALTH: Final = tuple(bit.name.lower() for bit in GncHealth if bit.value)
_CAUSES: Final = {
    ORDERED: "ordered_abort",
    HELD_TOO_LONG: "hold_time",
    BENCH_DISAGREES: "bench_disagrees",
    SENSOR_SUSPECT: "sensor_suspect",
    CAUSE_UNKNOWN: "cause_unknown",
} | {FIRST_HEALTH_CAUSE + k: name for k, name in enumerate(_HEALTH[:FIRST_BITS])}
_PARTS: Final = (
    dict.fromkeys(("corridor", "closing_rate"), "security")
    | dict.fromkeys((*(f"error_{d}" for d in _DIRECTIONS), "keep_out"), "integrity")
    | dict.fromkeys((*_OF_READY, "ready_time"), "control_precision")
    | {"field_of_view": "field_of_view", "propellant": "energy"}
    | dict.fromkeys(("decision", "error_beyond_level", "nees_position", "nees_attitude"), "decision")
)
"""Limit -> part of the verdict that it belongs to. The others end or abort the approach."""
_WORDS: Final = {
    "corridor": "distance from the line of the approach", "closing_rate": "closing rate",
    "corridor_of_estimate": "estimated distance from the line with its protection level",
    "closing_rate_of_estimate": "estimated closing rate with its uncertainty",
    "start_corridor": "distance of the start from the corridor", "pose_age": "age of the last pose",
    "keep_out": "distance to the target", "propellant": "propellant",
    "field_of_view": "margin of the LEDs to the image's edge", "hold_time": "duration of a hold",
    "ready_time": "duration of the ready phase",
    "decision": "deviation after docking: go", "error_beyond_level": "navigation error",
    "lost_periods_of_loop": "number of lost periods",
    "nees_position": "NEES of the position filter", "nees_attitude": "NEES of the attitude filter",
}  # fmt: skip
_SMALLER: Final = {"m": "mm", "m/s": "mm/s", "kg": "g"}
"""Unit -> its thousandth."""
_LEAST_VALUES: Final = frozenset(("ready_time", "keep_out", "field_of_view"))
"""Limits that are a least value."""
_ROW_WORDS: Final = {"deviation": "deviation", "velocity": "velocity", "attitude": "angle", "rate": "angular rate"}
_FIRST: Final = ("first_violated", "first_violated_s", "first_violated_value", "first_violated_limit",
                 "first_violated_term", "first_violated_phase")  # fmt: skip


def words_of(name: str) -> str:
    """Return the limit ``name`` as a phrase."""
    if name in _WORDS:
        return _WORDS[name]
    what, _, axis = name.rpartition("_")
    if what == "lost_packets_of":
        return f"number of lost packets of {axis}"
    if what in _ROW_WORDS:
        beside = "" if axis == "across" else f" ({axis})"
        where = "along the docking axis" if axis == "x" else f"across the docking axis{beside}"
        return f"{_ROW_WORDS[what]} {where if what in ('deviation', 'velocity') else f'about {axis}'}"
    if what == "level":
        return f"protection level {'of the attitude' if axis == 'attitude' else f'{axis} the docking axis'}"
    if what == "error":
        return f"navigation error {'of the attitude' if axis == 'attitude' else f'{axis} the docking axis'}"
    if what == "tracking":
        return f"following error of {axis}"
    return name.replace("_", " ")


def bound(name: str) -> str:
    """Return what the limit ``name`` is, before its number: a least value is required, a largest one allowed."""
    return "required" if name in _LEAST_VALUES else "allowed"


def unit_of(name: str) -> str:
    """Return the SI unit of the limit ``name``, "" for a number without one."""
    what, _, axis = name.rpartition("_")
    if what.endswith("_of") and name not in LIMITS:
        kind = ALARMS.get(what.removesuffix("_of"))
        return kind.unit_of(axis in ("turntable", *_SHORT_AXES[3:])) if kind else ""
    if name in ("pose_age", "hold_time", "ready_time"):
        return "s"
    if what == "closing_rate" or name.startswith("closing_rate"):
        return "m/s"
    if what in _ROW_WORDS and axis in ("x", "y", "z", "across"):
        return {"deviation": "m", "velocity": "m/s", "attitude": "deg", "rate": "deg/s"}[what]
    if name in ("propellant", "field_of_view"):
        return {"propellant": "kg", "field_of_view": "px"}[name]
    if axis in ("attitude", *_SHORT_AXES[3:]):
        return "rad"
    is_length = name in (*LIMITS, "start_corridor") or name.startswith(("travel_", "error_beyond"))
    return "m" if is_length else ""


@dataclass(frozen=True)
class Margin:
    """Least margin to a limit: limit minus value, or value minus limit where the limit is a least value.

    at_s: its time. broken_s: first time at which the limit counts as broken, None for never, with value and limit then.
    """

    name: str
    margin: float
    at_s: float | None
    value: float | None
    limit: float | None
    term: str = ""
    broken_s: float | None = None
    broken_value: float | None = None
    broken_limit: float | None = None
    broken_term: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the margin by the keys of the JSON."""
        return {
            "margin": finite_or_none(self.margin),
            "at_s": self.at_s,
            "value": self.value,
            "limit": self.limit,
            "term": self.term or None,
            "unit": unit_of(self.name),
            "violated_s": self.broken_s,
        }


@dataclass(frozen=True)
class Stop:
    """Limit that ended a run with a safe stop at ``t_s``; value and limit in SI, None if they are no numbers."""

    name: str
    t_s: float
    value: float | None = None
    limit: float | None = None


@dataclass(frozen=True)
class RunNumbers:
    """What the limits of a run are made of.

    stats: RUN_STATS at the end. parts: whether each part of the verdict was passed. view: least margin, px, its time,
    and when it was first negative. energy: the part of the verdict. end_s: of the run. measured: what loop and links
    have lost, ``Outcome.measured["limits"]``.
    """

    stats: np.record
    parts: Mapping[str, bool]
    view: tuple[float | None, float | None, float | None]
    energy: Energy
    end_s: float
    accepted: bool
    stop: Stop | None = None
    measured: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def margins_of(run: RunNumbers, scenario: Scenario) -> list[Margin]:
    """Return the margins to all limits that act."""
    of_vehicle = [*_kernel_margins(run.stats.integrity.limits), *_ready_margins(run, scenario)]
    return [*of_vehicle, *_part_margins(run, scenario), *(_measured(*each, run.end_s) for each in run.measured.items())]


def _measured(name: str, recorded: Mapping[str, Any], end_s: float) -> Margin:
    """Return the margin to a limit of losses, which counts as broken above it, at ``end_s`` if that ended the run."""
    value, limit = recorded["value"], recorded["limit"]
    at_s, broken_s = recorded.get("at_s"), recorded.get("broken_s")
    broken = () if broken_s is None else (min(broken_s, end_s), recorded["broken_value"], limit)
    return Margin(name, limit - value, at_s, value, limit, "", *broken)


def _kernel_margins(state: np.record) -> list[Margin]:
    margins = []
    for k, name in enumerate(_OF_KERNEL):
        is_broken = not math.isnan(state.broken_s[k])
        if not math.isfinite(state.margin[k]) and not is_broken:
            continue
        value, limit = finite_or_none(state.value[k]), finite_or_none(state.limit[k])
        margin = Margin(name, float(state.margin[k]), float(state.at_s[k]), value, limit, TERMS[int(state.term[k])])
        if is_broken:
            margin = replace(
                margin,
                broken_s=float(state.broken_s[k]),
                broken_value=finite_or_none(state.broken_value[k]),
                broken_limit=finite_or_none(state.broken_limit[k]),
                broken_term=TERMS[int(state.broken_term[k])],
            )
        margins.append(margin)
    return margins


def _ready_margins(run: RunNumbers, scenario: Scenario) -> list[Margin]:
    """Return the margins to Table III: in the ready phase, or of what has kept it from beginning.

    What ends the run before it, a stop, an abort or a hold for a fault, is not the deviation that was left then.
    """
    ready, rows = run.stats.ready, []
    state = run.stats.integrity.limits
    ended = not ready.is_ready and (run.stop is not None or bool(state.aborted or _held_for(state)))
    allowed = all_tolerances(scenario.requirements)
    late = bool(ready.is_ready) and not ready.left and not run.parts.get("control_precision", False)
    blocking = -1 if ended or (ready.is_ready and not (late and ready.breaks.any())) else _blocking(ready)
    for i in range(DEVIATIONS):
        limit = float(allowed[i])
        broken: tuple[float, float, float] | None = None
        if ready.is_ready:
            value, at_s = float(ready.worst[i]), float(ready.worst_s[i])
            if ready.left and ready.left_by == i:
                broken = (float(ready.left_s), float(ready.left_value), limit)
        elif ready.breaks[i]:
            value, at_s = float(ready.break_value[i]), float(ready.break_s[i])
        else:
            continue
        if i == blocking:
            at = float(ready.break_s[i]) if ready.breaks[i] else at_s
            broken = (at, float(ready.break_value[i]) if ready.breaks[i] else value, limit)
        rows.append(Margin(_OF_READY[i], limit - value, at_s, finite_or_none(value), limit, "", *(broken or ())))
    if not ready.is_ready and not ended and not ready.breaks[blocking]:
        limit, value, at_s = float(allowed[blocking]), math.nan, run.end_s
        if ready.out[blocking]:
            value, at_s = float(ready.out_value[blocking]), float(ready.out_s[blocking])
        shown, name = finite_or_none(value), _OF_READY[blocking]
        rows.append(Margin(name, limit - value, at_s, shown, limit, "", at_s, shown, limit))
    if late and not ready.breaks.any():
        lasted, least = float(ready.last_s - ready.ready_s), scenario.requirements.required_ready_s
        rows.append(Margin("ready_time", lasted - least, run.end_s, lasted, least, "", run.end_s, lasted, least))
    return rows


def _blocking(ready: np.record) -> int:
    """Return the deviation that kept the ready phase from beginning: what ended most dwells, or was out most."""
    counts = ready.breaks if ready.breaks.any() else ready.out
    return int(np.argmax(counts)) if counts.any() else 0


def _part_margins(run: RunNumbers, scenario: Scenario) -> list[Margin]:
    integrity, rows = run.stats.integrity, []
    nearest, keep_out = float(integrity.nearest), scenario.keep_out.radius_m
    if math.isfinite(nearest):
        broken = (float(integrity.nearest_s), nearest, keep_out) if nearest < keep_out else ()
        rows.append(Margin("keep_out", nearest - keep_out, float(integrity.nearest_s), nearest, keep_out, "", *broken))
    margin, at_s, lost_s = run.view
    if margin is not None:
        lost = (lost_s, margin, 0.0) if margin < 0.0 else ()
        rows.append(Margin("field_of_view", margin, at_s, margin, 0.0, "", *lost))
    used, allowed = run.energy.propellant_kg, run.energy.factor * run.energy.least_propellant_kg
    spent = (run.end_s, used, allowed) if used > allowed else ()
    rows.append(Margin("propellant", allowed - used, run.end_s, used, allowed, "", *spent))
    decision = integrity.decision
    if decision.error:
        k = int(decision.error_by)
        limit = float(all_tolerances(scenario.requirements)[k])
        value = float(decision.error_value)
        rows.append(
            Margin("decision", limit - value, float(decision.error_s), value, limit, "", float(decision.error_s), value,
                   limit)
        )  # fmt: skip
    if decision.beyond + decision.pending > 0:
        since = float(decision.beyond_s if decision.beyond else decision.pending_s)
        rows.append(Margin("error_beyond_level", math.nan, since, None, None, "", since))
    means = mean_nees(integrity, scenario.chaser.planar)
    for name, (mean, limit) in zip(("nees_position", "nees_attitude"), means, strict=False):
        if not mean <= limit:
            rows.append(Margin(name, limit - mean, run.end_s, finite_or_none(mean), limit, "", run.end_s, mean, limit))
    return rows


def _held_for(state: np.record) -> str:
    """Return the health bit for which the hold or retreat began that ended the approach, "" for none."""
    bits = 0 if math.isnan(state.held_s) else int(state.held_health)
    return next((name for k, name in enumerate(_HEALTH) if bits >> k & 1), "")


def _ended(run: RunNumbers) -> list[Margin]:
    """Return what ended the approach: the cause of hold or abort, the stop, a part that was not passed for no limit."""
    state, events = run.stats.integrity.limits, []
    cause = int(state.aborted)
    name = _CAUSES.get(cause)
    if name is not None:
        events.append(_event(name, float(state.aborted_at_s)))
    if held_for := _held_for(state):
        events.append(_event(held_for, float(state.held_s)))
    if run.stop is not None:
        events.append(_event(run.stop.name, run.stop.t_s, run.stop.value, run.stop.limit))
    return events


def _event(name: str, t_s: float, value: float | None = None, limit: float | None = None) -> Margin:
    return Margin(name, math.nan, t_s, value, limit, "", t_s, value, limit)


def first_violated(run: RunNumbers, scenario: Scenario, margins: Sequence[Margin]) -> dict[str, Any]:
    """Return the first violated limit by the names of the columns, None and "" if the run is accepted."""
    first = None if run.accepted else _first(run, scenario, margins)
    if first is None:
        return dict(zip(_FIRST, ("", None, None, None, "", ""), strict=True))
    phase = phase_at(run.stats.integrity.limits, scenario, first.broken_s)
    values = (first.name, first.broken_s, first.broken_value, first.broken_limit, first.broken_term, phase)
    return dict(zip(_FIRST, values, strict=True))


def _first(run: RunNumbers, scenario: Scenario, margins: Sequence[Margin]) -> Margin | None:
    """Return the margin of the cause: the first broken limit, or of simultaneous ones the first in LIMITS."""
    required = required_parts(scenario.requirements.required_parts, run.parts)
    missed = {part for part in required if not run.parts.get(part, False)}
    state = run.stats.integrity.limits
    ended = bool(state.aborted) or run.stop is not None or not state.entered or "security" in missed
    if state.counted and state.start_margin < 0.0 and ended:
        start = float(state.start_margin)
        return Margin("start_corridor", start, 0.0, None, None, "", 0.0, -start, 0.0)
    broken = [
        each
        for each in (*margins, *_ended(run))
        if each.broken_s is not None and (each.name not in _PARTS or _PARTS[each.name] in missed)
    ]
    if broken:
        return min(broken, key=lambda each: each.broken_s or 0.0)
    part = next((part for part in PART_COLUMNS if part in missed), "")
    return _event(part, run.end_s) if part else None


def phase_at(state: np.record, scenario: Scenario, t_s: float | None) -> str:
    """Return the name of the phase at ``t_s``, "" before the first. state: LIMITS_STATE."""
    names = (*scenario.gnc.guidance.sequence, "brake", "retreat", "hold of the abort")
    begun = state.phase_s[: len(names)]
    before = np.flatnonzero(begun < (math.inf if t_s is None else max(t_s, 1e-9)))
    return names[before[np.argmax(begun[before])]] if len(before) else ""


def alarms_before(state: np.record, t_s: float | None) -> str:
    """Return the health bits that were set up to ``t_s`` in their order, with their times; "" for none."""
    rows = sorted((float(at_s), name) for name, at_s in zip(_HEALTH, state.health_s, strict=True) if at_s == at_s)
    return "; ".join(f"{name} {at_s:.2f} s" for at_s, name in rows if t_s is None or at_s <= t_s)


def sentence(case: Mapping[str, Any]) -> str:
    """Return the first violated limit of ``case``, by the names of the columns, as a sentence; "" without one."""
    name = case["first_violated"]
    if not name:
        return ""
    text = f"the {words_of(name)}"
    value, limit, unit = case["first_violated_value"], case["first_violated_limit"], unit_of(name)
    if value is not None and limit is not None:
        text += f" is {shown(value, unit)}, {bound(name)} {shown(limit, unit)}"
    else:
        text += " is beyond what is allowed" if name in _PARTS else " ends the approach"
    if case["first_violated_s"] is not None:
        text += f", at {case['first_violated_s']:.2f} s"
    if case["first_violated_phase"]:
        text += f" in phase {case['first_violated_phase']}"
    return f"{text}, most of it {case['first_violated_term']}" if case["first_violated_term"] else text


def why_of(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the cause of a run with its margins, those that are least relative to their limit first.

    summary: numbers of the run, by the keys of its JSON.
    """
    rows = [
        {"limit": name, "margin": each["margin"], "value": each["value"], "allowed": each["limit"],
         **{key: each[key] for key in ("at_s", "term", "unit")}}
        for name, each in summary["limits"].items()
    ]  # fmt: skip
    return {
        "accepted": bool(summary["accepted"]),
        "text": sentence(summary) or "accepted: no limit was broken",
        "first_violated": {name.removeprefix("first_violated"): summary[name] for name in _FIRST},
        "alarms_before": summary["alarms_before"],
        "stop": summary["stop"],
        "limits": sorted(rows, key=relative_margin),
    }


def relative_margin(row: Mapping[str, Any]) -> float:
    """Return the margin of ``row`` over its limit, -inf if it is unknown."""
    if row["margin"] is None:
        return -math.inf
    margin, limit = float(row["margin"]), row["allowed"]
    return margin / abs(limit) if limit else margin


def shown(value: float, unit: str) -> str:
    """Return ``value`` with its unit, angles in degrees, a small length, speed or mass in mm, mm/s or g."""
    if unit.startswith("rad"):
        value, unit = math.degrees(value), unit.replace("rad", "deg")
    if unit in _SMALLER and 0.0 < abs(value) < 0.1:
        value, unit = 1e3 * value, _SMALLER[unit]
    return f"{value:.4g} {unit}".rstrip()


def stop_of_alarm(alarm: Alarm | None, stop: str, t_s: float) -> Stop:
    """Return the limit of the alarm that ended a run; without one that of its text ``stop``."""
    if alarm is None:
        return Stop(slug(stop.split(":")[0].strip()).replace(".", "_") or "stop", t_s)
    quantity = alarm.code if "," in alarm.quantity and alarm.code else slug(alarm.quantity.split(",")[0])
    return Stop(f"{quantity}_of_{alarm.device.split('.')[-1]}", t_s, alarm.measured, alarm.allowed)
