"""``hil report``: self-contained HTML report of recorded runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from hil.cli.options import refuse
from hil.cli.output import check_json_path, write_text
from hil.errors import BadInput, Problem


def report(
    recordings: Annotated[list[str], Parameter(negative=())],
    /,
    *,
    out: Annotated[str, Parameter(name=("--out", "-o"))],
) -> int:
    """Write a self-contained HTML report of a run, or a comparison of several.

    Parameters
    ----------
    recordings
        Files of hil run --record.
    out
        File to write, *.html.
    """
    problems = check_json_path("--out", out)
    if Path(out).suffix.lower() not in (".html", ".htm"):
        problems.append(Problem("--out", "", f"{out}: must end in .html"))
    refuse(problems)

    from hil.recording.read import load

    runs = [load(Path(name)) for name in recordings]
    if empty := [Problem(str(run.path), "", "no cycle is recorded") for run in runs if not len(run.cycles)]:
        raise BadInput(empty)

    from hil.report import page  # slow import of matplotlib

    text = page.report(runs)
    write_text(text, out)
    Console().print(f"{out}: {len(runs)} runs" if len(runs) > 1 else out, highlight=False, soft_wrap=True, markup=False)
    return 0
