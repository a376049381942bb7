"""``hil recover``: a recording that broke off, made whole."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from hil.recording.recover import recover


def recover_command(recording: str, out: str | None) -> int:
    """Do ``hil recover``; return its exit code. Raises BadInput."""
    found = recover(Path(recording), Path(out) if out is not None else None)
    if found.out is None:
        text = f"{recording} is intact: {found.messages} messages over {found.length_s:.2f} s, nothing to recover"
    else:
        lost = f"; {found.lost_chunks} damaged blocks are left out" if found.lost_chunks else ""
        text = f"{found.out}: {found.messages} messages over {found.length_s:.2f} s recovered{lost}"
    Console().print(text, highlight=False, soft_wrap=True, markup=False)
    return 0
