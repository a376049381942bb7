"""All rows of a session that the console plots, for each page from where it left off."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hil.console.columns import COLUMNS, thinned

AT_MOST: Final = 250
"""Rows in a message: what comes late is thinned out, so that no page ever falls behind."""
BACKLOG: Final = 1500
"""Rows that a page gets of what was before it came."""
_CAPACITY: Final = 60_000  # 20 minutes at 50 Hz; then every second row is forgotten


class RowStore:
    """Rows (n, COLUMNS) since the session began; ``session`` tells pages of one session from those of the next."""

    def __init__(self) -> None:
        self.session = 0
        self.total = 0
        """Rows that came since the session began."""
        self._rows = np.empty((0, COLUMNS), "<f4")
        self._count = 0
        self._each = 1  # of so many rows that came one is kept

    def begin(self) -> None:
        """Forget all: a new session begins."""
        self.session += 1
        self.total = self._count = 0
        self._each = 1
        self._rows = np.empty((1024, COLUMNS), "<f4")

    def add(self, rows: np.ndarray[Any, Any]) -> None:
        """Take further rows."""
        if not len(rows):
            return
        self.total += len(rows)
        kept = thinned(rows, -(-len(rows) // self._each))
        while self._count + len(kept) > len(self._rows):
            self._make_room()
        self._rows[self._count : self._count + len(kept)] = kept
        self._count += len(kept)

    @property
    def kept(self) -> int:
        return self._count

    @property
    def newest(self) -> np.ndarray[Any, Any] | None:
        """The last row, (COLUMNS,)."""
        return self._rows[self._count - 1] if self._count else None

    def all(self) -> np.ndarray[Any, Any]:
        """Return a copy of all that is kept."""
        return self._rows[: self._count].copy()

    def since(self, cursor: Cursor) -> np.ndarray[Any, Any]:
        """Return what ``cursor`` has not seen, at most AT_MOST rows, and move it to the end."""
        new = cursor.session != self.session or cursor.each != self._each
        first = 0 if new else cursor.seen
        cursor.restarted = new
        cursor.session, cursor.each, cursor.seen = self.session, self._each, self._count
        return thinned(self._rows[first : self._count], BACKLOG if new else AT_MOST)

    def _make_room(self) -> None:
        if len(self._rows) < _CAPACITY:
            grown = np.empty((2 * len(self._rows), COLUMNS), "<f4")
            grown[: self._count] = self._rows[: self._count]
            self._rows = grown
            return
        half = thinned(self._rows[: self._count], -(-self._count // 2))
        self._rows[: len(half)] = half
        self._count = len(half)
        self._each *= 2


class Cursor:
    """How far one page is. restarted: what it gets next replaces all that it has."""

    def __init__(self) -> None:
        self.session = -1
        self.each = 1
        self.seen = 0
        self.restarted = True
