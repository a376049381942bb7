"""``hil report``: self-contained HTML report of recorded runs."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from hil.cli.options import refuse
from hil.cli.output import check_json_path


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
    refuse(check_json_path("--out", out))

    from hil.api.recordings import open_recording
    from hil.api.results import write_report

    runs = [open_recording(name) for name in recordings]
    write_report(runs, out)
    Console().print(f"{out}: {len(runs)} runs" if len(runs) > 1 else out, highlight=False, soft_wrap=True, markup=False)
    return 0
