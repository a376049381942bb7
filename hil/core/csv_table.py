"""Tables of CSV files as people and spreadsheets write them: with commas, or with semicolons or tabs between cells.

Between semicolons or tabs a number may have a decimal comma; between commas it would be two cells.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from hil.core.files import read_text
from hil.errors import BadInput, Problem

_DECIMAL_COMMA: Final = re.compile(r"[-+]?\d*,\d*(?:[eE][-+]?\d+)?")
_PROBLEMS_MAX: Final = 5


@dataclass
class CsvTable:
    """Rows, each with its line in the file; problems: those noted so far, which ``check`` raises."""

    path: Path
    rows: list[tuple[int, dict[str, str]]]
    problems: list[Problem] = field(default_factory=list)

    def number(self, line: int, column: str, text: str) -> float:
        """Return ``text`` as a finite number, nan with a problem noted."""
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            self.note(f"line {line}, {column}", f"{text!r}: must be a finite number")
        return value

    def note(self, key: str, text: str) -> None:
        """Note a problem."""
        self.problems.append(Problem(str(self.path), key, text))

    def check(self) -> None:
        """Raise BadInput if there are problems, of many the first ones."""
        if len(self.problems) > _PROBLEMS_MAX:
            *first, last = self.problems[:_PROBLEMS_MAX]
            more = f"{last.message} (and {len(self.problems) - _PROBLEMS_MAX} more errors)"
            raise BadInput([*first, Problem(last.source, last.key, more)])
        if self.problems:
            raise BadInput(self.problems)


def read_csv(
    path: Path, at_most: int, columns: Sequence[str], optional: Iterable[str] | None = None, what: str = "row"
) -> CsvTable:
    """Return the table of the file at ``path``, of ``at_most`` bytes, with ``columns`` and the ``optional`` ones.

    optional: the other columns that are allowed, None for any. Raises BadInput for a missing or an unknown column, and
    for a table without a row, ``what``; a row with more or fewer cells than the header is a problem of the table.
    """
    lines = io.StringIO(read_text(path, at_most))
    separator = next((mark for mark in ";\t" if mark in lines.readline()), ",")
    lines.seek(0)
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        filled = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
    except csv.Error as error:
        raise BadInput.single(str(path), "", f"cannot be read: {error}") from error
    header = filled[0][1] if filled else []
    _check_header(path, header, columns, optional)
    table = CsvTable(path, [])
    for line, cells in filled[1:]:
        if len(cells) != len(header):
            hint = ": decimal commas?" if separator == "," and len(cells) > len(header) else ""
            table.note(f"line {line}", f"has {len(cells)} cells, the header {len(header)}{hint}")
            continue
        if separator != ",":
            cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
        table.rows.append((line, dict(zip(header, cells, strict=True))))
    if len(filled) < 2:
        table.note("", f"contains no {what}")
    return table


def _check_header(path: Path, header: list[str], columns: Sequence[str], optional: Iterable[str] | None) -> None:
    problems = [f"column {name} is missing" for name in columns if name not in header]
    if optional is not None:
        problems += [f"unknown column {name!r}" for name in header if name not in (*columns, *optional)]
    problems += [f"column {name} is there twice" for name in header if name and header.count(name) > 1]
    if problems:
        more = f", optional: {','.join(optional)}" if optional else ""
        raise BadInput.single(str(path), "", f"{problems[0]}; columns: {','.join(columns)}{more}")
