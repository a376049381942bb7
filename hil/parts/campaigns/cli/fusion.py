"""``hil fusion``: the numerical simulation of bench paper IV.A over many seeds."""

from __future__ import annotations

from typing import Any, Literal

from rich.console import Console
from rich.progress import track
from rich.table import Table

from hil.cli.options import Figure, File, Runs, Seed, Settings, Workers
from hil.cli.output import notices, say, write_json

_PASSED, _FAILED = 0, 1


def fusion(
    *,
    vmu_noise: Literal["swapped", "printed"] = "swapped",
    runs: Runs = 100,
    seed: Seed = 0,
    settings: Settings = (),
    workers: Workers = 0,
    json: File = None,
    figure: Figure = None,
) -> int:
    """Simulate the fusion filters over many runs (bench paper IV.A): errors, bound, ratio, NEES.

    Parameters
    ----------
    vmu_noise
        Table I's rows of the vision unit as the text requires (swapped) or as printed.
    runs
        Number of runs, each with its own noise and initial errors.
    seed
        Seed of all random numbers, independent of the number of workers.
    workers
        Number of processes; 0: one per core.
    json
        File for the numbers, - for standard output.
    figure
        Figure of one run's errors with their 3-sigma band, as the paper's Fig. 5 (PNG, PDF or SVG).
    """
    from hil.parts.campaigns.batch import worker_count
    from hil.parts.campaigns.fusion import Study, run_fusion

    console = notices()
    with console.status("compiling the kernels that are not cached"):
        Study(settings, vmu_noise, seed).bound()
    done = iter(track(range(runs), "runs", console=console, disable=not console.is_terminal, transient=True))
    counted = 0

    def watch(finished: int) -> None:
        nonlocal counted
        for _ in range(finished - counted):
            next(done, None)
        counted = finished

    summary = run_fusion(vmu_noise, runs, seed, settings, worker_count(workers), watch)
    write_json(summary, json)
    if figure is not None:
        from hil.parts.campaigns.fusion import draw

        draw(vmu_noise, seed, settings, figure)
    passed = _passed(summary)
    if json != "-":
        _render(summary, passed, Console())
    return _PASSED if passed else _FAILED


def _passed(summary: dict[str, Any]) -> bool:
    optimal = all(max(summary[f"{name}_ratio"]) <= summary[f"{name}_ratio_limit"] for name in ("position", "attitude"))
    bands = [band for moment in summary["nees_at_s"].values() for band in moment.values()]
    return optimal and all(band["low"] <= band["mean"] <= band["high"] for band in bands)


def _render(summary: dict[str, Any], passed: bool, console: Console) -> None:
    from hil.parts.campaigns.fusion import TABLE_II_SD

    rows = Table(title=f"Fusion errors over {summary['runs']} runs, t >= 100 s, vision noise as {summary['vmu_noise']}")
    for name in ("", "axis", "rmse", "bound", "ratio", "largest", "Table II SD"):
        rows.add_column(name, justify="right" if name not in ("", "axis") else "left")
    for quantity, unit, scale, digits, paper in (
        ("position", "m", 1e3, 3, TABLE_II_SD[0]),
        ("attitude", "deg", 1.0, 5, TABLE_II_SD[1]),
    ):
        for i, axis in enumerate("xyz"):
            values = [summary[f"{quantity}_{kind}_{unit}"][i] * scale for kind in ("rmse", "bound")]
            largest = summary[f"{quantity}_max_{unit}"][i] * scale
            rows.add_row(
                f"{quantity}, {'mm' if unit == 'm' else unit}" if i == 0 else "",
                axis,
                *(f"{value:.{digits}f}" for value in values),
                f"{summary[f'{quantity}_ratio'][i]:.3f}",
                f"{largest:.{digits}f}",
                f"{paper[i] * scale:.{digits}f}",
                end_section=i == 2,
            )
    console.print(rows)
    for t_s, moment in summary["nees_at_s"].items():
        text = ", ".join(f"{name} {b['mean']:.2f} ({b['low']:.2f} .. {b['high']:.2f})" for name, b in moment.items())
        say(f"NEES at {t_s} s: {text}", console)
    text = ", ".join(
        f"{n} {summary[f'nis_{n}']['mean']:.3f} ({summary[f'nis_{n}']['low']:.3f} .. {summary[f'nis_{n}']['high']:.3f})"
        for n in ("pkf", "akf")
    )
    say(f"NIS: {text}; rejected poses {summary['rejected']}", console)
    word = "[bold green]PASS[/]" if passed else "[bold red]FAIL[/]"
    limits = ", ".join(f"{name} {summary[f'{name}_ratio_limit']:.3f}" for name in ("position", "attitude"))
    console.print(f"{word} (ratio <= {limits} for {summary['runs']} runs, NEES in its 99.9 % band)", highlight=False)
