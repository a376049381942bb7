"""Options of output files, checked before the work starts, and files that are written completely or not at all."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from hil.core.files import write_text
from hil.errors import BadInput

if TYPE_CHECKING:
    from hil.config.load import Loaded
    from hil.config.rig import Rig

_WIDEST = 1000  # characters of a table
_REASONS = 3
_FIGURES = (".png", ".pdf", ".svg")


QUIET: Final[ContextVar[bool]] = ContextVar("quiet", default=False)
"""Whether a command prints results and errors alone."""


def notices() -> Console:
    """Return the console of progress and notices: standard error, nothing if the command is to be quiet."""
    return Console(stderr=True, quiet=QUIET.get())


def file_path_problem(path: str) -> str:
    """Return why no file can be written to ``path``, "-" for standard output; "" if it can."""
    if path == "-":
        return ""
    if Path(path).is_dir():
        return f"{path}: is a folder, give the name of a file"
    folder = Path(path).absolute().parent
    if not folder.is_dir():
        return f"{path}: its folder does not exist"
    return "" if os.access(path if Path(path).exists() else folder, os.W_OK) else f"{path}: cannot be written there"


def figure_path_problem(path: str) -> str:
    """Return why no figure can be written to ``path``, "" if it can."""
    if Path(path).suffix.lower() not in _FIGURES:
        return f"{path}: must end in {', '.join(_FIGURES)}"
    return file_path_problem(path)


def toml_path_problem(path: str) -> str:
    """Return why no new rig or scene file can be written to ``path``, "" if it can."""
    if not path.endswith(".toml"):
        return f"{path}: must end in .toml"
    return f"{path}: exists already, give a new name" if Path(path).exists() else file_path_problem(path)


def say(text: str, console: Console | None = None, style: str | None = None) -> None:
    """Print ``text`` as it is, without line breaks, to ``console``; None for standard output."""
    (console or Console()).print(text, style=style, highlight=False, soft_wrap=True, markup=False)


def deliver(content: dict[str, Any], path: str | None, show: Callable[[], object]) -> None:
    """Write ``content`` as ``write_json`` does; print by ``show`` unless standard output has the JSON."""
    write_json(content, path)
    if path != "-":
        show()


def write_json(content: dict[str, Any], path: str | None) -> None:
    """Write ``content`` to ``path`` completely or not at all; "-" for standard output, None for nothing."""
    if path is None:
        return
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


def axes_problem(axes: Sequence[str]) -> str:
    """Return which of the names is no axis of the bench, "" if all are."""
    from hil.config.rig import BENCH_AXES

    unknown = [axis for axis in axes if axis not in BENCH_AXES]
    return f"{unknown[0]}: unknown, give {', '.join(BENCH_AXES)}" if unknown else ""


def chosen_axes(axes: Sequence[str], rig: Loaded[Rig]) -> list[int]:
    """Return the indices of the named axes, of all that are driven if none is named.

    Raises BadInput for one without a drive.
    """
    from hil.config.rig import BENCH_AXES

    undriven = rig.value.undriven
    if fixed := [axis for axis in axes if axis in undriven]:
        raise BadInput.single(rig.where(fixed[0]), f"rig.{fixed[0]}", "has no drive, allowed: axes with one")
    return [k for k, name in enumerate(BENCH_AXES) if name in axes or not (axes or name in undriven)]


def base_of(name: str, out_path: str, kind: str = "rigs") -> str:
    """Return the value of ``extends`` with which the file at ``out_path`` extends the rig, or the scene, ``name``.

    kind: folder of the shipped files.
    """
    from hil.config.load import shipped

    if name in shipped(kind):
        return name
    return Path(os.path.relpath(Path(name).resolve(), Path(out_path).resolve().parent)).as_posix()


def commonest(refusals: Iterable[tuple[str, str]]) -> list[str]:
    """Return a line for each of the commonest statuses, with its commonest reason. refusals: status, reason."""
    rows = list(refusals)
    out = []
    for status, count in Counter(status for status, _ in rows).most_common(_REASONS):
        why = Counter(text for name, text in rows if name == status and text).most_common(1)
        out.append(f"{count} {status}" + (f": {why[0][0]}" if why else ""))
    return out
