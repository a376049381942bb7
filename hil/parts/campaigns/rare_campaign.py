"""Rare-event campaign: the cases of a method's points, on any engine, kept in the store of a campaign.

A point depends on the numbers and outcomes of the cases before it only, so an interrupted campaign is resumed by
replaying the method with the outcomes that are stored. Each case keeps its parent and scale: its noise and dispersions
are made from these alone (``stored_seed``).
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from hil.core.messages import Array
from hil.maths import elementary, linear
from hil.maths.elementary import square
from hil.maths.random_streams import MixedSeed
from hil.maths.special import normal_probabilities
from hil.parts.campaigns import rare_events
from hil.parts.campaigns.campaign import CampaignJob, Progress, Watch, write_summary
from hil.parts.campaigns.dispersions import case_seed
from hil.parts.campaigns.engines import Engine
from hil.parts.campaigns.statistics import CONFIDENCE
from hil.parts.campaigns.store import BATCH, Store
from hil.parts.campaigns.subset_simulation import STEPS, subset_simulation

PARENT, SCALE, LEVEL = "parent", "scale", "level"
POINT_COLUMNS: Final = (LEVEL, PARENT, SCALE)
"""Columns of a rare-event campaign's cases."""
PER_LEVEL: Final = 1000
_UNIT: Final = STEPS * BATCH  # of the cases per level: chains in whole batches
_LARGE_FAMILY: Final = 0.5  # part of the event's samples that the terminal names
_SHOWN: Final = 50  # failing cases in the summary
_DRIVERS: Final = 10
_LEAST_FACTOR, _FACTORS = 0.05, 96  # of a dispersion's spread


@dataclass(frozen=True)
class RareSettings:
    """Event and number of cases of each level, rounded up to a multiple of 500."""

    event: rare_events.RareEvent
    per_level: int = PER_LEVEL

    columns: ClassVar = POINT_COLUMNS
    """Columns of the cases in addition to the common ones of campaigns."""

    @property
    def cases_per_level(self) -> int:
        """Cases of each level."""
        return _UNIT * math.ceil(self.per_level / _UNIT)

    def identity(self) -> dict[str, Any]:
        """Return what distinguishes the folder from other campaigns' folders."""
        return {"rare": {**dataclasses.asdict(self.event), "cases_per_level": self.cases_per_level}}

    def method(self, seed: int) -> rare_events.Method:
        """Return the method that estimates the probability."""
        return subset_simulation(self.event.level, self.cases_per_level, seed)

    def run(self, job: CampaignJob, store: Store, engine: Engine, watch: Watch) -> dict[str, Any]:
        """Run the cases that are missing; return the summary, which is also written to the folder."""
        return RareCampaign(job, self, store, engine).run(watch)


class RareCampaign:
    """Runs a method's points as cases of ``job``, kept in ``store``."""

    def __init__(self, job: CampaignJob, settings: RareSettings, store: Store, engine: Engine) -> None:
        self._job = job
        self._settings = settings
        self._store = store
        self._engine = engine
        self._seeds: dict[int, MixedSeed] = {}
        self._values: dict[int, float] = {}
        self._missing_values = 0

    def run(self, watch: Watch) -> dict[str, Any]:
        """Run the cases that are missing; return the summary, which is also written to the folder."""
        self._store.restore()
        method = self._settings.method(self._job.seed)
        points = next(method)
        begun_s, flown = time.perf_counter(), 0
        while True:
            flown += self._run_points(points)
            number, level = points[-1].number + 1, points[-1].level
            speed = flown * self._job.duration_s / max(1e-9, time.perf_counter() - begun_s)
            watch(Progress(f"{self._settings.event}, level {level}:", number, 0, speed))
            try:
                points = method.send(np.array([self._values[point.number] for point in points]))
            except StopIteration as end:
                return self._finish(end.value)

    def _run_points(self, points: Sequence[rare_events.NormalPoint]) -> int:
        """Run the cases of ``points`` that are not stored; return their number."""
        self._seeds |= rare_events.mixed_seeds(self._job.seed, points, self._seeds)
        batches = [points[at : at + BATCH] for at in range(0, len(points), BATCH)]
        missing = []
        for batch in batches:
            stored = self._store.rows(batch[0].number, len(batch))
            if stored is not None and [_point(row) for row in stored] == batch:
                self._take(stored)
            else:
                missing.append((batch[0].number, len(batch)))
        of = {point.number: point for point in points}
        spec = dataclasses.replace(self._job.spec, mixed={number: self._seeds[number] for number in of})
        with closing(self._engine.run(spec, missing)) as results:
            for first, rows in results:
                whole = [row | _columns(of[row["case"]]) for row in rows]
                self._store.put(first, whole)
                self._take(whole)
        return sum(count for _, count in missing)

    def _take(self, rows: Sequence[dict[str, Any]]) -> None:
        event = self._settings.event
        column = np.array([row[event.outcome] for row in rows], dtype=float)
        self._missing_values += int(np.count_nonzero(~np.isfinite(column)))
        self._values |= zip((row["case"] for row in rows), map(float, event.values(column)), strict=True)

    def _finish(self, estimate: rare_events.Estimate) -> dict[str, Any]:
        self._store.finish(estimate.points)
        scenario = self._job.scenario.value.name
        summary = {"scenario": scenario, "seed": self._job.seed, "rare": self._summary(estimate)}
        write_summary(self._store.folder / "summary.json", summary)
        return summary

    def _summary(self, estimate: rare_events.Estimate) -> dict[str, Any]:
        event = self._settings.event
        sign = 1.0 if event.side == ">" else -1.0
        failing = sorted(
            (int(number) for number in self._values if self._values[number] > event.level),
            key=lambda number: (-self._values[number], number),
        )
        finite = [value for value in self._values.values() if math.isfinite(value)]
        return {
            "outcome": event.outcome,
            "side": event.side,
            "threshold": event.threshold,
            "probability": estimate.probability,
            "cov": estimate.cov,
            "low": estimate.low,
            "high": estimate.upper,
            "confidence": CONFIDENCE,
            "cases": estimate.points,
            "cases_per_level": self._settings.cases_per_level,
            "method": "subset simulation",
            "verdict": estimate.verdict,
            "levels": [
                {
                    "bound": None if level.bound is None else sign * level.bound,
                    "fraction": level.fraction,
                    "cov": level.cov if math.isfinite(level.cov) else None,
                    "acceptance": level.acceptance if math.isfinite(level.acceptance) else None,
                }
                for level in estimate.levels
            ],
            "extreme": sign * max(finite) if finite else None,
            "without_value": self._missing_values,
            "largest_family": estimate.largest_family,
            "failing_cases": len(failing),
            "failing": [{"case": number, "value": sign * self._values[number]} for number in failing[:_SHOWN]],
            "drivers": self._drivers(estimate),
        }

    def _drivers(self, estimate: rare_events.Estimate) -> list[dict[str, Any]]:
        """Return the dispersed numbers that drive the event, that with the least change of spread to halve it first."""
        design = self._job.design
        if not design.names or not len(estimate.samples):
            return []
        normals = np.array([design.normals(self._seeds[int(number)]) for number in estimate.samples])
        mean = linear.product(estimate.weights, normals)
        rows = [
            {
                "dispersion": component.name,
                "mean_sigma": float(mean[i]),
                "halved_by": halving_factor(normals[:, i], estimate.weights, component.kind == "uniform"),
            }
            for i, component in enumerate(design.components)
        ]
        return sorted(rows, key=_effect)[:_DRIVERS]


def halving_factor(normals: Array, weights: Array, uniform: bool) -> float | None:
    """Return the largest factor on one number's spread that halves the probability of the event; None without one.

    normals: of the number in samples of the event, (n,); weights: of the samples, with a sum of 1. uniform: the number
    is uniform, and its interval shrinks about the middle. The samples are weighted by the ratio of both densities.
    """
    factors = np.linspace(1.0, _LEAST_FACTOR, _FACTORS)
    away = np.abs(2.0 * normal_probabilities(normals) - 1.0) if uniform else 0.5 * square(normals)
    for factor in factors[1:]:
        ratio = (
            (away <= factor) if uniform else elementary.each(elementary.exp, -away * (1.0 / (factor * factor) - 1.0))
        )
        if float((weights * ratio).sum()) <= 0.5 * factor:
            return float(factor)
    return None


def _effect(row: dict[str, Any]) -> tuple[float, float]:
    """Return the key by which drivers are sorted: the least change that halves the probability first."""
    return (-(row["halved_by"] or 0.0), -abs(row["mean_sigma"]))


def verdict_line(rare: dict[str, Any]) -> str:
    """Return the result of a rare-event campaign in one line."""
    event = f"{rare['outcome']} {rare['side']} {rare['threshold']:g}"
    cases = f"{rare['cases']} cases"
    if rare["verdict"] == rare_events.NEVER:
        extreme = _number(rare["extreme"])
        return f"{event}: never met, probability below {rare_events.LEAST:g}; extreme {extreme} of {cases}"
    if rare["verdict"] == rare_events.STUCK:
        missing = f"{rare['without_value']} cases have no value; " if rare["without_value"] else ""
        return (
            f"{event}: no estimate, the levels do not advance beyond {_number(rare['extreme'])}: {missing}"
            f"probability at most {rare['high']:.2g}, {cases}"
        )
    if rare["probability"] is None:
        return f"{event}: no estimate by {rare['method']}: {rare['verdict']}, {rare['failing_cases']} of {cases} met it"
    text = f"{event}: probability {rare['probability']:.3g} ({rare['low']:.2g} .. {rare['high']:.2g})"
    met = "always met, " if rare["probability"] == 1.0 else ""
    largest = rare.get("largest_family")
    family = f"; {100.0 * largest:.0f} % of it descend from one case" if largest and largest > _LARGE_FAMILY else ""
    return f"{text}, {met}c.o.v. {rare['cov']:.2f}, {cases}{family}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"


def _columns(point: rare_events.NormalPoint) -> dict[str, float]:
    """Return the columns of a case that identify its point."""
    return {LEVEL: float(point.level), PARENT: float(point.parent), SCALE: point.scale}


def _point(row: dict[str, Any]) -> rare_events.NormalPoint:
    return rare_events.NormalPoint(row["case"], int(row[PARENT]), row[SCALE], int(row[LEVEL]))


def stored_seed(case: int, campaign_seed: int, parents: Callable[[int], tuple[int, float]]) -> MixedSeed:
    """Return the seed of a stored case. parents: returns parent and scale of a case."""
    line = [(case, *parents(case))]
    while line[-1][1] != rare_events.FRESH:
        line.append((line[-1][1], *parents(line[-1][1])))
    mixed = MixedSeed.fresh(case_seed(campaign_seed, line[-1][0]))
    for number, _, scale in reversed(line[:-1]):
        mixed = mixed.moved(case_seed(campaign_seed, number), scale)
    return mixed
