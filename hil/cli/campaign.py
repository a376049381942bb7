"""``hil campaign``: many closed loops of one scenario, or of two beside each other, or along a key."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.cli.output import check_json_path, write_json
from hil.cli.progress import Bar
from hil.errors import BadInput, Problem

_DONE, _FAILED = 0, 1
_UNITS = {"position_m": "m", "velocity_mps": "m/s", "attitude_deg": "deg", "rate_degps": "deg/s"}


def campaign_command(
    scenario_name: str,
    runs: int,
    seed: int,
    workers: int,
    scheduler: str | None,
    out: str,
    against: str | None,
    sweep_text: str | None,
    duration_s: float | None,
    settings: Sequence[str],
    json_path: str | None,
) -> int:
    """Do ``hil campaign``; return its exit code. Raises BadInput before anything is flown."""
    _check_options(runs, seed, workers, scheduler, against, sweep_text, duration_s, json_path)
    from hil.campaign.campaign import Campaign, Sweep, campaigns_of
    from hil.campaign.engines import DaskEngine, LocalEngine
    from hil.campaign.store import parquet

    parquet()
    sweep = None if sweep_text is None else Sweep.parse(sweep_text)
    console = Console(stderr=True)
    with console.status("checking the scenario"):
        campaigns: list[Campaign] = campaigns_of(scenario_name, settings, seed, duration_s, sweep)
        if against is not None:
            campaigns += campaigns_of(against, settings, seed, duration_s, None)
    folders = _folders(Path(out), len(campaigns), against is not None)
    engine = DaskEngine(scheduler) if scheduler else LocalEngine(workers or len(os.sched_getaffinity(0)))
    with ExitStack() as held:
        held.callback(engine.close)
        stores = [
            held.enter_context(campaign.store(folder)) for campaign, folder in zip(campaigns, folders, strict=True)
        ]
        with console.status("compiling the loop where it is not yet, up to a minute or two"):
            campaigns[0].warm_up()
        found = _fly(campaigns, stores, runs, engine, console, Path(out), scenario_name, against, sweep)
    if json_path is not None:
        write_json(found, json_path)
    if json_path != "-":
        _render(found, Console())
        Console().print(f"results in {out}", highlight=False, soft_wrap=True)
    return _DONE


def _check_options(
    runs: int,
    seed: int,
    workers: int,
    scheduler: str | None,
    against: str | None,
    sweep: str | None,
    duration_s: float | None,
    json_path: str | None,
) -> None:
    problems = [
        Problem(name, "", f"{value}: must be at least {least}")
        for name, value, least in (("--runs", runs, 1), ("--seed", seed, 0), ("--workers", workers, 0))
        if value < least
    ]
    if scheduler is not None and workers:
        problems.append(Problem("--workers", "", "not together with --scheduler, whose workers are the cluster's"))
    if against is not None and sweep is not None:
        problems.append(Problem("--against", "", "not together with --sweep"))
    if duration_s is not None and not (math.isfinite(duration_s) and duration_s > 0.0):
        problems.append(Problem("--duration", "", f"{duration_s:g}: must be a time above 0 s"))
    problems += check_json_path("--json", json_path)
    if problems:
        raise BadInput(problems)


def _folders(out: Path, number: int, pair: bool) -> list[Path]:
    if number == 1:
        return [out]
    return [out / name for name in (("first", "second") if pair else (f"sweep-{i:03d}" for i in range(number)))]


def _fly(
    campaigns: Sequence[Any],
    stores: Sequence[Any],
    runs: int,
    engine: Any,
    console: Console,
    out: Path,
    name: str,
    against: str | None,
    sweep: Any,
) -> dict[str, Any]:
    """Fly all campaigns one after the other; return what is to be shown."""
    from hil.campaign.campaign import Progress, compare_stores, sweep_summary, write_summary
    from hil.campaign.figure import draw_percentiles, draw_sweep

    summaries = []
    with Bar(console, "campaign") as bar:
        for i, (campaign, store) in enumerate(zip(campaigns, stores, strict=True)):

            def watch(now: Progress, i: int = i) -> None:
                share = (i + now.done / now.runs) / len(campaigns)
                bar.tell(f"{now.title} {now.done} of {now.runs} cases, {now.speed:.0f} x real time", share)

            summaries.append(campaign.fly(store, runs, engine, watch))
            draw_percentiles(store, campaign.scenario.value, store.folder / "percentiles.png")
    if sweep is not None:
        found = sweep_summary(sweep, stores)
        draw_sweep(found, out / "sweep.png")
        write_summary(out / "sweep.json", found)
        return {"scenario": summaries[0]["scenario"], "runs": runs, "seed": summaries[0]["seed"], "sweep": found}
    if against is not None:
        found = compare_stores((name, stores[0]), (against, stores[1]))
        write_summary(out / "comparison.json", found)
        return {"first": summaries[0], "second": summaries[1], "comparison": found}
    return dict(summaries[0])


def _render(found: dict[str, Any], console: Console) -> None:
    if "sweep" in found:
        _render_sweep(found["sweep"], console)
    elif "comparison" in found:
        for summary in (found["first"], found["second"]):
            _render_summary(summary, console)
        _render_comparison(found["comparison"], console)
    else:
        _render_summary(found, console)


def _share(rate: dict[str, Any]) -> str:
    return (
        f"{rate['passed']} of {rate['runs']}, {100.0 * rate['rate']:.2f} % "
        f"({100.0 * rate['low']:.2f} .. {100.0 * rate['high']:.2f})"
    )


def _render_summary(summary: dict[str, Any], console: Console) -> None:
    rows = Table(title=f"{summary['scenario']}: worst of {summary['runs']} cases", title_justify="left")
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
    console.print(
        f"pass        {_share(summary['pass_rate']['passed'])}, Wilson {summary['confidence']:.0%}", highlight=False
    )
    console.print(f"all parts   {_share(summary['pass_rate']['passed_all_parts'])}", highlight=False)
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
    for outcome, ranking in summary["sensitivity"].items():
        strong = [row for row in ranking if row["significant"]][:4]
        text = (
            ", ".join(f"{row['dispersion']} {row['rank_correlation']:+.2f}" for row in strong) or "nothing stands out"
        )
        console.print(f"{outcome} hangs on: {text}", highlight=False, soft_wrap=True, markup=False)


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
    rate = found["pass_rate"]
    console.print(
        f"passed by {found['first']} alone {rate['first_alone']}, by {found['second']} alone {rate['second_alone']}",
        highlight=False,
    )


def _render_sweep(found: dict[str, Any], console: Console) -> None:
    rows = Table(title=f"sweep of {found['key']}", title_justify="left")
    for column in ("value", "pass", "propellant, kg", "firings", "ready, s"):
        rows.add_column(column, justify="right")
    for point in found["points"]:
        means = (point[name]["mean"] for name in ("propellant_kg", "firings", "ready_time_s"))
        cells = ("-" if mean is None else f"{mean:.4g}" for mean in means)
        rows.add_row(f"{point['value']:.6g}", _share(point["pass_rate"]), *cells)
    console.print(rows)
