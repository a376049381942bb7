"""``hil recover``: restores a truncated recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hil.cli.output import say
from hil.core.incomplete import INCOMPLETE


def recover(recording: str, /, *, out: Annotated[str | None, Parameter(name=("--out", "-o"))] = None) -> int:
    """Restore a truncated recording in a new file; the file itself stays unchanged.

    Parameters
    ----------
    recording
        File of a recorder that was killed, or whose disk was full.
    out
        File to write; default: NAME.recovered.mcap in the same folder.
    """
    from hil.recording import recover as recovery

    outcome = recovery.recover(Path(recording), Path(out) if out is not None else None)
    if outcome.out is None:
        text = f"{recording} is intact: {outcome.messages} messages over {outcome.length_s:.2f} s, nothing to recover"
    else:
        recovered = f"{outcome.messages} messages over {outcome.length_s:.2f} s recovered"
        text = f"{outcome.out}: {recovered}; the old file is {outcome.problem}"
    say(text)
    return INCOMPLETE if outcome.damaged else 0
