"""Verdicts of made-up rows and deviations."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Requirements, Scenario
from hil.core.messages import new
from hil.gnc import ready_phase
from hil.params.ready import ROW_NAMES, ready_params
from hil.report.bench_error import BenchErrorSums
from hil.report.verdict import Deviations, Verdict, verdict_of


def judge(found: Deviations, requirements: Requirements) -> Verdict:
    """Return the verdict on a run with the deviations ``found``."""
    return verdict_of(ready_state(found, requirements), requirements)


def ready_state(found: Deviations, requirements: Requirements) -> np.record:
    """Return READY_STATE at the end of a run with the deviations ``found``."""
    params, state = ready_params(requirements), new(ready_phase.READY_STATE)
    for t_s, row in zip(found.t_s, np.hstack([getattr(found, name) for name in ROW_NAMES]), strict=True):
        ready_phase.update(params, state, float(t_s), row.copy())
    return state


def bench_error(history: np.ndarray, scenario: Scenario, rig: Rig, settled_s: float = 0.0) -> dict[str, Any]:
    """Return the numbers of the bench's error over ``history`` (n,) of CYCLE."""
    found = BenchErrorSums(scenario, rig, settled_s)
    found.add(history)
    return found.rows()
