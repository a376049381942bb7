"""Every fault of every emulated device in every mode that can have it: what the bench made of it, and how soon.

    python sims/fault_matrix.py [running|standby|armed|hold ...] [KEY=VALUE ...]

Exit code 1 when one was not handled as it must be.
"""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

from hil.commission.fault_matrix import TIGHT, FaultFinding, clear_faults, matrix, rehearse
from hil.config.load import load_rig, load_scenario
from hil.core.modes import Mode
from hil.session.build import Job, check, warm_up, wired_bench


def main(words: list[str]) -> int:
    modes = [Mode(word) for word in words if "=" not in word] or [Mode.RUNNING, Mode.STANDBY, Mode.ARMED, Mode.HOLD]
    settings = (*TIGHT, *(word for word in words if "=" in word))
    job = Job(load_scenario("scheme-1", settings), load_rig("emulated", settings), 0, 60.0, 1.0)
    check(job)
    warm_up(job)
    console = Console()
    findings: list[FaultFinding] = []
    with wired_bench(job) as bench:
        clear_faults(bench)
        for case in matrix(modes):
            try:
                finding = rehearse(bench, case)
            except RuntimeError as error:
                console.print(f"NOT DONE {case.name}: {error}", highlight=False, soft_wrap=True)
                findings.append(FaultFinding(case, Mode.OFF, str(error), None, None))
                continue
            findings.append(finding)
            word = "ok  " if finding.as_expected else "MISSED"
            console.print(f"{word} {case.name}: {finding.alarm or 'goes on'}", highlight=False, soft_wrap=True)
    for mode in modes:
        console.print(_table(findings, mode))
    missed = [finding.case.name for finding in findings if not finding.as_expected]
    console.print(f"{len(findings)} cases, {len(missed)} not as they must be {missed or ''}")
    return 1 if missed else 0


def _table(findings: list[FaultFinding], mode: Mode) -> Table:
    """Return fault by device: detected and standing after so many milliseconds."""
    here = {(f.case.device, f.case.line.removeprefix("on ")): f for f in findings if f.case.mode is mode}
    devices = list(dict.fromkeys(device for device, _ in here))
    table = Table("fault", *devices, title=f"{mode.value}: detected / standing, ms")
    for line in dict.fromkeys(line for _, line in here):
        table.add_row(line, *(_cell(here[d, line]) if (d, line) in here else "" for d in devices))
    return table


def _cell(finding: FaultFinding) -> str:
    if finding.detected_s is None:
        return "goes on" if finding.as_expected else "MISSED"
    standing = "moving" if finding.standing_s is None else f"{1e3 * finding.standing_s:.0f}"
    return f"{1e3 * finding.detected_s:.0f} / {standing}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
