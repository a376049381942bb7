"""A ring of records in shared memory: one writer that never waits, readers that count what they missed."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hil.frmn.memory import Memory
from hil.frmn.slots import Slots


class Telemetry(Protocol):
    """Whoever is handed every row."""

    def put(self, row: np.ndarray) -> None:
        """Take a copy of ``row``, shape (1,)."""


class NoTelemetry:
    """Nobody listens."""

    def put(self, row: np.ndarray) -> None:
        """Forget ``row``."""


class Ring:
    """The last ``slots`` records of ``dtype``; the writer's side, and what readers are made from.

    ``descriptor`` belongs to the ring from now on. Raises ProtocolError when the memory behind it has another layout.
    """

    def __init__(self, descriptor: int, dtype: np.dtype, slots: int, name: str = "telemetry") -> None:
        self.dtype = dtype
        self.slots = slots
        self._memory = Memory(descriptor, name, _layout(dtype, slots), Slots.room(dtype.itemsize, slots))
        self._records = Slots(self._memory.content, dtype.itemsize, slots)
        self._row: np.ndarray | None = None  # that was put last, and its bytes: looking at them anew costs 1 us
        self._row_bytes = memoryview(b"")

    @classmethod
    def create(cls, dtype: np.dtype, slots: int, name: str = "telemetry") -> Ring:
        """Make a new ring; hand ``descriptor`` to other processes (``pass_fds``)."""
        return cls(Memory.create(name, _layout(dtype, slots), Slots.room(dtype.itemsize, slots)), dtype, slots, name)

    @property
    def descriptor(self) -> int:
        return self._memory.descriptor

    @property
    def written(self) -> int:
        """How many records were written since the ring was made."""
        return self._records.written

    def put(self, row: np.ndarray) -> None:
        """Write one record, ``row`` of shape (1,). One writer only; never waits. Cheapest with the same array."""
        if row is not self._row:
            self._row, self._row_bytes = row, row.view(np.uint8).data
        self._records.put(self._row_bytes)

    def reader(self, from_now: bool = False) -> Reader:
        """Return a reader of its own count; ``from_now``: of records that are yet to come."""
        return Reader(self._records, self.dtype, self.written if from_now else 0)

    def close(self) -> None:
        """Let go of the memory; the readers that were made here end with it. Idempotent."""
        self._records.release()
        self._memory.close()


class Reader:
    """Takes records in the order of writing. got + lost == written, once everything there was has been taken."""

    def __init__(self, records: Slots, dtype: np.dtype, first: int) -> None:
        self._records = records
        self._dtype = dtype
        self._next = first
        self.got = 0
        self.lost = 0

    def read(self, at_most: int | None = None) -> np.ndarray:
        """Return the next records, shape (n,), read-only, at most ``at_most``; n = 0 when there is nothing new.

        What the writer overwrote before it was taken is counted in ``lost``.
        """
        written = self._records.written
        first = max(self._next, written - self._records.slots + 1)  # the slot before it may be under the pen
        n = written - first if at_most is None else min(written - first, at_most)
        return self._take(first, n)

    def newest(self, at_most: int) -> np.ndarray:
        """Return the newest ``at_most`` of the next records, or fewer; those before them are passed over, not lost."""
        written = self._records.written
        n = min(written - self._next, at_most, self._records.slots - 1)
        self._next = written - n
        return self._take(self._next, n)

    def _take(self, first: int, n: int) -> np.ndarray:
        whole, spoilt = self._records.many(first, n)
        self.lost += first - self._next + spoilt
        self.got += n - spoilt
        self._next = first + n
        return np.frombuffer(whole, self._dtype)[spoilt:]


def _layout(dtype: np.dtype, slots: int) -> str:
    return f"{slots} of {dtype.descr}"
