"""Region of the television camera's image in which the docking monitor searches, in shared memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.frmn.mailbox import SharedMailbox

Box = tuple[int, int, int, int]
"""A rectangle of the image: u, v of its first pixel, width, height, px."""


def box_text(box: Sequence[int] | None) -> str:
    """Return what is searched, for logs: the rectangle, None for the whole image."""
    return "the whole image" if box is None else f"{','.join(map(str, box))} px"


class SearchRegion(SharedMailbox):
    """A mailbox that the loop writes, for an operator, and the process of the docking monitor reads."""

    layout = np.dtype([("box", "i8", 4)])
    label = "search-region"
    _read = 0

    def set(self, box: Sequence[int] | None) -> None:
        """Set the region, None for the whole image. One writer; never waits."""
        self._row["box"] = box or (0, 0, 0, 0)
        self._mailbox.write(self._row, 0.0)

    def changed(self) -> bool:
        """Return whether the region was set since the last ``get``."""
        return self._mailbox.written != self._read

    def get(self) -> Box | None:
        """Return the region, None for the whole image and before the first ``set``."""
        self._read, _ = self._mailbox.read(self._row)
        u, v, width, height = self._row["box"][0].tolist()
        return (u, v, width, height) if width else None
