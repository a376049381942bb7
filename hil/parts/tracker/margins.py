"""What the bench's own pose is worth against Table III: margins after the go, in standard deviations of the bench."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hil.config.scenario import Scenario
from hil.loop.outcome import Outcome
from hil.params.bench_budget import BenchSigma
from hil.params.ready import tolerances
from hil.report.summary import docking_go_s
from hil.report.verdict import deviations

LEAST_SIGMAS: Final = 3.0
"""Margin to Table III, in standard deviations of the bench, below which a run that meets it has no verdict."""
_FLOOR: Final = 1e-12  # m, deg, of a bench that is exact


def table_iii_margins(scenario: Scenario, worth: BenchSigma, outcome: Outcome) -> tuple[dict[str, Any], str]:
    """Return the standard deviations of the pose at the end of a run with the margins, and why there is no verdict.

    The margins are the least after the go; without one, in the last ``required_ready_s``.
    """
    history, requirements = outcome.history, scenario.requirements
    feedback = history[-1]["feedback"]
    sigma = worth(feedback["rail_m"].copy(), feedback["gimbal_rad"].copy())
    go_s, end_s = docking_go_s(outcome.events), float(history["t_s"][-1])
    since_s = max(0.0, end_s - requirements.required_ready_s) if go_s is None else go_s
    off, allowed = deviations(history[history["t_s"] >= since_s], requirements), tolerances(requirements)
    sigmas = {"position_m": sigma.sigma_m, "attitude_deg": sigma.sigma_deg}
    margins = {
        name: (allowed[name] - np.abs(getattr(off, name)).max(axis=0)) / np.maximum(each, _FLOOR)
        for name, each in sigmas.items()
    }
    least = float(min(each.min() for each in margins.values()))
    numbers: dict[str, Any] = {"sigma_m": sigma.sigma_m.tolist(), "sigma_deg": sigma.sigma_deg.tolist()}
    numbers |= {"since_s": since_s}
    numbers |= {f"margin_{name.partition('_')[0]}_sigmas": each.tolist() for name, each in margins.items()}
    if not 0.0 <= least < LEAST_SIGMAS:
        return numbers, ""
    return numbers, f"bench: Table III is met by {least:.1f} sigma of its own pose, required {LEAST_SIGMAS:g}"
