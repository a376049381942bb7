"""Campaign of one scenario from its job to its summary, and the values of a sweep."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from hil.config.load import Loaded
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.config.tables.verdict import PART_COLUMNS, required_parts
from hil.core.kernel_digest import digest_of
from hil.errors import BadInput, Problem
from hil.gnc_backends.backend import OwnBackends
from hil.gnc_backends.backend_registry import NO_BACKENDS, named
from hil.loop.compiled.run_cycles import run_cycles
from hil.parts.campaigns.batch import TRACEBACK, Spec, code_digest
from hil.parts.campaigns.dispersions import Design
from hil.parts.campaigns.engines import Engine
from hil.parts.campaigns.explain import explain
from hil.parts.campaigns.python_cases import case_runner
from hil.parts.campaigns.requirements_page import EvidenceRow, campaign_rows, evidence_files
from hil.parts.campaigns.statistics import (
    HasColumns,
    check_requirements,
    judge_requirements,
    mean_interval,
    summarise,
    tolerance_bounds,
    wilson,
)
from hil.parts.campaigns.store import GIVEN, Store, atomic_write
from hil.session import build
from hil.session.assembly import Job
from hil.session.compiled import Kernels, kernels_are_cached, runs_compiled
from hil.session.warm_up import compile_group

RIG: Final = "mock"


def given_of(job: Job) -> dict[str, Any]:
    """Return what was asked for by ``job``, as one can repeat it; nothing for Python objects."""
    scenario, rig = job.scenario.given, job.rig.given
    if not scenario or not rig or job.own != NO_BACKENDS:
        return {}
    return {GIVEN: {"scenario": scenario[0], "rig": rig[0], "settings": [*scenario[1:], *rig[1:]]}}


@dataclass(frozen=True)
class Progress:
    """Cases done of all, including those of an earlier start; real-time factor since this start.

    runs, speed: 0 if not known.
    """

    title: str
    done: int
    runs: int
    speed: float

    @property
    def fraction(self) -> float:
        """Completed fraction, 0 if it is not known."""
        return self.done / self.runs if self.runs else 0.0

    def __str__(self) -> str:
        of = f" of {self.runs}" if self.runs else ""
        return f"{self.title} {self.done}{of} cases" + (f", {self.speed:.0f} x real time" if self.speed else "")


Watch = Callable[[Progress], None]


class CampaignJob:
    """One scenario with its dispersions, checked. Raises BadInput with one problem per error.

    own: backends of navigation and control that the caller gives.
    """

    def __init__(
        self,
        scenario: Loaded[Scenario],
        rig: Loaded[Rig],
        seed: int,
        duration_s: float | None = None,
        own: OwnBackends = NO_BACKENDS,
    ) -> None:
        self.scenario = named(scenario, own)
        self.duration_s = scenario.value.duration_s if duration_s is None else duration_s
        self._rig, self.own, self.seed = rig, own, seed
        self._check()
        self.design = Design(self.scenario, seed)
        self.spec = Spec.of(self.scenario.value, rig.value, seed, self.duration_s, own)

    @classmethod
    def of(cls, job: Job) -> Self:
        """Return the campaign whose nominal run is ``job``. Raises BadInput."""
        return cls(job.scenario, job.rig, job.seed, job.duration_s, job.own)

    @property
    def rig(self) -> Rig:
        """The mock rig."""
        return self._rig.value

    @property
    def nominal(self) -> Job:
        """The nominal run, with the seed of the campaign."""
        return Job(self.scenario, self._rig, self.seed, self.duration_s, 1.0, own=self.own)

    def _check(self) -> None:
        build.check(self.nominal)
        rig, problems = self._rig.value, check_requirements(self.scenario)
        if rig.kind != "mock":
            problems.append(Problem("--rig", rig.name, f'kind "{rig.kind}": campaigns run in memory, allowed "mock"'))
        if self.scenario.value.vmu.source != "model":
            text = f'"{self.scenario.value.vmu.source}": campaigns use the model of the vision unit, allowed "model"'
            problems.append(self.scenario.problem("vmu.source", text))
        for name, part in self.scenario.value.models.items():
            text = f'"{part.fmu}": campaigns run the built-in model: fly a part of the plant in an FMU by hil run'
            problems.append(self.scenario.problem(f"{name}.fmu", text))
        for device, names in (("rails", RAIL_NAMES), ("turntable", GIMBAL_NAMES)):
            for name in names:
                if getattr(getattr(rig, device), name).encoder == "incremental":
                    key = f"{device}.{name}.encoder"
                    text = '"incremental": campaigns have absolute encoders, allowed "absolute"'
                    problems.append(Problem(self._rig.where(key), f"rig.{key}", text))
        if problems:
            raise BadInput(problems)

    def store(
        self,
        folder: Path,
        warn: Callable[[str], None] = lambda _: None,
        more: dict[str, Any] | None = None,
        columns: Sequence[str] = (),
    ) -> Store:
        """Return the folder's store; raise BadInput if it holds another campaign.

        warn: called with a line for each file of an earlier start that cannot be used. more: part of the identity of
        the campaign. columns: names of numbers in addition to the common ones of campaigns.
        """
        return Store(
            folder, self.identity() | (more or {}), [*self.design.names, *columns], warn, given_of(self.nominal)
        )

    def identity(self) -> dict[str, Any]:
        """Return what distinguishes the campaign from others."""
        return {
            "scenario": self.scenario.value.name,
            "digest": campaign_digest(self.scenario.value, self._rig.value),
            "scenario_digest": scenario_digest(self.scenario.value),
            "seed": self.seed,
            "duration_s": self.duration_s,
            "kernels": digest_of(run_cycles),
            **({"own": hashlib.sha256(self.spec.own).hexdigest()[:16]} if self.spec.own else {}),
        }

    def warm_up(self) -> None:
        """Compile the loop unless it is in the kernel cache."""
        value = self.scenario.value
        group: Kernels = "loop" if runs_compiled(self.nominal) else "cycle"
        if not kernels_are_cached(group):
            compile_group(group, Job(self.scenario, self._rig, 0, value.step_s, 1.0))
        value = value.model_copy(update={"gnc": value.gnc.built_in()})
        case_runner(value, self._rig.value, 2.0 * value.step_s).run(value, 0)

    def run(self, store: Store, runs: int, engine: Engine, watch: Watch) -> dict[str, Any]:
        """Run the missing ones of ``runs`` cases; return the summary, which is also written to the folder."""
        failures = self.fly(self.spec, store, runs, engine, watch)
        value = self.scenario.value
        more = {
            "seed": self.seed,
            "dispersions": value.dispersions.name,
            "required_parts": required_parts(value.requirements.required_parts, PART_COLUMNS),
        }
        summary = summarise(store, self.scenario.value.name) | more
        table = store.table()
        summary["why"] = explain(lambda name: table.column(name).to_numpy(), self.design.names)
        requirements = judge_requirements(store, self.scenario.value)
        summary |= {"tolerance": tolerance_bounds(store), "requirements": requirements}
        if failures:
            case = min(failures)
            summary["first_error"] = {"case": case, "traceback": failures[case]}
        write_summary(store.folder / "summary.json", summary)
        if requirements:
            self._write_evidence(store, requirements)
        return summary

    def fly(self, spec: Spec, store: Store, runs: int, engine: Engine, watch: Watch, title: str = "") -> dict[int, str]:
        """Run the missing ones of ``runs`` cases of ``spec``; return the tracebacks of the first that failed.

        title: of the progress; the scenario's name without one.
        """
        missing = store.missing(runs)
        remaining = sum(count for _, count in missing)
        begun_s = time.perf_counter()
        done, failures = 0, _first_errors(store.folder)
        watch(Progress(title or self.scenario.value.name, runs - remaining, runs, 0.0))
        with closing(engine.run(spec, missing)) as results:
            for first, rows in results:
                failures |= {row["case"]: row.pop(TRACEBACK) for row in rows if TRACEBACK in row}
                store.put(first, rows)
                done += len(rows)
                speed = done * self.duration_s / max(1e-9, time.perf_counter() - begun_s)
                watch(Progress(title or self.scenario.value.name, runs - remaining + done, runs, speed))
        store.finish(runs)
        return failures

    def _write_evidence(self, store: Store, requirements: list[dict[str, Any]]) -> None:
        """Write the page of the requirements, their JUnit XML and JSON into the folder."""
        sources = {"campaign": store.folder.name} | self.identity()
        write_evidence(store.folder, self.scenario.value.name, sources, campaign_rows(requirements, self.identity()))


def _first_errors(folder: Path) -> dict[int, str]:
    """Return the traceback that the summary of an earlier start has, by the number of its case."""
    try:
        first = json.loads((folder / "summary.json").read_text())["first_error"]
        return {int(first["case"]): str(first["traceback"])}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def write_evidence(folder: Path, scenario: str, sources: dict[str, Any], rows: Sequence[EvidenceRow]) -> None:
    """Write ``requirements.html``, ``.xml`` and ``.json`` into ``folder``; rows: the evidence, of all steps."""
    for name, text in evidence_files(scenario, sources, rows).items():
        with atomic_write(folder / name) as partial:
            partial.write_text(text, encoding="utf-8")


def campaign_digest(scenario: Scenario, rig: Rig) -> str:
    """Return a digest of scenario, rig, and the files of GNC and sensors."""
    return _digest(scenario.model_dump_json(), rig.model_dump_json(), code_digest(scenario))


def scenario_digest(scenario: Scenario) -> str:
    """Return a digest of the scenario alone, which runs on any rig have in common."""
    return _digest(scenario.model_dump_json())


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16]


def write_summary(path: Path, summary: dict[str, Any]) -> None:
    """Write ``summary`` as JSON, atomically. Raises CampaignStopped if the disk is full."""
    with atomic_write(path) as partial:
        partial.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Sweep:
    """``key=low:high:n``: equidistant values of one key, both ends included."""

    key: str
    values: tuple[float, ...]

    @classmethod
    def parse(cls, text: str) -> Sweep:
        """Return the sweep that ``text`` names; raise BadInput."""
        key, equals, bounds = text.partition("=")
        parts = bounds.split(":")
        try:
            if not equals or not key.strip() or len(parts) != 3:
                raise ValueError
            low, high, n = float(parts[0]), float(parts[1]), int(parts[2])
            if not (math.isfinite(low) and math.isfinite(high)):
                raise ValueError
        except ValueError as error:
            text = f"{text}: must look like gnc.control.deadband_m=0.002:0.02:10"
            raise BadInput.single("--sweep", "", text) from error
        if not (low < high and 2 <= n <= 1000):
            raise BadInput.single("--sweep", key, f"{bounds}: low must be below high, and the number 2 to 1000")
        return cls(key.strip(), tuple(float(value) for value in np.linspace(low, high, n)))


def sweep_summary(sweep: Sweep, stores: Sequence[HasColumns]) -> dict[str, Any]:
    """Return rates and means for each value of the sweep."""
    points = []
    for value, store in zip(sweep.values, stores, strict=True):
        passed = np.asarray(store.column("passed"), dtype=bool)
        means = {
            name: mean_interval(np.asarray(store.column(name), dtype=float))
            for name in ("propellant_kg", "firings", "ready_time_s", "control_margin")
        }
        accepted = wilson(int(np.count_nonzero(store.column("accepted"))), len(passed))
        rates = {"pass_rate": wilson(int(passed.sum()), len(passed)), "accepted_rate": accepted}
        points.append({"value": value, **rates, **means})
    return {"key": sweep.key, "points": points}
