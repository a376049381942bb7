"""Options of output files, checked before the work starts, and files that are written completely or not at all."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from hil.core.text_files import write_text
from hil.errors import Problem

_WIDEST = 1000  # characters of a table
_FIGURES = (".png", ".pdf", ".svg")


def check_json_path(option: str, path: str | None) -> list[Problem]:
    """Return a problem if no file can be written to ``path``, "-" for standard output."""
    if path is None or path == "-":
        return []
    if Path(path).is_dir():
        return [Problem(option, "", f"{path}: is a folder, give the name of a file")]
    if not Path(path).absolute().parent.is_dir():
        return [Problem(option, "", f"{path}: its folder does not exist")]
    return []


def check_figure_path(option: str, path: str | None) -> list[Problem]:
    """Return a problem if no figure can be written to ``path``."""
    if path is not None and Path(path).suffix.lower() not in _FIGURES:
        return [Problem(option, "", f"{path}: must end in {', '.join(_FIGURES)}")]
    return check_json_path(option, path)


def write_json(content: dict[str, Any], path: str) -> None:
    """Write ``content`` to ``path``, "-" for standard output, completely or not at all."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    if path == "-":
        sys.stdout.write(text)
        return
    write_text(text, path)


def print_columns(head: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> None:
    """Print a table as wide as its content, also into a pipe; left: columns aligned to the left."""
    columns = [Column(name, justify="left" if i in left else "right") for i, name in enumerate(head)]
    table = Table(*columns, box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="")
    for row in rows:
        table.add_row(*map(Text, row))
    Console(width=_WIDEST).print(table, crop=False)


def check_rig_path(option: str, path: str | None) -> list[Problem]:
    """Return a problem if no new rig file can be written to ``path``."""
    if path is not None and not path.endswith(".toml"):
        return [Problem(option, "", f"{path}: must end in .toml")]
    if path is not None and Path(path).exists():
        return [Problem(option, "", f"{path}: exists already, give a new name")]
    return check_json_path(option, path)


def axis_problems(axes: Sequence[str]) -> list[Problem]:
    """Return a problem for each name that is no axis of the bench."""
    from hil.config.rig import BENCH_AXES

    allowed = ", ".join(BENCH_AXES)
    return [Problem("--axis", "", f"{axis}: unknown, give {allowed}") for axis in axes if axis not in BENCH_AXES]


def chosen_axes(axes: Sequence[str]) -> list[int]:
    """Return the indices of the named axes, of all six if none is named."""
    from hil.config.rig import BENCH_AXES

    return [k for k, name in enumerate(BENCH_AXES) if name in axes or not axes]


def base_of(name: str, out_path: str, kind: str = "rigs") -> str:
    """Return the value of ``extends`` with which the file at ``out_path`` extends the rig, or the scene, ``name``.

    kind: folder of the shipped files.
    """
    from hil.config.load import shipped

    if name in shipped(kind):
        return name
    return Path(os.path.relpath(Path(name).resolve(), Path(out_path).resolve().parent)).as_posix()
