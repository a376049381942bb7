"""Statistics of a finished campaign: pass rates with intervals, worst cases, margins, probabilistic requirements.

Requirements are judged by order statistics; a case that ends without the outcome counts as a failure.
"""

from __future__ import annotations

import math
from typing import Any, Final, Protocol

import numpy as np
import scipy  # its parts are imported when they are used

from hil.config.load import Loaded
from hil.config.scenario import ProbabilisticRequirement, Scenario
from hil.core.messages import Array
from hil.errors import Problem
from hil.loop.runner import COMPLETED
from hil.maths.order_statistics import acceptance_risk, allowed_failures, cases_needed
from hil.params.ready import ROW_NAMES
from hil.parts.campaigns.outcome import FLAGS, NUMERIC
from hil.parts.campaigns.store import Store
from hil.report.verdict import TABLE_V

CONFIDENCE: Final = 0.95
PERCENTILES: Final = (5.0, 50.0, 95.0, 99.0)
SPREAD_OF: Final = (
    "ready_time_s", "control_margin", "propellant_kg", "firings", "corridor_margin_m", "closing_margin_mps",
    "nearest_m", "view_margin_px",
)  # fmt: skip
_REASONS: Final = 20


class HasColumns(Protocol):
    """Cases of a finished campaign."""

    def column(self, name: str) -> Any:
        """Return one column, (n,); missing numbers are nan."""


def wilson(passed: int, runs: int) -> dict[str, float | int]:
    """Return the fraction ``passed`` / ``runs`` with Wilson's interval of ``CONFIDENCE``."""
    interval = scipy.stats.binomtest(passed, runs).proportion_ci(CONFIDENCE, method="wilson")
    return {
        "passed": passed,
        "runs": runs,
        "rate": passed / runs,
        "low": float(interval.low),
        "high": float(interval.high),
    }


def mean_interval(values: Array) -> dict[str, float | int | None]:
    """Return the mean of ``values`` with Student's interval of ``CONFIDENCE``; None if there are too few."""
    finite = values[np.isfinite(values)]
    n = len(finite)
    if n < 2:
        return {"n": n, "mean": float(finite[0]) if n else None, "low": None, "high": None}
    half = float(scipy.stats.t.ppf(0.5 * (1.0 + CONFIDENCE), n - 1)) * float(finite.std(ddof=1)) / math.sqrt(n)
    mean = float(finite.mean())
    return {"n": n, "mean": mean, "low": mean - half, "high": mean + half}


def summarise(store: Store, scenario: str) -> dict[str, Any]:
    """Return the numbers of a finished campaign."""
    case = store.column("case")
    runs = len(case)
    return {
        "scenario": scenario,
        "runs": runs,
        "confidence": CONFIDENCE,
        "pass_rate": {flag: wilson(int(np.count_nonzero(store.column(flag))), runs) for flag in FLAGS},
        "stops": _stops(store),
        "worst": _worst(store, scenario, case),
        "percentiles": {name: percentiles(store.column(name)) for name in SPREAD_OF},
        "least_margin_cases": _least(store, case),
    }


def _stops(store: Store) -> list[dict[str, Any]]:
    """Return the most frequent reasons why cases ended early or could not be run, each with its first case."""
    stop, abort = store.column("stop"), store.column("abort")
    reasons = np.where(stop != COMPLETED, stop, np.where(abort != "", "aborted: " + abort.astype(object), ""))
    texts, first, count = np.unique(reasons.astype(str), return_index=True, return_counts=True)
    rows: list[dict[str, Any]] = [
        {"reason": str(reason), "cases": int(n), "first_case": int(i)}
        for reason, i, n in zip(texts, first, count, strict=True)
        if reason
    ]
    return sorted(rows, key=lambda row: (-row["cases"], row["first_case"]))[:_REASONS]


def _worst(store: Store, scenario: str, case: Array) -> dict[str, list[dict[str, Any]]]:
    """Return for each row and axis of Table III the largest deviation of all cases, its case, and Table V's value."""
    paper = TABLE_V.get(scenario)
    worst: dict[str, list[dict[str, Any]]] = {}
    for row in ROW_NAMES:
        worst[row] = []
        for i, axis in enumerate("xyz"):
            values = store.column(f"{row}_{axis}")
            has_value = np.isfinite(values).any()
            at = int(np.nanargmax(values)) if has_value else None
            worst[row].append(
                {
                    "value": None if at is None else float(values[at]),
                    "case": None if at is None else int(case[at]),
                    "table_v": getattr(paper, row)[i] if paper else None,
                }
            )
    return worst


def percentiles(values: Array) -> dict[str, float | int | None]:
    """Return number, extremes and ``PERCENTILES`` of ``values`` (n,), without those that are missing."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return {"n": 0}
    cut = np.percentile(finite, PERCENTILES)
    return {
        "n": len(finite),
        "least": float(finite.min()),
        **{f"p{p:g}": float(v) for p, v in zip(PERCENTILES, cut, strict=True)},
        "greatest": float(finite.max()),
    }


def _least(store: Store, case: Array) -> list[dict[str, Any]]:
    """Return the ten cases with the least margin to Table III, those without a ready phase first."""
    margin = store.column("control_margin")
    order = np.argsort(np.where(np.isfinite(margin), margin, -np.inf), kind="stable")[:10]
    return [
        {"case": int(case[i]), "control_margin": float(margin[i]) if math.isfinite(margin[i]) else None} for i in order
    ]


COMPARED: Final = (
    "propellant_kg", "firings", "thruster_on_time_s", "ready_time_s",
    *(f"{row}_{axis}" for row in ROW_NAMES for axis in "xyz"),
)  # fmt: skip


def compare(first: HasColumns, second: HasColumns, names: tuple[str, str]) -> dict[str, Any]:
    """Return second minus first, case by case with the same seeds, with intervals of the mean difference.

    Cases in which one of both has no value are omitted.
    """
    comparison: dict[str, Any] = {
        "first": names[0],
        "second": names[1],
        "runs": len(first.column("passed")),
        "confidence": CONFIDENCE,
        "pass_rate": paired_rates(first, second, "passed"),
        "accepted_rate": paired_rates(first, second, "accepted"),
        "difference": {},
    }
    for name in COMPARED:
        a, b = (np.asarray(store.column(name), dtype=float) for store in (first, second))
        both = np.isfinite(a) & np.isfinite(b)
        means = (float(a[both].mean()), float(b[both].mean())) if both.any() else (None, None)
        comparison["difference"][name] = {"first_mean": means[0], "second_mean": means[1], **mean_interval(b - a)}
    return comparison


def paired_rates(first: HasColumns, second: HasColumns, flag: str) -> dict[str, Any]:
    """Return the rates of ``flag`` in both campaigns, and the number of cases that have it in one alone."""
    a, b = (np.asarray(store.column(flag), dtype=bool) for store in (first, second))
    return {
        "first": wilson(int(a.sum()), len(a)),
        "second": wilson(int(b.sum()), len(b)),
        "first_alone": int((a & ~b).sum()),
        "second_alone": int((b & ~a).sum()),
    }


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
