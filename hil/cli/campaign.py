"""``hil campaign``: Monte Carlo campaign of one scenario, a comparison of two, or a sweep of a key."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from rich.console import Console
from rich.table import Table

from hil.cli.options import (
    RUNS_MAX,
    Group,
    Integer,
    OptionalInteger,
    Output,
    Settings,
    at_least,
    at_most,
    duration_problems,
    refuse,
)
from hil.cli.output import check_json_path, write_json
from hil.cli.progress import ProgressBar
from hil.errors import Problem

if TYPE_CHECKING:
    from hil.monte_carlo.campaign import CampaignJob, Progress, Sweep
    from hil.monte_carlo.engines import Engine
    from hil.monte_carlo.store import Store

_DONE, _NOT_SHOWN = 0, 1
_LEAST_ROWS: Final = 10
_CAUSES: Final = 3  # clusters of failures that are printed; ``hil explain`` prints all
_LEAST_CASES: Final = {"subset": 500, "importance": 200}  # of --rare by --method
_FLAG_LABELS: Final = {"passed": "Table III", "passed_all_parts": "all parts"}
_UNITS = {"position_m": "m", "velocity_mps": "m/s", "attitude_deg": "deg", "rate_degps": "deg/s"}


@dataclass(frozen=True)
class EngineOptions:
    """Options of the workers."""

    workers: Integer = 0
    """Number of processes on this computer; 0: one per core."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://host:8786, whose workers are used instead."""
    engine: str = "cpu"
    """cpu, or cuda (experimental): a GPU of NVIDIA; --workers is then the number of threads that draw the noise."""

    def problems(self) -> list[Problem]:
        """Return a problem for each option that cannot be used."""
        from hil.monte_carlo.engines import ENGINES

        found = at_least(workers=(self.workers, 0))
        if self.scheduler is not None and self.workers:
            found.append(Problem("--workers", "", "not together with --scheduler, which has its own workers"))
        if self.engine not in ENGINES:
            found.append(Problem("--engine", "", f"{self.engine}: must be one of {', '.join(ENGINES)}"))
        elif self.on_gpu and self.scheduler is not None:
            found.append(Problem("--engine", "", "cuda: not together with --scheduler"))
        return found

    @property
    def on_gpu(self) -> bool:
        """Whether a GPU runs the cases."""
        return self.engine == "cuda"

    @property
    def identity(self) -> dict[str, str]:
        """Part of the identity of a campaign."""
        from hil.monte_carlo.engines import engine_identity

        return engine_identity(self.engine)

    def start(self, campaigns: Sequence[CampaignJob]) -> Engine:
        """Return the engine that runs the cases of ``campaigns``. Raises BadInput."""
        from hil.monte_carlo.engines import DaskEngine, engine_of

        if self.scheduler:
            return DaskEngine(self.scheduler)
        return engine_of(self.engine, self.workers, [each.scenario for each in campaigns])


@dataclass(frozen=True)
class VariationOptions:
    """Options of a second scenario or a sweep."""

    against: str | None = None
    """A second scenario, run with the same seeds: differences with confidence intervals."""
    sweep: str | None = None
    """key=low:high:n, as gnc.control.deadband_m=0.002:0.02:10: one campaign per value."""

    def problems(self) -> list[Problem]:
        """Return a problem if both are given."""
        both = self.against is not None and self.sweep is not None
        return [Problem("--against", "", "not together with --sweep")] if both else []

    def folders(self, out: Path, number: int) -> list[Path]:
        """Return the folders of ``number`` campaigns."""
        if number == 1:
            return [out]
        pair = self.against is not None
        return [out / name for name in (("first", "second") if pair else (f"sweep-{i:03d}" for i in range(number)))]


@dataclass(frozen=True)
class CaseOptions:
    """Options of the cases."""

    runs: OptionalInteger = None
    """Number of cases, numbered from 0; with --rare of each level, 1000 unless given, by --method importance 2000."""
    seed: Integer = 0
    """Seed of the whole campaign."""
    duration: float | None = None
    """Run time in seconds, instead of the scenario's."""
    dispersions: str | None = None
    """Dispersion set, instead of the scenario's: shipped, stress, or the path of a file."""
    settings: Settings = ()

    def all_settings(self) -> Settings:
        """Return the settings, with the dispersion set before the others, which may change it."""
        return self.settings if self.dispersions is None else (f"dispersions={self.dispersions}", *self.settings)

    def problems(self) -> list[Problem]:
        """Return a problem for each option that is out of range."""
        runs = {} if self.runs is None else {"runs": (self.runs, 1)}
        most = {} if self.runs is None else {"runs": (self.runs, RUNS_MAX)}
        return at_least(**runs, seed=(self.seed, 0)) + at_most(**most) + duration_problems(self.duration)


@dataclass(frozen=True)
class StudyOptions:
    """Options of a rare event, or of Sobol' indices."""

    rare: str | None = None
    """Probability of an event, as "position_m_x > 0.0058", over dispersions and noise."""
    method: str = "subset"
    """Of --rare: subset, simulation in levels; importance, sampling with weights, for largest deviations only."""
    sobol: OptionalInteger = None
    """Number of rows for Sobol' indices of each dispersed number and the noise: rows x (numbers + 3) cases."""

    def problems(self, cases: CaseOptions, variation: VariationOptions) -> list[Problem]:
        """Return a problem for each option that cannot be used."""
        if self.rare is None and self.sobol is None:
            text = "must be given, unless --rare or --sobol is"
            return [] if cases.runs is not None else [Problem("--runs", "", text)]
        option = "--sobol" if self.rare is None else "--rare"
        found = []
        if self.sobol is not None:
            found += at_least(sobol=(self.sobol, _LEAST_ROWS))
            if self.rare is not None or cases.runs is not None:
                found.append(Problem("--sobol", "", "not together with --rare or --runs"))
        least = _LEAST_CASES.get(self.method, 1)
        if self.rare is not None and cases.runs is not None and cases.runs < least:
            each = " per level" if self.method == "subset" else ""
            text = f"{cases.runs}: too few for the probability of a rare event, at least {least}{each}"
            found.append(Problem("--runs", "", text))
        if variation != _ONE_SCENARIO:
            found.append(Problem(option, "", "not together with --against or --sweep"))
        return found


_ENGINE_DEFAULTS, _ONE_SCENARIO, _NO_STUDY = EngineOptions(), VariationOptions(), StudyOptions()
_DEFAULT_CASES = CaseOptions()


def campaign(
    scenario: str,
    /,
    *,
    out: Output,
    cases: Group[CaseOptions] = _DEFAULT_CASES,
    study: Group[StudyOptions] = _NO_STUDY,
    workers: Group[EngineOptions] = _ENGINE_DEFAULTS,
    variation: Group[VariationOptions] = _ONE_SCENARIO,
    json: Output = None,
) -> int:
    """Run many cases of a scenario with its dispersions on the mock rig: pass rate, worst cases, why cases fail.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file; dispersions in it sets what varies.
    out
        Folder for the results; a partial campaign in it is resumed.
    json
        File for the summary, - for standard output.
    """
    assert out is not None
    problems = cases.problems() + study.problems(cases, variation) + workers.problems() + variation.problems()
    if workers.on_gpu and study.rare is not None and study.method == "importance":
        problems.append(Problem("--engine", "", "cuda: not together with --method importance"))
    refuse(problems + check_json_path("--json", json))

    from hil.monte_carlo.campaign import Sweep, campaigns_of
    from hil.monte_carlo.store import parquet

    parquet()
    if study.rare is not None:
        return _estimate_rare(scenario, cases, study, Path(out), workers, json)
    if study.sobol is not None:
        return _compute_indices(scenario, cases, study.sobol, Path(out), workers, json)
    assert cases.runs is not None
    settings = cases.all_settings()
    sweep = None if variation.sweep is None else Sweep.parse(variation.sweep)
    console = Console(stderr=True)
    with console.status("checking the scenario"):
        campaigns: list[CampaignJob] = campaigns_of(scenario, settings, cases.seed, cases.duration, sweep)
        if variation.against is not None:
            campaigns += campaigns_of(variation.against, settings, cases.seed, cases.duration, None)
    folders = variation.folders(Path(out), len(campaigns))
    engine = workers.start(campaigns)
    with ExitStack() as held:
        held.callback(engine.close)

        def warn(line: str) -> None:
            console.print(line, style="yellow", highlight=False, soft_wrap=True, markup=False)

        pairs = zip(campaigns, folders, strict=True)
        stores = [held.enter_context(each.store(folder, warn, workers.identity)) for each, folder in pairs]
        with console.status("compiling the loop if it is not cached, up to two minutes"):
            campaigns[0].warm_up()
        summaries = _run_all(campaigns, stores, cases.runs, engine, console)
        if sweep is not None:
            found = _sweep_results(sweep, stores, summaries, cases.runs, Path(out))
        elif variation.against is not None:
            found = _comparison((scenario, variation.against), stores, summaries, Path(out))
        else:
            found = dict(summaries[0])
    if json != "-":
        _render(found, Console())
        Console().print(f"results in {out}", highlight=False, soft_wrap=True)
    if json is not None:
        write_json(found, json)
    return _DONE if all(each["verdict"] == "verified" for each in found.get("requirements", ())) else _NOT_SHOWN


class StudyFolder(NamedTuple):
    """Results folder of a study. identity, columns: as for ``CampaignJob.store``."""

    path: Path
    identity: dict[str, Any]
    columns: Sequence[str] = ()


def _job(scenario: str, cases: CaseOptions) -> CampaignJob:
    from hil.monte_carlo.campaign import campaigns_of

    with Console(stderr=True).status("checking the scenario"):
        return campaigns_of(scenario, cases.all_settings(), cases.seed, cases.duration, None)[0]


def _run_study(
    job: CampaignJob,
    folder: StudyFolder,
    workers: EngineOptions,
    run: Callable[[CampaignJob, Store, Engine, ProgressBar], dict[str, Any]],
) -> dict[str, Any]:
    """Return what ``run`` returns for the store of ``folder`` and the engine of ``workers``."""
    console, engine = Console(stderr=True), workers.start([job])

    def warn(line: str) -> None:
        console.print(line, style="yellow", highlight=False, soft_wrap=True, markup=False)

    with ExitStack() as held:
        held.callback(engine.close)
        identity = folder.identity | workers.identity
        store = held.enter_context(job.store(folder.path, warn, identity, folder.columns))
        with console.status("compiling the loop if it is not cached, up to two minutes"):
            job.warm_up()
        return run(job, store, engine, held.enter_context(ProgressBar(console, "campaign")))


def _compute_indices(
    scenario: str, cases: CaseOptions, rows: int, out: Path, workers: EngineOptions, json: str | None
) -> int:
    """Compute Sobol' indices; return the exit code."""
    from hil.monte_carlo.figure import draw_indices
    from hil.monte_carlo.sobol_campaign import SobolCampaign

    job = _job(scenario, cases)
    campaign = SobolCampaign(job, rows)

    def run(job: CampaignJob, store: Store, engine: Engine, bar: ProgressBar) -> dict[str, Any]:
        def watch(now: Progress) -> None:
            text = f"{now.title} {now.done} of {now.runs} cases, {now.speed:.0f} x real time"
            bar.show(text, now.done / now.runs)

        return campaign.run(store, engine, watch)

    summary = _run_study(job, StudyFolder(out, campaign.identity()), workers, run)
    draw_indices(summary, out / "sobol.png")
    if json != "-":
        _render_indices(summary, Console())
        Console().print(f"results in {out}", highlight=False, soft_wrap=True)
    if json is not None:
        write_json(summary, json)
    return _DONE


def _render_indices(summary: dict[str, Any], console: Console) -> None:
    for outcome, found in summary["sobol"].items():
        rows = Table(title=f"Sobol' indices of {outcome}, {summary['cases']} cases", title_justify="left")
        for column in ("", "first order", "95 %", "total", "95 %"):
            rows.add_column(column, justify="right" if column else "left", overflow="fold")
        for row in found[:5]:
            cells = []
            for kind in ("first", "total"):
                index = row[kind]
                known = index["index"] is not None
                cells += [f"{index['index']:.3f}", f"{index['low']:.3f} .. {index['high']:.3f}"] if known else ["-", ""]
            rows.add_row(row["dispersion"], *cells)
        console.print(rows)


def _estimate_rare(
    scenario: str, cases: CaseOptions, study: StudyOptions, out: Path, workers: EngineOptions, json: str | None
) -> int:
    """Estimate the probability of a rare event; return the exit code."""
    from hil.monte_carlo.rare_campaign import verdict_line
    from hil.monte_carlo.rare_events import RareEvent
    from hil.monte_carlo.rare_methods import settings_of

    assert study.rare is not None
    settings = settings_of(study.method, RareEvent.parse(study.rare), cases.runs)

    def run(job: CampaignJob, store: Store, engine: Engine, bar: ProgressBar) -> dict[str, Any]:
        def watch(now: Progress) -> None:
            speed = f", {now.speed:.0f} x real time" if now.speed else ""
            bar.show(f"{now.title} {now.done} cases{speed}", now.done / now.runs if now.runs else 0.0)

        return settings.run(job, store, engine, watch)

    summary = _run_study(_job(scenario, cases), StudyFolder(out, settings.identity(), settings.columns), workers, run)
    if json != "-":
        _render_rare(summary, verdict_line(summary["rare"]), Console())
        Console().print(f"results in {out}", highlight=False, soft_wrap=True)
    if json is not None:
        write_json(summary, json)
    return _DONE if summary["rare"]["probability"] is not None else _NOT_SHOWN


def _render_rare(summary: dict[str, Any], verdict: str, console: Console) -> None:
    rare = summary["rare"]
    if rare["levels"]:
        _render_levels(summary, console)
    console.print(verdict, highlight=False, soft_wrap=True)
    if rare["without_value"]:
        text = f"{rare['without_value']} cases have no {rare['outcome']}: counted as not met"
        console.print(text, highlight=False, soft_wrap=True)
    if rare["failing"]:
        shown = ", ".join(f"{row['case']} ({row['value']:.5g})" for row in rare["failing"][:5])
        console.print(f"{rare['failing_cases']} cases met it: {shown}", highlight=False, soft_wrap=True)
    for row in rare.get("noise", ()):
        halved_by = (
            "" if row["halved_by"] is None else f", with {100.0 * row['halved_by']:.0f} % of it half the probability"
        )
        console.print(f"{100.0 * row['part']:.0f} % from {row['noise']}{halved_by}", highlight=False, soft_wrap=True)
    drivers = ", ".join(f"{row['dispersion']} {row['mean_sigma']:+.2f}" for row in rare["drivers"][:5])
    if drivers:
        console.print(f"mean of the dispersions there, in sigma: {drivers}", highlight=False, soft_wrap=True)
    halved = [row for row in rare["drivers"] if row["halved_by"] is not None]
    if halved:
        text = f"{halved[0]['dispersion']} with {100.0 * halved[0]['halved_by']:.0f} % of its spread"
        console.print(f"least change that halves the probability: {text}", highlight=False, soft_wrap=True)


def _render_levels(summary: dict[str, Any], console: Console) -> None:
    rare = summary["rare"]
    rows = Table(title=f"{summary['scenario']}: {rare['method']}", title_justify="left")
    for column in ("level", "from", "fraction above the next", "c.o.v.", "acceptance"):
        rows.add_column(column, justify="right")
    for i, level in enumerate(rare["levels"]):
        cells = (
            "-" if level[name] is None else f"{level[name]:.4g}" for name in ("bound", "fraction", "cov", "acceptance")
        )
        rows.add_row(str(i), *cells)
    console.print(rows)


def _run_all(
    campaigns: Sequence[CampaignJob], stores: Sequence[Store], runs: int, engine: Engine, console: Console
) -> list[dict[str, Any]]:
    """Run the campaigns one after the other; return their summaries."""
    from hil.monte_carlo.figure import draw_integrity, draw_percentiles
    from hil.monte_carlo.page import write_page

    summaries = []
    with ProgressBar(console, "campaign") as bar:
        for i, (each, store) in enumerate(zip(campaigns, stores, strict=True)):

            def watch(now: Progress, i: int = i) -> None:
                fraction = (i + now.done / now.runs) / len(campaigns)
                bar.show(f"{now.title} {now.done} of {now.runs} cases, {now.speed:.0f} x real time", fraction)

            summaries.append(each.run(store, runs, engine, watch))
            draw_percentiles(store, each.scenario.value, store.folder / "percentiles.png")
            draw_integrity(store, store.folder / "stanford.png")
            write_page(store.folder)
    return summaries


def _sweep_results(
    sweep: Sweep, stores: Sequence[Store], summaries: Sequence[dict[str, Any]], runs: int, out: Path
) -> dict[str, Any]:
    from hil.monte_carlo.campaign import sweep_summary, write_summary
    from hil.monte_carlo.figure import draw_sweep
    from hil.monte_carlo.page import write_page

    found = sweep_summary(sweep, stores)
    draw_sweep(found, out / "sweep.png")
    write_summary(out / "sweep.json", found)
    write_page(out)
    return {"scenario": summaries[0]["scenario"], "runs": runs, "seed": summaries[0]["seed"], "sweep": found}


def _comparison(
    names: tuple[str, str], stores: Sequence[Store], summaries: Sequence[dict[str, Any]], out: Path
) -> dict[str, Any]:
    from hil.monte_carlo.campaign import compare_stores, write_summary
    from hil.monte_carlo.page import write_page

    found = compare_stores((names[0], stores[0]), (names[1], stores[1]))
    write_summary(out / "comparison.json", found)
    write_page(out)
    return {"first": summaries[0], "second": summaries[1], "comparison": found}


def _render(found: dict[str, Any], console: Console) -> None:
    if "sweep" in found:
        _render_sweep(found["sweep"], console)
    elif "comparison" in found:
        for summary in (found["first"], found["second"]):
            _render_summary(summary, console)
        _render_comparison(found["comparison"], console)
    else:
        _render_summary(found, console)


def _rate_text(rate: dict[str, Any]) -> str:
    return (
        f"{rate['passed']} of {rate['runs']}, {100.0 * rate['rate']:.2f} % "
        f"({100.0 * rate['low']:.2f} .. {100.0 * rate['high']:.2f})"
    )


def _title(summary: dict[str, Any]) -> str:
    dispersions = summary["dispersions"]
    return f"{summary['scenario']}, dispersions {dispersions}" if dispersions else str(summary["scenario"])


def _render_summary(summary: dict[str, Any], console: Console) -> None:
    from hil.config.required_parts import PART_COLUMNS
    from hil.report.requirements_page import limit_text, result_text

    rows = Table(title=f"{_title(summary)}: worst of {summary['runs']} cases", title_justify="left")
    for column in ("", "axis", "worst", "case", "Table V"):
        rows.add_column(column, justify="left" if column in ("", "axis") else "right")
    for name, axes in summary["worst"].items():
        for i, (axis, cell) in enumerate(zip("xyz", axes, strict=True)):
            rows.add_row(
                f"{name.split('_')[0]}, {_UNITS[name]}" if i == 0 else "",
                axis,
                "-" if cell["value"] is None else f"{cell['value']:.4g}",
                "-" if cell["case"] is None else str(cell["case"]),
                "-" if cell["table_v"] is None else f"{cell['table_v']:.4g}",
                end_section=i == 2,
            )
    console.print(rows)
    parts = {column: name.replace("_", " ") for name, column in PART_COLUMNS.items()} | _FLAG_LABELS
    not_required = [name.replace("_", " ") for name in PART_COLUMNS if name not in summary["required_parts"]]
    beside = f"; not required: {', '.join(not_required)}" if not_required else ""
    for name, rate in summary["pass_rate"].items():
        more = f", Wilson {summary['confidence']:.0%}{beside}" if name == "accepted" else ""
        console.print(f"{parts.get(name, name):<15}{_rate_text(rate)}{more}", highlight=False, soft_wrap=True)
    for name, unit in (("ready_time_s", "s"), ("propellant_kg", "kg"), ("firings", "")):
        spread = summary["percentiles"][name]
        if spread["n"]:
            console.print(
                f"{name:<15} 5 % {spread['p5']:.4g}, median {spread['p50']:.4g}, 95 % {spread['p95']:.4g}, "
                f"greatest {spread['greatest']:.4g} {unit}",
                highlight=False,
            )
    for stop in summary["stops"][:5]:
        console.print(
            f"{stop['cases']} x {stop['reason']} (first: case {stop['first_case']})", highlight=False, soft_wrap=True
        )
    for found in summary["requirements"]:
        text = f"{found['id']}: {found['verdict']}: {limit_text(found)}: {result_text(found)}"
        console.print(text, highlight=False, soft_wrap=True, markup=False)
    why = summary["why"]
    for cause in why["causes"][:_CAUSES]:
        console.print(f"why: {cause['text']}", highlight=False, soft_wrap=True, markup=False)
    if why["failed"] and why["nothing_found"]:
        console.print("no dispersed number predicts the failures better than chance", highlight=False)


def _render_comparison(found: dict[str, Any], console: Console) -> None:
    rows = Table(title=f"{found['second']} minus {found['first']}, the same cases", title_justify="left")
    for column in ("", found["first"], found["second"], "difference", f"{found['confidence']:.0%} interval"):
        rows.add_column(column, justify="right" if column else "left")
    for name, cell in found["difference"].items():
        if cell["low"] is None:
            continue
        rows.add_row(
            name,
            f"{cell['first_mean']:.4g}",
            f"{cell['second_mean']:.4g}",
            f"{cell['mean']:+.3g}",
            f"{cell['low']:+.3g} .. {cell['high']:+.3g}",
        )
    console.print(rows)
    for word, rate in (("accepted", found["accepted_rate"]), ("Table III", found["pass_rate"])):
        cases = ", ".join(f"of {found[each]} alone {rate[f'{each}_alone']}" for each in ("first", "second"))
        console.print(f"{word:<12}{cases} cases", highlight=False, soft_wrap=True)


def _render_sweep(found: dict[str, Any], console: Console) -> None:
    rows = Table(title=f"sweep of {found['key']}", title_justify="left")
    for column in ("value", "accepted", "propellant, kg", "firings", "ready, s"):
        rows.add_column(column, justify="right")
    for point in found["points"]:
        means = (point[name]["mean"] for name in ("propellant_kg", "firings", "ready_time_s"))
        cells = ("-" if mean is None else f"{mean:.4g}" for mean in means)
        rows.add_row(f"{point['value']:.6g}", _rate_text(point["accepted_rate"]), *cells)
    console.print(rows)
