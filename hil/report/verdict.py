"""Ready phase and its verdict: bench paper Table III, judged on the truth, and the paper's own results (Table V).

The ready phase begins when every row of Table III has held for ``dwell_s`` without interruption, and lasts to the
end; the run passes if it lasts for ``required_ready_s`` and every row, each axis on its own, holds throughout.
``held_since_s`` is the start of that first uninterrupted dwell. (By continuity, the last quantity to enter its
tolerance is at the tolerance when it does: docs/explanation/papers.md.)

A run is accepted if it was completed, was not aborted, and passed all parts that its scenario requires
(``requirements.required_parts``): that verdict is printed last, the exit code reports it, and campaigns count it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hil.config.scenario import Requirements, Scenario
from hil.config.tables.model import Triple
from hil.config.tables.verdict import required_parts
from hil.core.messages import Array
from hil.gnc import ready_phase
from hil.loop.runner import COMPLETED
from hil.params.ready import ROW_NAMES, ready_params, tolerances
from hil.report.results import ControlPrecision, RunResults

_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class Deviations:
    """Truth against the ready state at each cycle, arrays (n, 3): m, m/s, deg, deg/s; ``t_s`` (n,)."""

    t_s: Array
    position_m: Array
    velocity_mps: Array
    attitude_deg: Array
    rate_degps: Array


@dataclass(frozen=True)
class Verdict:
    """ready_time_s, held_since_s: s, None if never. worst: row name -> largest |deviation| (3,), None if never.

    ready_duration_s: from ``ready_time_s`` to the end of the run or its abort, 0 if never.
    """

    ready_time_s: float | None
    held_since_s: float | None
    passed: bool
    worst: dict[str, Array] | None
    ready_duration_s: float = 0.0


def deviations(history: np.ndarray, requirements: Requirements) -> Deviations:
    """Return the deviations of the truth in ``history`` (n,) of CYCLE."""
    truth = history["truth"]
    array = np.empty((len(history), ready_phase.DEVIATIONS))
    r, v, q, w_c, w_h = (np.ascontiguousarray(truth[name]) for name in ("r_CT_H", "v_CT_H", "q_CH", "w_CI_C", "w_HI_H"))
    ready_phase.all_deviations(ready_params(requirements), r, v, q, w_c, w_h, array)
    return Deviations(history["t_s"], array[:, 0:3], array[:, 3:6], array[:, 6:9], array[:, 9:12])


def verdict_of(state: np.record, requirements: Requirements) -> Verdict:
    """Return the verdict of READY_STATE at the end of a run."""
    if not state.is_ready:
        return Verdict(None, None, False, None)
    worst = {name: state.worst[3 * row : 3 * row + 3].copy() for row, name in enumerate(ROW_NAMES)}
    duration_s = float(state.last_s - state.ready_s)
    passed = not state.left and duration_s >= requirements.required_ready_s - _ROUNDING_S
    return Verdict(float(state.ready_s), float(state.since_s), passed, worst, duration_s)


def control_precision(verdict: Verdict, scenario: Scenario) -> ControlPrecision:
    """Return Table III over the ready phase; margin: the least of 1 - deviation / tolerance, None if never ready."""
    allowed, worst = tolerances(scenario.requirements), verdict.worst
    margin = None if worst is None else min(float((1.0 - worst[n] / allowed[n]).min()) for n in ROW_NAMES)
    return ControlPrecision(
        passed=verdict.passed,
        ready_time_s=verdict.ready_time_s,
        ready_duration_s=verdict.ready_duration_s,
        required_ready_s=scenario.requirements.required_ready_s,
        margin=margin,
    )


@dataclass(frozen=True)
class ReadyPhase:
    """Largest deviations in the ready phase, absolute values, and the time at which it was reached (Table V)."""

    position_m: Triple
    velocity_mps: Triple
    attitude_deg: Triple
    rate_degps: Triple
    ready_time_s: float | None


TABLE_V = {
    "scheme-1": ReadyPhase(
        (0.0053, 0.0081, 0.0070), (0.0121, 0.0100, 0.0127), (0.1945, 0.0618, 0.0455), (0.0250, 0.0660, 0.0245), 162.0
    ),
    "scheme-2": ReadyPhase(
        (0.0064, 0.0093, 0.0111), (0.0128, 0.0094, 0.0182), (0.1881, 0.0583, 0.0317), (0.0284, 0.0701, 0.0371), 326.0
    ),
    "scheme-3": ReadyPhase(
        (0.0081, 0.0334, 0.0392), (0.0169, 0.0245, 0.0258), (0.2821, 0.2787, 0.0838), (0.0667, 0.2227, 0.0684), None
    ),
}
TABLE_V |= {f"{scheme}-paper": TABLE_V[scheme] for scheme in ("scheme-1", "scheme-2")}


def is_accepted(completed: bool, aborted: bool, parts: Mapping[str, bool], requirements: Requirements) -> bool:
    """Return whether a run is accepted; parts: whether each was passed. A required part that was not judged fails."""
    required = required_parts(requirements.required_parts, parts)
    return completed and not aborted and bool(required) and all(parts.get(name, False) for name in required)


def acceptance(results: RunResults, requirements: Requirements) -> tuple[bool, list[str]]:
    """Return ``accepted`` and ``required_parts``; results: with ``stop`` and the parts of the verdict."""
    parts = {name: bool(part.passed) for name, part in results.parts().items()}
    security = getattr(results.verdict, "security", None)
    aborted = security is not None and security.abort is not None
    accepted = is_accepted(results.stop == COMPLETED, aborted, parts, requirements)
    return accepted, required_parts(requirements.required_parts, parts)
