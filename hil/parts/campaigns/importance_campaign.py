"""Importance sampling of a rare event: the probability that a deviation of the ready phase exceeds a threshold.

A check of subset simulation by other cases: independent ones whose noise has the means of ``importance_density``, each
with the weight of its density. The density is fitted to pilot cases and kept in the folder. The estimate has no bias
whatever the density; one that misses a way to the event has a large error that its cases do not show, so an estimate
with few effective cases, or that one case dominates, is withheld.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from hil.core.files import MIB, read_text
from hil.core.messages import CYCLE, Array
from hil.errors import BadInput
from hil.maths import elementary
from hil.maths.elementary import square
from hil.maths.random_streams import MixedSeed
from hil.params.ready import ROW_NAMES
from hil.parts.campaigns import importance_density
from hil.parts.campaigns.campaign import CampaignJob, Progress, Watch, write_summary
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.engines import Engine
from hil.parts.campaigns.rare_events import ESTIMATED, RareEvent, lognormal_interval
from hil.parts.campaigns.statistics import CONFIDENCE
from hil.parts.campaigns.store import Store, atomic_write
from hil.report.verdict import deviations

METHOD: Final = "importance sampling"
DENSITY: Final = "density.json"
CASES: Final = 2000
PILOT_CASES: Final = 400
TOO_FEW_EFFECTIVE: Final = "too few effective cases"
NO_DIRECTION: Final = "no noise leads to the event"
_DENSITY_BYTES: Final = 4 * MIB
_LEAST_EFFECTIVE: Final = 30.0  # failing cases: with fewer, the stated coefficient of variation is too small itself
_LARGEST_PART: Final = 0.2  # of one case in the estimate
_PEAKS: Final = 8  # per pilot case
_APART_S: Final = 20.0  # between them
_PILOT: Final = 6  # of the spawn keys of a campaign's seed
_SHOWN: Final = 50
COLUMNS: Final = tuple(f"{row}_{axis}" for row in ROW_NAMES for axis in "xyz")
"""Outcomes whose events are first passages."""


@dataclass(frozen=True)
class ImportanceSettings:
    """Event and number of cases. Raises BadInput for an outcome that is no largest deviation, or below a threshold."""

    event: RareEvent
    cases: int = CASES
    columns: ClassVar = (importance_density.LOG_WEIGHT,)
    """Columns of the cases in addition to the common ones of campaigns."""

    def __post_init__(self) -> None:
        event = self.event
        if event.outcome not in COLUMNS or event.side != ">" or event.threshold <= 0.0:
            names = ", ".join(COLUMNS)
            text = f"{event}: importance sampling needs a largest deviation, >, and a threshold above 0: one of {names}"
            raise BadInput.single("--method", "importance", text)

    def identity(self) -> dict[str, Any]:
        """Return what distinguishes the folder from other campaigns' folders."""
        return {"importance": dataclasses.asdict(self.event)}

    def run(self, job: CampaignJob, store: Store, engine: Engine, watch: Watch) -> dict[str, Any]:
        """Fit the density unless the folder has it, run the cases that are missing, and estimate the probability.

        Returns the summary, which is also written to the folder.
        """
        density = self._density(job, store.folder / DENSITY, watch)
        if density is not None:
            spec = dataclasses.replace(job.spec, density=density.text())
            job.fly(spec, store, self.cases, engine, watch, f"{self.event}:")
        summary = {"scenario": job.scenario.value.name, "seed": job.seed, "rare": self._estimate(store, density)}
        write_summary(store.folder / "summary.json", summary)
        return summary

    def _density(self, job: CampaignJob, path: Path, watch: Watch) -> importance_density.ImportanceDensity | None:
        if path.is_file():
            return read_density(path)
        density = pilot_density(job, COLUMNS.index(self.event.outcome), self.event.threshold, watch)
        if density is not None:
            with atomic_write(path) as partial:
                partial.write_text(density.text(), encoding="utf-8")
        return density

    def _estimate(self, store: Store, density: importance_density.ImportanceDensity | None) -> dict[str, Any]:
        event = self.event
        rare = {"outcome": event.outcome, "side": event.side, "threshold": event.threshold}
        if density is None:
            return rare | _result(np.zeros(0), np.zeros(0), event.level) | {"verdict": NO_DIRECTION}
        values = event.values(np.asarray(store.column(event.outcome), dtype=float))
        weights = elementary.each(elementary.exp, store.column(importance_density.LOG_WEIGHT))
        rare |= _result(values, weights, event.level) | {"distance": density.distance}
        rare["noise"] = importance_density.noise_drivers(density)
        failing = np.flatnonzero(values > event.level)
        rare["failing_cases"] = len(failing)
        shown = failing[np.argsort(-values[failing], kind="stable")][:_SHOWN]
        rare["failing"] = [{"case": int(case), "value": float(values[case])} for case in shown]
        return rare


def read_density(path: Path) -> importance_density.ImportanceDensity:
    """Return the density of a campaign's folder; raise BadInput."""
    try:
        return importance_density.ImportanceDensity.parse(read_text(path, _DENSITY_BYTES))
    except (ValueError, TypeError, KeyError) as error:
        raise BadInput.single(str(path), "", f"cannot be read, remove it: {error}") from error


def _result(values: Array, weights: Array, level: float) -> dict[str, Any]:
    """Return the estimate from the cases' values and weights, by the keys of ``rare`` in ``summary.json``."""
    terms = np.where(values > level, weights, 0.0)
    rare: dict[str, Any] = {"probability": None, "cov": None, "low": None, "high": None, "verdict": TOO_FEW_EFFECTIVE}
    total, squares = float(terms.sum()), float((terms * terms).sum())
    effective = square(total) / squares if squares else 0.0
    if effective >= _LEAST_EFFECTIVE and terms.max() <= _LARGEST_PART * total:
        probability, cov = importance_estimate(terms)
        low, high = lognormal_interval(probability, cov)
        rare = {"probability": probability, "cov": cov, "low": low, "high": high, "verdict": ESTIMATED}
    return rare | {
        "confidence": CONFIDENCE,
        "cases": len(values),
        "pilot_cases": PILOT_CASES,
        "method": METHOD,
        "effective_cases": effective,
        "mean_weight": float(weights.mean()) if len(weights) else None,
        "without_value": int(np.count_nonzero(np.isneginf(values))),
        "extreme": float(values.max()) if len(values) else None,
        "failing_cases": 0,
        "failing": [],
        "levels": [],
        "drivers": [],
        "noise": [],
    }


def importance_estimate(terms: Array) -> tuple[float, float]:
    """Return mean and coefficient of variation of ``terms``: the weights of cases that meet the event, 0 of others."""
    mean = float(terms.mean())
    return mean, float(terms.std(ddof=1)) / (mean * math.sqrt(len(terms)))


def pilot_density(
    job: CampaignJob, axis: int, level: float, watch: Watch
) -> importance_density.ImportanceDensity | None:
    """Return the density for ``level`` of deviation number ``axis`` of ``COLUMNS``, from pilot cases."""
    runner = CaseRunner(job.scenario.value, job.rig, job.duration_s, job.own)
    history = np.zeros(runner.cycles, CYCLE)
    rates_hz = {name: rate for name, (_, rate) in runner.noise().items()}
    block_s = importance_density.block_length_s(rates_hz)
    blocks = math.floor(job.duration_s / block_s)
    normals: dict[str, list[Array]] = {name: [] for name in rates_hz}
    dispersions, peaks, ready_s = list[Array](), list[tuple[float, float, float]](), list[float]()
    for case in range(PILOT_CASES):
        sequence = np.random.SeedSequence(job.seed, spawn_key=(_PILOT, case))
        seed = MixedSeed.fresh(int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1)))
        truth, gnc = job.design.apply(job.design.values(case, seed))
        if job.design.touches_gnc:
            runner.set_gnc_scenario(gnc)
        stats, _ = runner.run(truth, seed, history)
        watch(Progress("pilot cases", case + 1, PILOT_CASES, 0.0))
        if not stats.ready.is_ready:
            continue
        errors = deviations(history[: int(stats.cycles)], gnc.requirements)
        deviation = np.column_stack([errors.position_m, errors.velocity_mps, errors.attitude_deg, errors.rate_degps])[
            :, axis
        ]
        of_case = peaks_of(deviation, errors.t_s, float(stats.ready.ready_s))
        number = len(dispersions)
        peaks += [(number, min(blocks - 1, math.floor(t_s / block_s)), value) for t_s, value in of_case]
        for name, (drawn, rate_hz) in runner.noise().items():
            normals[name].append(importance_density.block_normals(drawn, rate_hz, block_s, blocks))
        dispersions.append(job.design.normals(seed))
        ready_s.append(float(stats.ready.ready_s))
    if not peaks:
        return None
    of_cases = {name: np.array(rows) for name, rows in normals.items()}
    pilot = importance_density.PilotCases(of_cases, np.array(dispersions), np.array(peaks))
    first = min(blocks - 1, math.floor(min(ready_s) / block_s))
    return importance_density.fitted_density(pilot, level, first, block_s, rates_hz)


def peaks_of(deviation: Array, t_s: Array, from_s: float) -> list[tuple[float, float]]:
    """Return time and value of the largest deviations from ``from_s`` on, ``_APART_S`` apart; deviation, t_s: (n,)."""
    size = np.where(t_s >= from_s, np.abs(deviation), 0.0)
    peaks: list[tuple[float, float]] = []
    while len(peaks) < _PEAKS and size.max() > 0.0:
        at = int(np.argmax(size))
        peaks.append((float(t_s[at]), float(deviation[at])))
        size[np.abs(t_s - t_s[at]) < _APART_S] = 0.0
    return peaks
