"""``hil benchmark``: one fixed set of campaigns that any GNC can fly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from hil.cli.options import Flag, Group, Output, Runs, Seed, Settings, Workers
from hil.cli.output import notices, print_columns
from hil.errors import BadInput


@dataclass(frozen=True)
class BesideOptions:
    """What is added to the rows."""

    against: Output = None
    """Folder of an earlier benchmark: cases are compared one by one."""
    ideal: Flag = False
    """Fly rows with misses again with perfect sensors, with perfect thrusters and mass properties, and with both."""


_ROWS_ALONE = BesideOptions()


def benchmark(
    control: str = "builtin",
    /,
    *,
    out: str,
    runs: Runs = 100,
    seed: Seed = 0,
    only: str = "*",
    beside: Group[BesideOptions] = _ROWS_ALONE,
    settings: Settings = (),
    workers: Workers = 0,
) -> int:
    """Fly all scenarios, dispersion sets and single faults with one GNC, and write one table and one page.

    Parameters
    ----------
    control
        Backend of control: builtin, predictive, file.py:name, package:name, a shared library or an FMU.
    out
        Folder for benchmark.json, benchmark.html and the campaigns, which are resumed.
    runs
        Number of cases of each row.
    seed
        Seed of all campaigns; a date as 20261125 draws a second set, which is new to each GNC.
    only
        Pattern of the rows that are flown, as "scheme-*" or "*-stress".
    workers
        Number of processes on this computer; 0: one per core.
    """
    from hil.config.load import parsed_settings
    from hil.core.files import write_text
    from hil.parts.campaigns.api import benchmark as api
    from hil.parts.campaigns.benchmark_page import HEAD, cells_of, page_of, rows_and_ideals
    from hil.parts.campaigns.campaign import write_summary

    rows, overrides, against = api.rows_of(only), parsed_settings(settings), beside.against
    if control != "builtin":
        overrides["gnc.control.backend"] = control
    if against is not None and not Path(against).is_dir():
        raise BadInput.single("--against", "", f"{against}: is no folder")
    folder, console = Path(out), notices()
    with console.status("") as status:
        table = api.fly(rows, runs, folder, seed, overrides, workers, status.update, beside.ideal)
    if against is not None:
        table["against"] = {"folder": str(against), "rows": api.compare(folder, Path(against), rows)}
    write_summary(folder / api.RESULT, table)
    write_text(page_of(table), folder / "benchmark.html")
    print_columns(HEAD, [cells_of(row) for row in rows_and_ideals(table)])
    Console().print(f"{table['cycle_us']:.1f} us a cycle of scheme 1, with plant and mock devices, on one core")
    return 0
