"""Plotted rows of a session; each client reads on from its cursor."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hil.console.columns import COLUMNS, decimated

MAX_ROWS: Final = 250
"""Largest number of rows in a message: delayed rows are decimated, so that no client falls behind."""
BACKLOG: Final = 1500
"""Largest number of earlier rows for a new client."""
_CAPACITY: Final = 60_000  # 20 minutes at 50 Hz; then every second row is dropped


class RowStore:
    """Rows (n, COLUMNS) since the session started; ``session`` is the number of the session."""

    def __init__(self) -> None:
        self.session = 0
        self.total = 0
        """Number of rows since the session started."""
        self._rows = np.empty((0, COLUMNS), "<f4")
        self._count = 0
        self._each = 1  # decimation factor of the stored rows

    def begin(self) -> None:
        """Clear all rows for a new session."""
        self.session += 1
        self.total = self._count = 0
        self._each = 1
        self._rows = np.empty((1024, COLUMNS), "<f4")

    def add(self, rows: np.ndarray[Any, Any]) -> None:
        """Append rows."""
        if not len(rows):
            return
        self.total += len(rows)
        kept = decimated(rows, -(-len(rows) // self._each))
        while self._count + len(kept) > len(self._rows):
            self._grow()
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
        """Return a copy of all stored rows."""
        return self._rows[: self._count].copy()

    def since(self, cursor: Cursor) -> np.ndarray[Any, Any]:
        """Return the rows after ``cursor``, at most MAX_ROWS, and move it to the end."""
        new = cursor.session != self.session or cursor.each != self._each
        first = 0 if new else cursor.seen
        cursor.restarted = new
        cursor.session, cursor.each, cursor.seen = self.session, self._each, self._count
        return decimated(self._rows[first : self._count], BACKLOG if new else MAX_ROWS)

    def _grow(self) -> None:
        if len(self._rows) < _CAPACITY:
            grown = np.empty((2 * len(self._rows), COLUMNS), "<f4")
            grown[: self._count] = self._rows[: self._count]
            self._rows = grown
            return
        half = decimated(self._rows[: self._count], -(-self._count // 2))
        self._rows[: len(half)] = half
        self._count = len(half)
        self._each *= 2


class Cursor:
    """Read position of one client. restarted: the next rows replace all earlier ones."""

    def __init__(self) -> None:
        self.session = -1
        self.each = 1
        self.seen = 0
        self.restarted = True
