"""Results of campaigns and studies, and their cases: one campaign, two compared, many along the values of a key."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from hil.api.frames import library
from hil.api.jobs import job_of, named_as_argument
from hil.api.results import Run
from hil.api.run_comparison import RunComparison, settings_of_both, shown
from hil.api.runs import RunRequest, log, run_job, run_or_raise
from hil.config.load import shipped
from hil.core.messages import Array
from hil.core.public import public
from hil.errors import BadInput, did_you_mean
from hil.maths.random_streams import MixedSeed
from hil.parts.campaigns.campaign import CampaignJob, Sweep, campaign_digest, given_of, sweep_summary
from hil.parts.campaigns.dispersions import Design, case_seed
from hil.parts.campaigns.explain import Cases, case_of, command_of, explain
from hil.parts.campaigns.sobol_indices import sobol_point
from hil.parts.campaigns.statistics import compare as compare_columns
from hil.parts.campaigns.store import given_in
from hil.parts.campaigns.stored_campaign import StoredCampaign
from hil.session.assembly import Job
from hil.session.warm_up import compile_kernels

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure


def job_of_case(job: Job, case: int, mixed: MixedSeed | None = None, unit: Array | None = None) -> Job:
    """Return the job of a campaign's case: its true scenario, the GNC's scenario, and its own seed.

    mixed: that seed in a campaign of a rare event or of Sobol' indices. unit: in the latter, the point of the dispersed
    numbers in the unit cube.
    """
    design = Design(job.scenario, job.seed)
    truth, assumed = design.apply(design.values(case, mixed, unit), design.fault(case))
    assumed = assumed.model_copy(update={"faults": truth.faults})
    seed = case_seed(job.seed, case) if mixed is None else mixed
    return replace(job, scenario=replace(job.scenario, value=assumed), seed=seed, dispersed=truth)


def job_of_stored_case(job: Job, folder: Path, case: int) -> tuple[Job, int, str]:
    """Return the job of a case of the campaign in ``folder``, the campaign's seed, and a note if the scenario differs.

    job: the nominal run with the campaign's seed and duration. Raises BadInput.
    """
    stored = StoredCampaign(folder)
    job = replace(job, seed=stored.seed, duration_s=stored.duration_s)
    if not stored.is_sample and job.rig.value.kind != "mock":
        raise BadInput.single("--rig", job.rig.value.name, "a case of --rare or --sobol runs on the mock rig")
    mixed, unit = stored.mixed_seed(case), None
    if stored.is_sobol:
        unit, mixed = sobol_point(stored.seed, case, len(Design(job.scenario, job.seed).names))
    note = ""
    if stored.digest != campaign_digest(job.scenario.value, job.rig.value):
        note = f"{folder}: its campaign has another scenario, rig or settings: the run differs from its case {case}, "
        note += f"which is {command_of(stored.identity, str(folder), case)}"
    return job_of_case(job, case, mixed, unit), stored.seed, note


def campaign_case(job: Job, case: int, folder: str | Path | None) -> tuple[Job, dict[str, Any], str]:
    """Return the job of a case, what the summary of its run has of it, and a note, "" for none. Raises BadInput.

    folder: of the campaign; None: named by scenario and seed of ``job``.
    """
    if folder is None:
        return job_of_case(job, case), {"campaign_seed": job.seed, "case": case}, ""
    chosen, seed, note = job_of_stored_case(job, Path(folder), case)
    return chosen, {"campaign_seed": seed, "case": case}, note


class Campaign:
    """Results of a campaign.

    summary: the numbers of ``hil campaign --json``, by its keys: pass rates, worst cases, percentiles, causes.
    cases: pyarrow table with one row per case: number, seed, sampled dispersions, verdict and outcomes, SI
    (``cases.to_pandas()`` if pandas is installed). job: the nominal run. folder: of the results, None if they are not
    kept.
    """

    def __init__(self, job: Job, summary: dict[str, Any], cases: pa.Table, folder: Path | None = None) -> None:
        self.job = job
        self.summary = summary
        self.cases = cases
        self.folder = folder

    @property
    def accepted_rate(self) -> dict[str, float | int]:
        """Fraction of the cases that are accepted: completed, not aborted, all parts that the scenario requires.

        Keys: as in ``pass_rate``.
        """
        rate: dict[str, float | int] = self.summary["pass_rate"]["accepted"]
        return rate

    @property
    def pass_rate(self) -> dict[str, float | int]:
        """Fraction of the cases that pass Table III.

        rate: the fraction; low, high: Wilson's 95 % interval; passed, runs: the numbers.
        """
        rate: dict[str, float | int] = self.summary["pass_rate"]["passed"]
        return rate

    @public
    def column(self, name: str) -> Any:
        """Return one column of the cases as a numpy array, (n,); missing numbers are nan. Raises BadInput."""
        if name not in self.cases.column_names:
            near = did_you_mean(name, self.cases.column_names)
            raise BadInput.single(
                "campaign", name, f"no such column: {near or ', '.join(self.cases.column_names)}".strip()
            )
        return self.cases.column(name).to_numpy()

    @public
    def why(self, case: int | None = None) -> dict[str, Any]:
        """Return why cases fail, by the keys of ``hil explain --json``: ``causes``, ``drivers``, ``score`` and others.

        case: number of a case; the result then has its margins and the nearest case that passes. Raises BadInput.
        """
        names = Design(self.job.scenario, self.job.seed).names
        if case is None:
            return explain(self.column, names)
        with named_as_argument():
            identity = {"scenario": self.job.scenario.value.name, **given_of(self.job)}
            return case_of(self.cases, case, identity, "DIR" if self.folder is None else str(self.folder))

    @public
    def run_case(self, case: int) -> Run:
        """Return case number ``case``, run again in full detail. Raises BadInput for a number that has no case."""
        if case not in range(len(self.cases)):
            raise BadInput.single("case", "", f"{case!r:.60}: must be 0 to {len(self.cases) - 1}")
        job = job_of_case(self.job, case)
        compile_kernels(job, log.warning)
        return run_or_raise(RunRequest(job, job.rig.value.name, more={"campaign_seed": self.job.seed, "case": case}))

    def to_pandas(self) -> Any:
        """Return a DataFrame of the cases, indexed by their number. Raises BadInput without pandas."""
        library("pandas")
        return self.cases.to_pandas().set_index("case")

    def to_polars(self) -> Any:
        """Return a polars DataFrame of the cases. Raises BadInput without polars."""
        return library("polars").from_arrow(self.cases)

    def to_xarray(self) -> Any:
        """Return a Dataset of the cases, indexed by their number. Raises BadInput without xarray."""
        library("xarray")
        return self.to_pandas().to_xarray()

    def figure(self) -> Figure:
        """Return the distributions of the outcomes and the deviations against Table III."""
        from hil.parts.campaigns.figure import percentiles_figure  # slow import

        return percentiles_figure(self.column, self.job.scenario.value)

    def __repr__(self) -> str:
        rate = self.accepted_rate
        interval = f"{100.0 * rate['low']:.2f} .. {100.0 * rate['high']:.2f} %"
        return f"<Campaign {self.summary['scenario']}: {rate['passed']} of {rate['runs']} accepted, {interval}>"

    def _repr_html_(self) -> str:
        """Return pass rate and figure for a notebook."""
        from hil.report import html
        from hil.report.figures import svg_address

        why = "".join(html.paragraph(cause["text"]) for cause in self.summary["why"]["causes"][:3])
        return html.paragraph(repr(self)[1:-1]) + why + html.image("outcomes of the cases", svg_address(self.figure()))


@public
def open_campaign(folder: str | Path, trust_code: bool = False) -> Campaign:
    """Return the finished campaign in ``folder``, as ``hil.campaign`` returned it. Raises BadInput.

    Its scenario is loaded again, with the settings of then, and must be the same. trust_code: load a scenario or rig of
    one's own, or a setting that is a text, any of which may name code. Results of Python objects and of studies:
    ``hil.campaign`` with the same arguments.
    """
    cases, stored = Cases(Path(folder), "folder"), StoredCampaign(Path(folder))
    given = given_in(cases.identity)
    if not given or not stored.is_sample:
        text = f"{folder}: hil.campaign with the same arguments returns its results"
        raise BadInput.single("folder", "", text)
    names, settings = (given["scenario"], given["rig"]), tuple(given["settings"])
    texts = [each for each in settings if not each.startswith("dispersions=") and _is_text(each.partition("=")[2])]
    own = [name for name, kind in zip(names, ("scenarios", "rigs"), strict=True) if name not in shipped(kind)]
    if (own or texts) and not trust_code:
        text = f"{folder}: names {', '.join([*own, *texts])}, which may be code: trust_code=True if you trust it"
        raise BadInput.single("folder", "", text)
    with named_as_argument():
        nominal = CampaignJob.of(job_of(*names, settings, stored.seed, stored.duration_s)).nominal
    if campaign_digest(nominal.scenario.value, nominal.rig.value) != stored.digest:
        text = f"{folder}: {' or '.join(names)} has changed since: run the campaign again"
        raise BadInput.single("folder", "", text)
    return Campaign(nominal, cases.summary, cases.table, Path(folder))


def _is_text(value: str) -> bool:
    """Return whether ``value`` of a setting is neither number, truth value nor list of them."""
    return re.fullmatch(r"[-+0-9.eE\[\], ]*|true|false|inf|nan", value) is None


class StudyResults:
    """Results of a study of many cases.

    summary: the content of ``summary.json``, by its keys. cases: pyarrow table with one row per case. job: the nominal
    run. folder: of the results, None if they are not kept.
    """

    def __init__(self, job: Job, summary: dict[str, Any], cases: pa.Table | None, folder: Path | None) -> None:
        self.job = job
        self.summary = summary
        self.cases = cases
        self.folder = folder

    def run_case(self, case: int) -> Run:
        """Return case number ``case``, run again in full detail with the same bits.

        Raises BadInput for a number that has no case, and for a study whose folder was not given.
        """
        if self.folder is None:
            raise BadInput.single("case", "", "the study has no folder: give out")
        job, campaign_seed, _ = job_of_stored_case(self.job, self.folder, case)
        compile_kernels(job, log.warning)
        return run_job(RunRequest(job, job.rig.value.name, more={"campaign_seed": campaign_seed, "case": case}))

    def __repr__(self) -> str:
        number = 0 if self.cases is None else len(self.cases)
        return f"<StudyResults {self.summary['scenario']}: {number} cases>"


class Comparison:
    """Two campaigns with the same cases. summary: second minus first, by the keys of ``comparison.json``."""

    def __init__(self, first: Campaign, second: Campaign, summary: dict[str, Any]) -> None:
        self.first, self.second, self.summary = first, second, summary

    @property
    def difference(self) -> dict[str, Any]:
        """Mean difference of each outcome, ``mean``, its 95 % interval, ``low``, ``high``, ``n`` and both means."""
        difference: dict[str, Any] = self.summary["difference"]
        return difference

    @property
    def settings(self) -> dict[str, tuple[Any, Any]]:
        """Keys of the scenario that differ, with the values of the first and of the second."""
        return settings_of_both(self.first.job.scenario.value, self.second.job.scenario.value)

    def to_pandas(self) -> Any:
        """Return a DataFrame of ``difference``, indexed by the outcomes. Raises BadInput without pandas."""
        return library("pandas").DataFrame(self.difference).T

    def __repr__(self) -> str:
        rates = self.summary["accepted_rate"]
        first, second = (rates[name]["passed"] for name in ("first", "second"))
        names = f"{self.summary['second']} against {self.summary['first']}"
        names += shown(self.settings)
        return f"<Comparison {names}: {second} and {first} of {self.summary['runs']} accepted>"


@overload
def compare(first: Campaign, second: Campaign) -> Comparison: ...


@overload
def compare(first: Run, second: Run) -> RunComparison: ...


@public
def compare(first: Run | Campaign, second: Run | Campaign) -> Comparison | RunComparison:
    """Return the comparison of two runs, recordings or campaigns, the second against the first.

    Of campaigns the paired differences, case by case. Raises BadInput if they do not have the same seed and number of
    cases, and for a run with a campaign.
    """
    if isinstance(first, Run) and isinstance(second, Run):
        return RunComparison(first, second)
    if isinstance(first, Run) or isinstance(second, Run):
        raise BadInput.single("compare", "", "a run and a campaign: give two runs or recordings, or two campaigns")
    if first.job.seed != second.job.seed or len(first.cases) != len(second.cases):
        shown_of = [f"seed {each.job.seed} with {len(each.cases)} cases" for each in (first, second)]
        text = f"{' and '.join(shown_of)}: both campaigns must have the same seed and number of cases"
        raise BadInput.single("compare", "", text)
    names = (first.summary["scenario"], second.summary["scenario"])
    return Comparison(first, second, compare_columns(first, second, names))


class SweepResults:
    """Campaigns along the values of one key. values: of the key; campaigns: in their order; summary: ``sweep.json``."""

    def __init__(self, sweep: Sweep, campaigns: Sequence[Campaign]) -> None:
        self.key, self.values, self.campaigns = sweep.key, sweep.values, list(campaigns)
        self.summary: dict[str, Any] = sweep_summary(sweep, self.campaigns)

    def figure(self) -> Figure:
        """Return rate of accepted cases and propellant along the values."""
        from hil.parts.campaigns.figure import sweep_figure  # slow import

        return sweep_figure(self.summary)

    def to_pandas(self) -> Any:
        """Return a DataFrame with one row per value: rates and means. Raises BadInput without pandas."""
        from hil.api.frames import library

        rows = [
            {
                "value": point["value"],
                **{name: point[name]["rate"] for name in ("accepted_rate", "pass_rate")},
                **{name: part["mean"] for name, part in point.items() if isinstance(part, dict) and "mean" in part},
            }
            for point in self.summary["points"]
        ]
        return library("pandas").DataFrame(rows).set_index("value")

    def __repr__(self) -> str:
        return f"<SweepResults {self.key}: {len(self.values)} values, {len(self.campaigns[0].cases)} cases each>"
