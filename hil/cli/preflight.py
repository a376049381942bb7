"""``hil preflight``: the table of what was checked, and what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hil.cli.output import check_json_path, write_json
from hil.config.load import load_rig, load_scenario
from hil.errors import BadInput

_PASSED, _FAILED = 0, 1
_WORDS = {True: "[green]pass[/]", False: "[bold red]fail[/]", None: "note"}


def preflight_command(
    rig_name: str, scenario_name: str, settings: Sequence[str], json_path: str | None, enable_drives: bool
) -> int:
    """Do ``hil preflight``; return its exit code. Raises BadInput before anything is started."""
    problems = check_json_path("--json", json_path)
    if problems:
        raise BadInput(problems)
    scenario, rig = load_scenario(scenario_name, settings), load_rig(rig_name, settings)
    from hil.preflight.lateness import histogram_lines
    from hil.preflight.run import preflight

    progress = Console(stderr=True)
    with progress.status("") as status:
        found = preflight(scenario, rig, Path.cwd(), enable_drives, lambda text: status.update(f"{text} ..."))
    if json_path is not None:
        write_json({"scenario": scenario.value.name, "rig": rig_name, **found.numbers()}, json_path)
    if json_path != "-":
        console = Console()
        table = Table(title=f"Preflight of {rig_name} for {scenario.value.name}")
        for heading in ("check", "result", "found", "what to do"):
            table.add_column(heading, overflow="fold")
        for check in found.checks:
            table.add_row(escape(check.name), _WORDS[check.passed], escape(check.value), escape(check.advice))
        console.print(table)
        if found.lateness is not None:
            console.print("Lateness of an empty loop, cycles (bars: logarithm)")
            for line in histogram_lines(found.lateness):
                console.print(f"  {line}", highlight=False)
        failed = sum(check.passed is False for check in found.checks)
        word = "[bold green]PASS[/]" if found.passed else f"[bold red]FAIL[/]: {failed} of {len(found.checks)} checks"
        console.print(word, highlight=False)
    return _PASSED if found.passed else _FAILED
