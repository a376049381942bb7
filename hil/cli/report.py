"""``hil report``: a page about recorded runs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from hil.cli.output import check_json_path
from hil.errors import BadInput, Problem
from hil.recording.read import load


def report_command(recordings: Sequence[str], out: str) -> int:
    """Do ``hil report``; return its exit code. Raises BadInput."""
    problems = check_json_path("--out", out)
    if Path(out).suffix.lower() not in (".html", ".htm"):
        problems.append(Problem("--out", "", f"{out}: must end in .html"))
    if problems:
        raise BadInput(problems)
    runs = [load(Path(name)) for name in recordings]
    if empty := [Problem(str(run.path), "", "no cycle is recorded") for run in runs if not len(run.cycles)]:
        raise BadInput(empty)

    from hil.report.page import report  # matplotlib takes a second

    text = report(runs)
    partial = Path(f"{out}.part")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, out)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise BadInput.single("--out", "", f"{out}: {error.strerror}") from error
    Console().print(f"{out}: {len(runs)} runs" if len(runs) > 1 else out, highlight=False, soft_wrap=True, markup=False)
    return 0
