"""Region of the television camera's image in which the docking monitor searches, in shared memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from hil.frmn.mailbox import MailboxBlock

Box = tuple[int, int, int, int]
"""A rectangle of the image: u, v of its first pixel, width, height, px."""

_BOX: Final = np.dtype([("box", "i8", 4)])
_MAILBOXES: Final = {"search": _BOX}


def box_text(box: Sequence[int] | None) -> str:
    """Return what is searched, for logs: the rectangle, None for the whole image."""
    return "the whole image" if box is None else f"{','.join(map(str, box))} px"


class SearchRegion:
    """A mailbox that the loop writes, for an operator, and the process of the docking monitor reads."""

    def __init__(self, descriptor: int) -> None:
        """Attach to the memory behind ``descriptor``, of which this object takes ownership."""
        self._attach(MailboxBlock(descriptor, _MAILBOXES, "search-region"))

    @classmethod
    def create(cls) -> SearchRegion:
        """Create the memory; pass ``descriptor`` to the other process (``pass_fds``)."""
        made = cls.__new__(cls)
        made._attach(MailboxBlock.create(_MAILBOXES, "search-region"))
        return made

    def _attach(self, block: MailboxBlock) -> None:
        self._block = block
        self._row = np.zeros(1, _BOX)
        self._read = 0

    @property
    def descriptor(self) -> int:
        return self._block.descriptor

    def set(self, box: Sequence[int] | None) -> None:
        """Set the region, None for the whole image. One writer; never waits."""
        self._row["box"] = box or (0, 0, 0, 0)
        self._block["search"].write(self._row, 0.0)

    def changed(self) -> bool:
        """Return whether the region was set since the last ``get``."""
        return self._block["search"].written != self._read

    def get(self) -> Box | None:
        """Return the region, None for the whole image and before the first ``set``."""
        self._read, _ = self._block["search"].read(self._row)
        u, v, width, height = self._row["box"][0].tolist()
        return (u, v, width, height) if width else None

    def close(self) -> None:
        """Release the memory; idempotent."""
        self._block.close()
