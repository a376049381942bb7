"""The run's time for processes that know bench time alone: a cell that the loop writes when the relation changes."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.frmn.mailbox import MailboxBlock

_ZERO: Final = np.dtype([("zero_s", "f8")])
_CELLS: Final = {"run": _ZERO}


class RunTime:
    """Bench time at which the run's time is zero; nothing is known of it before the run and while it is held."""

    def __init__(self, descriptor: int) -> None:
        """Join the memory behind ``descriptor``, which belongs to this object from now on."""
        self._block = MailboxBlock(descriptor, _CELLS, "run-time")
        self._row = np.full(1, math.nan, _ZERO)

    @classmethod
    def create(cls) -> RunTime:
        """Make a new one; hand ``descriptor`` to other processes (``pass_fds``)."""
        made = cls.__new__(cls)
        made._block = MailboxBlock.create(_CELLS, "run-time")
        made._row = np.full(1, math.nan, _ZERO)
        return made

    @property
    def descriptor(self) -> int:
        return self._block.descriptor

    def set_zero(self, zero_s: float) -> None:
        """Say that the run's time is zero at ``zero_s`` of bench time; nan: that no run's time goes. One writer."""
        self._row["zero_s"] = zero_s
        self._block["run"].write(self._row, 0.0)

    def of(self, bench_s: float) -> float:
        """Return the time of the run at ``bench_s``, nan where no run's time goes."""
        row = np.full(1, math.nan, _ZERO)
        self._block["run"].read(row)
        return bench_s - float(row["zero_s"][0])

    def close(self) -> None:
        """Let go of the memory; idempotent."""
        self._block.close()
