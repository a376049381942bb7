"""Evidence for probabilistic requirements from the cases of a campaign, by order statistics.

A case that ends without the outcome counts as a failure.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import ProbabilisticRequirement, Scenario
from hil.core.messages import Array
from hil.errors import Problem
from hil.maths.order_statistics import acceptance_risk, allowed_failures, cases_needed
from hil.monte_carlo.outcome import NUMERIC
from hil.monte_carlo.store import Store
from hil.params.ready import ROW_NAMES

VERIFIED, NOT_VERIFIED, TOO_FEW = "verified", "not verified", "too few cases"
THREE_SIGMA: Final = 0.9973
CONFIDENCE_OF_BOUNDS: Final = 0.9
_BOUNDED: Final = (*(f"{row}_{axis}" for row in ROW_NAMES for axis in "xyz"), "propellant_kg", "ready_time_s")


def check_requirements(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for each requirement whose column no campaign has."""
    key = "requirements.probabilistic"
    return [
        Problem(scenario.where(key), f"{key}[{i}].column", f'"{each.column}": give one of {", ".join(NUMERIC)}')
        for i, each in enumerate(scenario.value.requirements.probabilistic)
        if each.column not in NUMERIC
    ]


def judge_requirements(store: Store, scenario: Scenario) -> list[dict[str, Any]]:
    """Return the result of each probabilistic requirement, by the keys of ``summary.json``."""
    return [
        judge_requirement(each, np.asarray(store.column(each.column), dtype=float))
        for each in scenario.requirements.probabilistic
    ]


def judge_requirement(requirement: ProbabilisticRequirement, values: Array) -> dict[str, Any]:
    """Return the result of a requirement; values: outcomes of the cases, nan without one."""
    n, probability, risk = len(values), requirement.probability, requirement.consumer_risk
    failures = n - int(np.count_nonzero(requirement.sign * (values - requirement.limit) <= 0.0))
    allowed = allowed_failures(n, probability, risk)
    bound = tolerance_bound(values, requirement.sign, probability, risk)
    verdict = TOO_FEW if allowed < 0 else VERIFIED if failures <= allowed else NOT_VERIFIED
    return {
        "id": requirement.id,
        "text": requirement.text,
        "column": requirement.column,
        "limit": requirement.limit,
        "side": "at most" if requirement.sign > 0.0 else "at least",
        "probability": probability,
        "consumer_risk": risk,
        "cases": n,
        "failures": failures,
        "allowed_failures": max(0, allowed),
        "cases_needed": cases_needed(failures, probability, risk),
        "risk": acceptance_risk(n, failures, probability),
        "bound": bound,
        "margin": None if bound is None else requirement.sign * (requirement.limit - bound) + 0.0,  # never -0
        "verdict": verdict,
    }


def tolerance_bound(values: Array, sign: float, probability: float, risk: float) -> float | None:
    """Return the value that a fraction ``probability`` of all cases does not exceed, wrong with probability ``risk``.

    sign: 1 for an upper bound, -1 for a lower one. None if the cases are too few, or too many have no value.
    """
    allowed = allowed_failures(len(values), probability, risk)
    if allowed < 0:
        return None
    worst_first = np.sort(-sign * np.where(np.isfinite(values), values, sign * np.inf))
    bound = float(-sign * worst_first[allowed])
    return bound if np.isfinite(bound) else None


def tolerance_bounds(store: Store) -> dict[str, Any]:
    """Return the upper tolerance bounds of the main outcomes: 99.73 % of all cases with a confidence of 90 %."""
    risk = 1.0 - CONFIDENCE_OF_BOUNDS
    return {
        "probability": THREE_SIGMA,
        "confidence": CONFIDENCE_OF_BOUNDS,
        "cases_needed": cases_needed(0, THREE_SIGMA, risk),
        "upper": {
            name: tolerance_bound(np.asarray(store.column(name), dtype=float), 1.0, THREE_SIGMA, risk)
            for name in _BOUNDED
        },
    }
