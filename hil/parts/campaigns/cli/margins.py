"""``hil margins``: how much later each part of the loop may be."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from hil.cli.options import File, Output, Runs, Seed, Settings, Workers
from hil.cli.output import deliver, notices

_PASSED, _FAILED = 0, 1
_REASONS = 2


def margins(
    scenario: str,
    /,
    *,
    runs: Runs = 20,
    out: Output = None,
    seed: Seed = 0,
    settings: Settings = (),
    workers: Workers = 0,
    json: File = None,
) -> int:
    """Search how much later poses, stamps, thrusters and axes may be before the first case of a campaign fails.

    Exit code 1 if cases fail even without a delay.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file; its dispersions hold.
    runs
        Number of cases of each delay.
    out
        Folder for margins.json, margins.png and the campaigns, of which complete ones are not flown again.
    seed
        Seed of the campaigns.
    workers
        Number of processes on this computer; 0: one per core.
    json
        File for the numbers, - for standard output.
    """
    from hil.api.jobs import loaded_rig, loaded_scenario
    from hil.parts.campaigns.api.margins import search_margins
    from hil.parts.campaigns.store import parquet

    parquet()
    console = notices()
    with console.status("compiling the loop if it is not cached, up to two minutes") as status:
        flown, rig = loaded_scenario(scenario, settings).value, loaded_rig("mock", settings).value
        summary = search_margins(flown, rig, runs, out, seed, workers, status.update)
    deliver(summary, json, lambda: _render(summary, Console()))
    return _FAILED if any(margin["margin_s"] is None for margin in summary["margins"]) else _PASSED


def _render(summary: dict[str, Any], console: Console) -> None:
    rows = Table(title=f"{summary['scenario']}: delay that all of {summary['runs']} cases pass", title_justify="left")
    for column in ("part", "margin, ms", "fails at, ms", "because"):
        rows.add_column(column, justify="right" if "ms" in column else "left")
    for margin in summary["margins"]:
        why = [f"{each['cases']} x {each['reason']}" for each in margin["why"][:_REASONS]]
        most = "above " if margin["fails_at_s"] is None else ""
        rows.add_row(
            margin["part"],
            "none" if margin["margin_s"] is None else f"{most}{1e3 * margin['margin_s']:.0f}",
            "-" if margin["fails_at_s"] is None else f"{1e3 * margin['fails_at_s']:.0f}",
            "; ".join(why),
        )
    console.print(rows)
