"""Campaigns: ``hil.campaign``, its results, and the job of one of its cases."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack, overload

from hil.api.frames import library
from hil.api.jobs import BackendArguments, Overrides, check_count, named_as_argument, settings_of
from hil.api.results import Run
from hil.api.runs import RunRequest, log, run_or_raise
from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.errors import BadInput
from hil.gnc_backends.backend import PARTS
from hil.maths.random_streams import MixedSeed
from hil.monte_carlo.campaign import RIG, Sweep, campaign_digest
from hil.monte_carlo.dispersions import Design, case_seed
from hil.monte_carlo.sobol_indices import sobol_point
from hil.monte_carlo.stored_campaign import StoredCampaign
from hil.session.warm_up import compile_kernels
from hil.setup.assembly import Job

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure


class CampaignArguments(BackendArguments, total=False):
    """Further arguments of ``hil.campaign``. scheduler: address of a Dask scheduler. dispersions: set or file."""

    scheduler: str | None
    dispersions: str | Path | None


class StudyArguments(CampaignArguments, total=False):
    """Arguments with which ``hil.campaign`` does what the command does with the option of that name."""

    against: str | Path | Scenario | None
    sweep: str | Sweep | None
    rare: str | None
    method: str
    sobol: int | None


@overload
def campaign(
    scenario: str | Path | Scenario,
    runs: int,
    out: str | Path | None = None,
    seed: int = 0,
    duration_s: float | None = None,
    overrides: Overrides | None = None,
    workers: int = 0,
    engine: str = "cpu",
    **options: Unpack[CampaignArguments],
) -> Campaign: ...


@overload
def campaign(
    scenario: str | Path | Scenario,
    runs: int | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    duration_s: float | None = None,
    overrides: Overrides | None = None,
    workers: int = 0,
    engine: str = "cpu",
    **options: Unpack[StudyArguments],
) -> Any: ...


def campaign(
    scenario: str | Path | Scenario,
    runs: int | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    duration_s: float | None = None,
    overrides: Overrides | None = None,
    workers: int = 0,
    engine: str = "cpu",
    **options: Unpack[StudyArguments],
) -> Any:
    """Run many cases of a scenario with its dispersions on the mock rig, in the compiled loop.

    Parameters
    ----------
    scenario
        ``scheme-1``, ``scheme-2``, ``scheme-3``, the path of a TOML file, or a Scenario; ``[dispersions]`` in it sets
        what varies.
    runs
        Number of cases, numbered from 0. A case depends on its number and the seed only.
    out
        Folder for the results, in which a partial campaign is resumed; None for a temporary one.
    seed
        Seed of the whole campaign.
    duration_s
        Time of each run, s; None for the scenario's.
    overrides
        Dotted keys or nested tables to values, as for ``hil.run``.
    workers
        Number of processes, of threads that draw the noise for a GPU; 0: one per core.
    engine
        ``cpu``, or ``cuda`` (experimental): a GPU of NVIDIA. Cases of both are not mixed in a folder.
    options
        ``navigation=``, ``control=``: backends in place of the scenario's, as for ``hil.run``. Each case has a new
        object of a class, and a copy of an object. A case whose object raises has failed;
        ``summary["first_error"]`` has the first traceback. ``scheduler=``: address of a Dask scheduler, whose workers
        are used. ``dispersions=``: a set or a file, instead of the scenario's. ``against=``: a second scenario, which
        returns a Comparison; ``sweep="key=low:high:n"`` returns SweepResults; ``rare="column > number"`` with
        ``method=``, and ``sobol=rows`` return StudyResults.

    Raises
    ------
    BadInput
        Invalid arguments, with one line per error.
    CampaignStopped
        The disk is full, or cases of a GPU differ from those of the CPU: completed cases are kept.
    """
    from hil.api.campaign_request import CampaignRequest  # imports this module

    for name, value, least in (("runs", runs, 1), ("workers", workers, 0), ("sobol", options.get("sobol"), 1)):
        check_count(name, value, least)
    given: dict[str, Any] = dict(options)
    backends: Any = {part: given.pop(part) for part in PARTS if part in given}
    if (dispersions := given.pop("dispersions", None)) is not None:
        overrides = {"dispersions": str(dispersions), **(overrides or {})}
    given |= {"seed": seed, "duration_s": duration_s, "workers": workers, "engine": engine, "backends": backends}
    with named_as_argument():
        folder = None if out is None else Path(out)
        return CampaignRequest(scenario, settings_of(overrides), runs, folder, **given).run()


class Campaign:
    """Results of a campaign.

    summary: the numbers of ``hil campaign --json``, by its keys: pass rates, worst cases, percentiles, causes.
    cases: pyarrow table with one row per case: number, seed, sampled dispersions, verdict and outcomes, SI
    (``cases.to_pandas()`` if pandas is installed). job: the nominal run.
    """

    def __init__(self, job: Job, summary: dict[str, Any], cases: pa.Table) -> None:
        self.job = job
        self.summary = summary
        self.cases = cases

    @property
    def accepted_rate(self) -> dict[str, float | int]:
        """Fraction of the cases that are accepted: completed, not aborted, all parts that the scenario requires.

        Keys as of ``pass_rate``.
        """
        found: dict[str, float | int] = self.summary["pass_rate"]["accepted"]
        return found

    @property
    def pass_rate(self) -> dict[str, float | int]:
        """Fraction of the cases that pass Table III.

        rate: the fraction; low, high: Wilson's 95 % interval; passed, runs: the numbers.
        """
        found: dict[str, float | int] = self.summary["pass_rate"]["passed"]
        return found

    def column(self, name: str) -> Any:
        """Return one column of the cases as a numpy array, (n,); missing numbers are nan. Raises BadInput."""
        if name not in self.cases.column_names:
            known = ", ".join(self.cases.column_names)
            raise BadInput.single("campaign", name, f"no such column: give one of {known}")
        return self.cases.column(name).to_numpy()

    def why(self, case: int | None = None) -> dict[str, Any]:
        """Return why cases fail, by the keys of ``hil explain --json``: ``causes``, ``drivers``, ``score`` and others.

        case: number of a case; the result then has its margins and the nearest case that passes. Raises BadInput.
        """
        from hil.monte_carlo.explain import case_of, explain  # slow import

        names = Design(self.job.scenario, self.job.seed).names
        return explain(self.column, names) if case is None else case_of(self.cases, case, self.job.scenario.value.name)

    def run_case(self, case: int) -> Run:
        """Return case number ``case``, run again in full detail. Raises BadInput for a number that has no case."""
        if case not in range(len(self.cases)):
            raise BadInput.single("case", "", f"{case!r:.60}: must be 0 to {len(self.cases) - 1}")
        job = job_of_case(self.job, case)
        compile_kernels(job, log.warning)
        return run_or_raise(RunRequest(job, RIG, more={"campaign_seed": self.job.seed, "case": case}))

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
        from hil.monte_carlo.figure import percentiles_figure  # slow import

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


def job_of_case(job: Job, case: int, mixed: MixedSeed | None = None, unit: Array | None = None) -> Job:
    """Return the job of a campaign's case: its true scenario, that of the GNC, and its own seed.

    mixed: that seed in a campaign of a rare event or of Sobol' indices. unit: in the latter, the point of the dispersed
    numbers in the unit cube.
    """
    design = Design(job.scenario, job.seed)
    truth, known = design.apply(design.values(case, mixed, unit), design.fault(case))
    known = known.model_copy(update={"faults": truth.faults})
    seed = case_seed(job.seed, case) if mixed is None else mixed
    return replace(job, scenario=replace(job.scenario, value=known), seed=seed, dispersed=truth)


def job_of_stored_case(job: Job, folder: Path, case: int) -> tuple[Job, int, str]:
    """Return the job of a case of the campaign in ``folder``, the campaign's seed, and a note if the scenario differs.

    job: the nominal run; seed and duration are those of the campaign. Raises BadInput.
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
        note = f"{folder}: its campaign has another scenario, rig or settings: the run differs from its case {case}"
    return job_of_case(job, case, mixed, unit), stored.seed, note
