"""``hil gnc check``: test of an external GNC before its first run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from hil.cli.options import File, Flag, Seconds, Settings
from hil.cli.output import deliver, notices, say
from hil.errors import BadInput

if TYPE_CHECKING:
    from hil.config.scenario import GncConfig
    from hil.parts.links.gnc_check.check import Report
    from hil.parts.links.gnc_check.gnc_under_test import GncUnderTest

_PASSED, _FAILED = 0, 1


def gnc_check(
    gnc: str,
    /,
    *,
    scenario: str = "scheme-1",
    dial: Flag = False,
    wait: Seconds = 60.0,
    settings: Settings = (),
    json: File = None,
) -> int:
    """Check an external GNC: latency, signs, units and order.

    Parameters
    ----------
    gnc
        A shared library (*.so), an FMU (*.fmu), or HOST:PORT of this computer on which to wait for a GNC.
    scenario
        Gives vehicle, step and Table III.
    dial
        HOST:PORT is the address of a GNC that waits for the bench.
    wait
        Wall-clock time to wait for the GNC, s.
    json
        File for the findings, - for standard output.
    """
    from hil.config.load import load_scenario
    from hil.parts.links.gnc_check.check import check_gnc

    loaded = load_scenario(scenario, settings).value
    console = notices()
    partner = _partner(gnc, loaded.gnc, dial, wait, console)
    try:
        with console.status("waiting for the GNC") as status:
            report = check_gnc(partner, loaded, lambda name: status.update(f"playing: {name}"))
    finally:
        partner.close()
    deliver(report.as_json(), json, lambda: _print(report))
    return _PASSED if report.passed else _FAILED


def _partner(gnc: str, settings: GncConfig, dial: bool, wait_s: float, console: Console) -> GncUnderTest:
    from hil.frmn.wire import PORT
    from hil.gnc_backends.library import open_library
    from hil.parts.links.gnc_check.gnc_under_test import LibraryUnderTest, ProgramUnderTest, check_link
    from hil.parts.links.udp import parse_address, shown

    suffix = Path(gnc).suffix
    if suffix in (".so", ".fmu") or Path(gnc).exists():
        binary = {"fmu": gnc, "library": None} if suffix == ".fmu" else {"library": gnc, "fmu": None}
        library = open_library(settings.model_copy(update=binary), "hil gnc check")
        assert library is not None
        return LibraryUnderTest(library)
    if ":" not in gnc:
        raise BadInput.single("hil gnc check", "", f"{gnc}: give a shared library (*.so), an FMU (*.fmu) or HOST:PORT")
    address = parse_address("hil gnc check", gnc, PORT)
    link = check_link(None if dial else address, address if dial else None)
    if not dial:
        console.print(f"waiting for a GNC on {shown(link.address)}", style="dim", highlight=False)
    return ProgramUnderTest(link, wait_s)


def _print(report: Report) -> None:
    console = Console()
    for finding in report.findings:
        mark = "[green]ok  [/green]" if finding.passed else "[red]FAIL[/red]"
        console.print(f"{mark} {finding.check:<9}", end="", highlight=False)
        say(finding.text, console)
    faults = sum(not finding.passed for finding in report.findings)
    verdict = "PASS" if report.passed else "FAIL"
    text = f"{verdict} {report.gnc}" + ("" if report.passed else f" ({faults} faults)")
    say(text, console, "bold")
