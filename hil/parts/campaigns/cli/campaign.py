"""``hil campaign``: Monte Carlo campaign of one scenario, a comparison of two, a sweep of a key, or a study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from rich.console import Console
from rich.table import Table

from hil.cli import options
from hil.cli.output import notices, say, write_json
from hil.cli.progress import ProgressBar

if TYPE_CHECKING:
    from hil.parts.campaigns.api.campaign_request import CampaignRequest, Results

_DONE, _NOT_SHOWN = 0, 1
_CAUSES: Final = 3  # clusters of failures that are printed; ``hil explain`` prints all
_FLAG_LABELS: Final = {"passed": "Table III", "passed_all_parts": "all parts"}
_LEAST_ROWS: Final = 10
SobolRows = Annotated[options.OptionalInteger, options.bounded(_LEAST_ROWS)]
_UNITS = {"position_m": "m", "velocity_mps": "m/s", "attitude_deg": "deg", "rate_degps": "deg/s"}


@dataclass(frozen=True)
class EngineOptions:
    """Options of the workers."""

    workers: options.Workers = 0
    """Number of processes on this computer; 0: one per core."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://host:8786, whose workers are used instead."""


@dataclass(frozen=True)
class VariationOptions:
    """Options of the rig, of a second scenario or a sweep."""

    against: str | None = None
    """A second scenario, run with the same seeds: differences with confidence intervals."""
    sweep: str | None = None
    """key=low:high:n, as gnc.control.deadband_m=0.002:0.02:10: one campaign per value."""
    rig: str = "mock"
    """Rig in memory: mock, mock-planar, mock-floating, or the path of a rig file."""


@dataclass(frozen=True)
class CaseOptions:
    """Options of the cases."""

    runs: options.OptionalRuns = None
    """Number of cases, numbered from 0; with --rare of each level, 1000 unless given, by --method importance 2000."""
    seed: options.Seed = 0
    """Seed of the whole campaign."""
    duration: options.OptionalSeconds = None
    """Run time in seconds, instead of the scenario's."""
    dispersions: str | None = None
    """Dispersion set, instead of the scenario's: shipped, stress, or the path of a file."""
    settings: options.Settings = ()


@dataclass(frozen=True)
class StudyOptions:
    """Options of a rare event, or of Sobol' indices."""

    rare: str | None = None
    """Probability of an event, as "position_m_x > 0.0058", over dispersions and noise."""
    method: str = "subset"
    """Of --rare: subset, simulation in levels; importance, sampling with weights, for largest deviations only."""
    sobol: SobolRows = None
    """Number of rows for Sobol' indices of each dispersed number and the noise: rows x (numbers + 3) cases."""


_ENGINE_DEFAULTS, _ONE_SCENARIO, _NO_STUDY = EngineOptions(), VariationOptions(), StudyOptions()
_DEFAULT_CASES = CaseOptions()


def campaign(
    scenario: str,
    /,
    *,
    out: options.Output,
    cases: options.Group[CaseOptions] = _DEFAULT_CASES,
    study: options.Group[StudyOptions] = _NO_STUDY,
    workers: options.Group[EngineOptions] = _ENGINE_DEFAULTS,
    variation: options.Group[VariationOptions] = _ONE_SCENARIO,
    json: options.File = None,
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
    from hil.parts.campaigns.api.campaign_request import CampaignRequest

    assert out is not None
    # the dispersion set comes before the other settings, which may change it
    chosen = () if cases.dispersions is None else (f"dispersions={cases.dispersions}",)
    request = CampaignRequest(
        scenario,
        (*chosen, *cases.settings),
        cases.runs,
        Path(out),
        cases.seed,
        cases.duration,
        **vars(study),
        **vars(workers),
        **vars(variation),
        figures=True,
    )
    console = notices()
    with ProgressBar(console, "campaign") as bar:
        results = request.run(bar.show, lambda line: say(line, console, "yellow"))
    summary = _as_json(results, request)
    if json != "-":
        _render(summary, Console())
        say(f"results in {out}")
    write_json(summary, json)
    if study.rare is not None:
        return _DONE if summary["rare"]["probability"] is not None else _NOT_SHOWN
    return _DONE if all(each["verdict"] == "verified" for each in summary.get("requirements", ())) else _NOT_SHOWN


def _as_json(results: Results, request: CampaignRequest) -> dict[str, Any]:
    """Return the numbers of ``hil campaign --json``."""
    from hil.parts.campaigns.api.campaign_results import Comparison, SweepResults

    if isinstance(results, Comparison):
        return {"first": results.first.summary, "second": results.second.summary, "comparison": results.summary}
    if isinstance(results, SweepResults):
        first = results.campaigns[0].summary
        numbers = {"scenario": first["scenario"], "runs": request.runs, "seed": first["seed"]}
        return {**numbers, "sweep": results.summary}
    return dict(results.summary)


def _render_indices(summary: dict[str, Any], console: Console) -> None:
    for outcome, indices in summary["sobol"].items():
        rows = Table(title=f"Sobol' indices of {outcome}, {summary['cases']} cases", title_justify="left")
        for column in ("", "first order", "95 %", "total", "95 %"):
            rows.add_column(column, justify="right" if column else "left", overflow="fold")
        for row in indices[:5]:
            cells = []
            for kind in ("first", "total"):
                index = row[kind]
                valid = index["index"] is not None
                cells += [f"{index['index']:.3f}", f"{index['low']:.3f} .. {index['high']:.3f}"] if valid else ["-", ""]
            rows.add_row(row["dispersion"], *cells)
        console.print(rows)


def _render_rare(summary: dict[str, Any], console: Console) -> None:
    from hil.parts.campaigns.rare_campaign import verdict_line

    rare = summary["rare"]
    if rare["levels"]:
        _render_levels(summary, console)
    say(verdict_line(rare), console)
    if rare["without_value"]:
        say(f"{rare['without_value']} cases have no {rare['outcome']}: counted as not met", console)
    if rare["failing"]:
        shown = ", ".join(f"{row['case']} ({row['value']:.5g})" for row in rare["failing"][:5])
        say(f"{rare['failing_cases']} cases met it: {shown}", console)
    for row in rare.get("noise", ()):
        halved_by = (
            "" if row["halved_by"] is None else f", with {100.0 * row['halved_by']:.0f} % of it half the probability"
        )
        say(f"{100.0 * row['part']:.0f} % from {row['noise']}{halved_by}", console)
    drivers = ", ".join(f"{row['dispersion']} {row['mean_sigma']:+.2f}" for row in rare["drivers"][:5])
    if drivers:
        say(f"mean of the dispersions there, in sigma: {drivers}", console)
    halved = [row for row in rare["drivers"] if row["halved_by"] is not None]
    if halved:
        text = f"{halved[0]['dispersion']} with {100.0 * halved[0]['halved_by']:.0f} % of its spread"
        say(f"least change that halves the probability: {text}", console)


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


def _render(content: dict[str, Any], console: Console) -> None:
    if "rare" in content:
        _render_rare(content, console)
    elif "sobol" in content:
        _render_indices(content, console)
    elif "sweep" in content:
        _render_sweep(content["sweep"], console)
    elif "comparison" in content:
        for summary in (content["first"], content["second"]):
            _render_summary(summary, console)
        _render_comparison(content["comparison"], console)
    else:
        _render_summary(content, console)


def _rate_text(rate: dict[str, Any]) -> str:
    return (
        f"{rate['passed']} of {rate['runs']}, {100.0 * rate['rate']:.2f} % "
        f"({100.0 * rate['low']:.2f} .. {100.0 * rate['high']:.2f})"
    )


def _title(summary: dict[str, Any]) -> str:
    dispersions = summary["dispersions"]
    return f"{summary['scenario']}, dispersions {dispersions}" if dispersions else str(summary["scenario"])


def _render_summary(summary: dict[str, Any], console: Console) -> None:
    from hil.config.tables.verdict import PART_COLUMNS
    from hil.parts.campaigns.cli.explain import false_alarms_text
    from hil.parts.campaigns.requirements_page import limit_text, result_text

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
        say(f"{parts.get(name, name):<15}{_rate_text(rate)}{more}", console)
    for name, unit in (("ready_time_s", "s"), ("propellant_kg", "kg"), ("firings", "")):
        spread = summary["percentiles"][name]
        if spread["n"]:
            middle = f"5 % {spread['p5']:.4g}, median {spread['p50']:.4g}, 95 % {spread['p95']:.4g}"
            say(f"{name:<15} {middle}, greatest {spread['greatest']:.4g} {unit}", console)
    for stop in summary["stops"][:5]:
        say(f"{stop['cases']} x {stop['reason']} (first: case {stop['first_case']})", console)
    for judged in summary["requirements"]:
        say(f"{judged['id']}: {judged['verdict']}: {limit_text(judged)}: {result_text(judged)}", console)
    why = summary["why"]
    for cause in why["causes"][:_CAUSES]:
        say(f"why: {cause['text']}", console)
    if why["failed"] and why["nothing_found"]:
        say("no dispersed number predicts the failures better than chance", console)
    if text := false_alarms_text(why):
        say(text, console)


def _render_comparison(paired: dict[str, Any], console: Console) -> None:
    rows = Table(title=f"{paired['second']} minus {paired['first']}, the same cases", title_justify="left")
    for column in ("", paired["first"], paired["second"], "difference", f"{paired['confidence']:.0%} interval"):
        rows.add_column(column, justify="right" if column else "left")
    for name, cell in paired["difference"].items():
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
    for word, rate in (("accepted", paired["accepted_rate"]), ("Table III", paired["pass_rate"])):
        cases = ", ".join(f"of {paired[each]} alone {rate[f'{each}_alone']}" for each in ("first", "second"))
        say(f"{word:<12}{cases} cases", console)


def _render_sweep(sweep: dict[str, Any], console: Console) -> None:
    rows = Table(title=f"sweep of {sweep['key']}", title_justify="left")
    for column in ("value", "accepted", "propellant, kg", "firings", "ready, s"):
        rows.add_column(column, justify="right")
    for point in sweep["points"]:
        means = (point[name]["mean"] for name in ("propellant_kg", "firings", "ready_time_s"))
        cells = ("-" if mean is None else f"{mean:.4g}" for mean in means)
        rows.add_row(f"{point['value']:.6g}", _rate_text(point["accepted_rate"]), *cells)
    console.print(rows)
