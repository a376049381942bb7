"""Sections that parts add to the report of a run: one declaration, for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hil.core.part import declared, imported
from hil.errors import one_line
from hil.report import html

_INDENT = 12


class Section(NamedTuple):
    """Section of a report. notes: lines of text. head, rows: of a table, whose first column is aligned to the left."""

    title: str
    notes: Sequence[str] = ()
    head: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()

    def text(self) -> list[str]:
        """Return the section as lines for a terminal."""
        table = [self.head, *self.rows] if self.rows else []
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [*self.notes]
        for first, *cells in table:
            padded = [f"  {cell:>{n}}" for cell, n in zip(cells, widths[1:], strict=True)]
            lines.append(first.ljust(widths[0]) + "".join(padded))
        return [f"{'' if i else self.title:{_INDENT}}{line}".rstrip() for i, line in enumerate(lines)]

    def html(self) -> Iterator[str]:
        """Yield the section as blocks of a page."""
        yield html.heading(2, self.title)
        yield from map(html.paragraph, self.notes)
        if self.rows:
            yield html.table(self.head, self.rows)


def sections_of(summary: Mapping[str, Any]) -> Iterator[Section]:
    """Yield the sections of the installed parts that have a table in the summary of a run, of any version of them."""
    for table, path in declared("sections").items():
        if table in summary:
            try:
                yield imported(path)(summary[table])
            except Exception as error:
                text = one_line(f"{type(error).__name__}: {error}", 200)
                yield Section(table, [f"its part cannot display these numbers: {text}"])
