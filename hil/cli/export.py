"""``hil export``: the numbers of a recording for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rich.console import Console

from hil.cli.output import check_json_path
from hil.errors import BadInput
from hil.recording.export import export


def export_command(recording: str, form: Literal["parquet", "csv"], out: str | None) -> int:
    """Do ``hil export``; return its exit code. Raises BadInput."""
    target = Path(out) if out is not None else Path(recording).with_suffix(f".{form}")
    if problems := check_json_path("--out", str(target)):
        raise BadInput(problems)
    for path, rows in export(Path(recording), form, target):
        Console().print(f"{path}: {rows} rows", highlight=False, soft_wrap=True, markup=False)
    return 0
