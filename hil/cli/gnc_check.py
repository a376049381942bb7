"""``hil gnc-check``: is a GNC of the user's own fit to be flown?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from hil.cli.output import check_json_path, write_json
from hil.config.load import load_scenario
from hil.errors import BadInput, Problem
from hil.gnc_check.check import Report, check_gnc
from hil.gnc_check.gnc_under_test import GncUnderTest, LibraryPartner, LinkPartner, check_link

_PASSED, _FAILED = 0, 1


def gnc_check_command(
    gnc: str, scenario_name: str, dial: bool, wait_s: float, settings: Sequence[str], json_path: str | None
) -> int:
    """Do ``hil gnc-check``; return its exit code. Raises BadInput where there is nothing to check."""
    problems = check_json_path("--json", json_path)
    if not (math.isfinite(wait_s) and wait_s > 0.0):
        problems.append(Problem("--wait", "", f"{wait_s:g}: must be a time above 0 s"))
    if problems:
        raise BadInput(problems)
    scenario = load_scenario(scenario_name, settings).value
    console = Console(stderr=True)
    partner = _partner(gnc, dial, wait_s, console)
    try:
        with console.status("waiting for the GNC") as status:
            report = check_gnc(partner, scenario, lambda name: status.update(f"playing: {name}"))
    finally:
        partner.close()
    if json_path is not None:
        write_json(report.as_json(), json_path)
    if json_path != "-":
        _print(report)
    return _PASSED if report.passed else _FAILED


def _partner(gnc: str, dial: bool, wait_s: float, console: Console) -> GncUnderTest:
    from hil.frmn.udp import parse_address, shown
    from hil.frmn.wire import PORT

    if Path(gnc).suffix == ".so" or Path(gnc).exists():
        return LibraryPartner(gnc, "hil gnc-check")
    if ":" not in gnc:
        raise BadInput.single("hil gnc-check", "", f"{gnc}: give a shared library (*.so) or HOST:PORT")
    address = parse_address("hil gnc-check", gnc, PORT)
    link = check_link(None if dial else address, address if dial else None)
    if not dial:
        console.print(f"waiting for a GNC on {shown(link.address)}", style="dim", highlight=False)
    return LinkPartner(link, wait_s)


def _print(report: Report) -> None:
    console = Console()
    for finding in report.findings:
        mark = "[green]ok  [/green]" if finding.passed else "[red]FAIL[/red]"
        console.print(f"{mark} {finding.check:<9}", end="", highlight=False)
        console.print(finding.text, highlight=False, soft_wrap=True, markup=False)
    faults = sum(not finding.passed for finding in report.findings)
    verdict = "PASS" if report.passed else "FAIL"
    text = f"{verdict} {report.partner}" + ("" if report.passed else f" ({faults} faults)")
    console.print(text, highlight=False, markup=False, style="bold")
