"""``hil preflight``: checks of host and rig, with advice."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hil.cli.options import File, Flag, Settings
from hil.cli.output import notices, write_json

_PASSED, _FAILED = 0, 1
_WORDS = {True: "[green]pass[/]", False: "[bold red]fail[/]", None: "note"}


def preflight(
    *,
    rig: str = "mock",
    scenario: str = "scheme-1",
    settings: Settings = (),
    json: File = None,
    devices: Flag = False,
    operator_key: str | None = None,
    eds: str | None = None,
) -> int:
    """Check whether this host and a rig can run in real time and reach a scenario; exit code 0 or 1.

    Parameters
    ----------
    rig
        mock, emulated, or the path of a rig file.
    scenario
        Gives the rate and the plan that the rig has to follow.
    json
        File for the results, - for standard output.
    devices
        Also open rails and turntable of a hardware rig: the drives are enabled and hold their positions.
    operator_key
        The operator's key file, by hil operators add: the record of a hardware rig has its name, and is sealed with it.
    eds
        Data sheet of a CiA 402 drive, EDS or DCF: show what the driver would use of it, and check nothing else.
    """
    if eds is not None:
        return _describe(eds)
    from hil.checks.signed_record import write_record
    from hil.checks.waivers import waivers
    from hil.config.load import load_rig, load_scenario
    from hil.core.operator_keys import read_key
    from hil.core.surroundings import local_user
    from hil.preflight import run
    from hil.preflight.lateness import histogram_lines
    from hil.report.table import print_waived

    who = local_user() if operator_key is None else read_key(operator_key)
    loaded, loaded_rig = load_scenario(scenario, settings), load_rig(rig, settings)
    progress = notices()
    with progress.status("") as status:
        report = run.preflight(loaded, loaded_rig, Path.cwd(), devices, lambda text: status.update(f"{text} ..."))
    if loaded_rig.value.kind == "hardware":
        late = report.lateness
        measured_s = 0.0 if late is None else late.cycles * late.period_s
        write_record(loaded_rig, report.rate_hz, measured_s, report.passed, who)
    waived = [waiver.as_json() for waiver in waivers(loaded_rig.value, loaded.value)]
    write_json({"scenario": loaded.value.name, "rig": rig, **report.numbers(), "waived": waived}, json)
    if json != "-":
        console = Console()
        table = Table(title=f"Preflight of {rig} for {loaded.value.name}")
        for heading in ("check", "result", "found", "what to do"):
            table.add_column(heading, overflow="fold")
        for check in report.checks:
            table.add_row(escape(check.name), _WORDS[check.passed], escape(check.value), escape(check.advice))
        console.print(table)
        if report.lateness is not None:
            console.print("Lateness of an empty loop, cycles (bars: logarithm)")
            for line in histogram_lines(report.lateness):
                console.print(f"  {line}", highlight=False)
        print_waived(waived, console)
        failed = sum(check.passed is False for check in report.checks)
        word = "[bold green]PASS[/]" if report.passed else f"[bold red]FAIL[/]: {failed} of {len(report.checks)} checks"
        console.print(word, highlight=False)
    return _PASSED if report.passed else _FAILED


def _describe(path: str) -> int:
    """Show what the driver uses of a data sheet."""
    from hil.core.part import provided

    describe = provided("rig.turntable.driver=cia402: description", path)
    table = Table(title=f"CiA 402 drive of {path}")
    for heading in ("what", "found", "what to do"):
        table.add_column(heading, overflow="fold")
    for finding in describe(Path(path)):
        table.add_row(*map(escape, finding))
    Console().print(table)
    return _PASSED
