"""``hil report``: self-contained HTML report of recorded runs, or of a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hil.cli.options import Check
from hil.cli.output import file_path_problem, say
from hil.core.part import provided
from hil.errors import BadInput


def report(
    recordings: Annotated[list[str], Parameter(negative=())],
    /,
    *,
    out: Annotated[str | None, Parameter(name=("--out", "-o")), Check(file_path_problem)] = None,
) -> int:
    """Write a self-contained HTML report of a run, of a campaign, or a comparison of several runs.

    Parameters
    ----------
    recordings
        Files of hil run --record, or one folder of hil campaign, whose report.html is written again.
    out
        File to write, *.html; of a campaign, report.html in its folder unless given.
    """
    folders = [name for name in recordings if Path(name).is_dir()]
    if folders and len(recordings) > 1:
        raise BadInput.single("hil report", "", f"{folders[0]}: give one folder of a campaign, or recordings")
    if out is None and not folders:
        raise BadInput.single("--out", "", "must be given: the file of the report")
    if folders:
        say(str(provided("report of a campaign", "hil report")(Path(folders[0]), out)))
        return 0
    assert out is not None

    from hil.api.recordings import open_recording
    from hil.api.results import write_report

    runs = [open_recording(name) for name in recordings]
    write_report(runs, out)
    say(f"{out}: {len(runs)} runs" if len(runs) > 1 else out)
    return 0
