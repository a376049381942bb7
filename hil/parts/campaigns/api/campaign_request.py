"""Campaigns and studies as they are asked for, by ``hil.campaign`` or on the command line: checked, run, written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from hil.api.jobs import BackendArguments, Settings, job_of
from hil.checks.before_run import before_run
from hil.config.scenario import Scenario
from hil.core.surroundings import temporary_folder
from hil.errors import BadInput, Problem
from hil.parts.campaigns.api.campaign_results import Campaign, Comparison, StudyResults, SweepResults
from hil.parts.campaigns.campaign import RIG, CampaignJob, Progress, Sweep, Watch, write_summary
from hil.parts.campaigns.engines import DaskEngine, Engine, LocalEngine
from hil.parts.campaigns.figure import draw_indices, draw_integrity, draw_percentiles, draw_sweep
from hil.parts.campaigns.importance_campaign import ImportanceSettings
from hil.parts.campaigns.page import write_page
from hil.parts.campaigns.rare_campaign import RareSettings
from hil.parts.campaigns.rare_events import RareEvent
from hil.parts.campaigns.sobol_campaign import SobolCampaign
from hil.parts.campaigns.statistics import compare
from hil.parts.campaigns.store import Store, parquet

STUDIES: Final = ("rare", "sobol", "against", "sweep")
"""Arguments that ask for more than a campaign of one scenario: one of them at a time."""
_METHODS: Final[dict[str, type[RareSettings] | type[ImportanceSettings]]] = {
    "subset": RareSettings,
    "importance": ImportanceSettings,
}
"""Method of a rare event -> its settings, made of the event and the number of cases."""
_LEAST_CASES: Final = {"subset": 500, "importance": 200}  # by method

Results = Campaign | Comparison | SweepResults | StudyResults
Show = Callable[[str, float], None]
"""Called with a line of text and the completed fraction."""


class _Study(NamedTuple):
    """What is done with the cases of a scenario. identity, columns: as for ``CampaignJob.store``."""

    run: Callable[[CampaignJob, Store, Engine, Watch], dict[str, Any]]
    identity: dict[str, Any]
    columns: Sequence[str] = ()


@dataclass(frozen=True)
class CampaignRequest:
    """Arguments of ``hil.campaign``, with the overrides as ``key=value`` settings."""

    scenario: str | Path | Scenario
    settings: Settings = ()
    runs: int | None = None
    out: Path | None = None
    seed: int = 0
    duration_s: float | None = None
    workers: int = 0
    scheduler: str | None = None
    against: str | Path | Scenario | None = None
    sweep: str | Sweep | None = None
    rare: str | None = None
    method: str = "subset"
    sobol: int | None = None
    backends: BackendArguments = field(default_factory=BackendArguments)
    rig: str = RIG
    figures: bool = False
    """Draw the figures of each campaign, which take a second."""

    def problems(self) -> list[Problem]:
        """Return a problem for each argument that cannot be used, named as the option of the command."""
        refused: list[tuple[str, str]] = []
        if self.scheduler is not None and self.workers:
            refused.append(("workers", "not together with --scheduler, which has its own workers"))
        chosen = [name for name in STUDIES if getattr(self, name) is not None]
        refused += [(chosen[0], f"not together with --{other}") for other in chosen[1:]]
        if self.runs is None and chosen[:1] not in (["rare"], ["sobol"]):
            refused.append(("runs", "must be given, unless --rare or --sobol is"))
        if self.sobol is not None and self.runs is not None:
            refused.append(("sobol", "not together with --runs"))
        if self.rare is not None:
            if self.method not in _METHODS:
                refused.append(("method", f"{self.method:.40}: must be {' or '.join(_METHODS)}"))
            least = _LEAST_CASES.get(self.method, 1)
            if self.runs is not None and self.runs < least:
                each = " per level" if self.method == "subset" else ""
                text = f"{self.runs}: too few for the probability of a rare event, at least {least}{each}"
                refused.append(("runs", text))
        return [Problem(f"--{name}", "", text) for name, text in refused]

    def run(self, show: Show = lambda *_: None, warn: Callable[[str], None] = lambda _: None) -> Results:
        """Run all cases; write tables, summaries, figures and page into ``out``, which is temporary if it is None.

        warn: called with a line for each file of an earlier start that cannot be used. Raises BadInput,
        CampaignStopped.
        """
        if problems := self.problems():
            raise BadInput(problems)
        parquet()
        show("checking the scenario", 0.0)
        sweep = Sweep.parse(self.sweep) if isinstance(self.sweep, str) else self.sweep
        jobs = self._jobs(sweep)
        study = self._study(jobs[0])
        with ExitStack() as held:
            engine = LocalEngine(self.workers) if self.scheduler is None else DaskEngine(self.scheduler)
            held.callback(engine.close)
            for job in jobs:
                for line in before_run(job.scenario.value, job.rig, job.duration_s).lines:
                    warn(line)
            out = self.out
            if out is None:
                out = Path(held.enter_context(temporary_folder("campaign")))
            stores = [
                held.enter_context(job.store(folder, warn, study.identity, study.columns))
                for job, folder in zip(jobs, self._folders(out, len(jobs)), strict=True)
            ]
            show("compiling the loop if it is not cached, up to two minutes", 0.0)
            if self.scheduler is None:  # else its workers do
                jobs[0].warm_up()
            campaigns = []
            for i, (job, store) in enumerate(zip(jobs, stores, strict=True)):

                def watch(now: Progress, i: int = i) -> None:
                    show(str(now), (i + now.fraction) / len(jobs))

                summary = study.run(job, store, engine, watch)
                if self.rare is not None or self.sobol is not None:
                    return self._study_results(job, store, summary)
                campaigns.append(
                    Campaign(job.nominal, summary, store.table(), None if self.out is None else store.folder)
                )
                if self.out is not None and self.figures:
                    draw_percentiles(store, job.scenario.value, store.folder / "percentiles.png")
                    draw_integrity(store, store.folder / "stanford.png")
                if self.out is not None:
                    write_page(store.folder)
            return self._joined(campaigns, sweep)

    def _jobs(self, sweep: Sweep | None) -> list[CampaignJob]:
        """Return the campaign of each scenario, or of each value of the sweep."""
        scenarios = [self.scenario] if self.against is None else [self.scenario, self.against]
        keys = [()] if sweep is None else [(f"{sweep.key}={value!r}",) for value in sweep.values]
        try:
            return [
                CampaignJob.of(
                    job_of(each, self.rig, (*self.settings, *more), self.seed, self.duration_s, **self.backends)
                )
                for each in scenarios
                for more in keys
            ]
        except BadInput as error:
            if sweep is None:
                raise
            problems = [
                Problem("--sweep" if p.source == "--set" and p.key == sweep.key else p.source, p.key, p.message)
                for p in error.problems
            ]
            raise BadInput(problems) from error

    def _folders(self, out: Path, number: int) -> list[Path]:
        if self.against is not None:
            return [out / "first", out / "second"]
        return [out] if self.sweep is None else [out / f"sweep-{i:03d}" for i in range(number)]

    def _study(self, job: CampaignJob) -> _Study:
        if self.rare is not None:
            event, cases = RareEvent.parse(self.rare), () if self.runs is None else (self.runs,)
            settings = _METHODS[self.method](event, *cases)
            return _Study(settings.run, settings.identity(), settings.columns)
        if self.sobol is not None:
            indices = SobolCampaign(job, self.sobol)
            return _Study(lambda _, *more: indices.run(*more), indices.identity())
        runs = self.runs or 0
        return _Study(lambda job, store, engine, watch: job.run(store, runs, engine, watch), {})

    def _study_results(self, job: CampaignJob, store: Store, summary: dict[str, Any]) -> StudyResults:
        if self.out is not None and self.sobol is not None:
            draw_indices(summary, self.out / "sobol.png")
        cases = store.table() if store.table_path.is_file() else None
        return StudyResults(job.nominal, summary, cases, self.out)

    def _joined(self, campaigns: list[Campaign], sweep: Sweep | None) -> Campaign | Comparison | SweepResults:
        """Return the results of all campaigns, and write what they have in common."""
        joined: Comparison | SweepResults
        if sweep is not None:
            joined, name = SweepResults(sweep, campaigns), "sweep"
        elif self.against is not None:
            given = (self.scenario, self.against)
            names = [each.name if isinstance(each, Scenario) else str(each) for each in given]
            first, second = campaigns
            joined, name = Comparison(first, second, compare(first, second, (names[0], names[1]))), "comparison"
        else:
            return campaigns[0]
        if self.out is not None:
            if sweep is not None:
                draw_sweep(joined.summary, self.out / "sweep.png")
            write_summary(self.out / f"{name}.json", joined.summary)
            write_page(self.out)
        return joined
