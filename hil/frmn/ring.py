"""Ring of records in shared memory: one writer that never waits, readers that count the records they missed."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hil.frmn.shared_memory import Memory, Slots


class Telemetry(Protocol):
    """Sink of every row."""

    def put(self, row: np.ndarray) -> None:
        """Copy ``row``, shape (1,)."""


class NoTelemetry:
    """Sink that discards every row."""

    def put(self, row: np.ndarray) -> None:
        """Discard ``row``."""


class Ring:
    """The last ``slots`` records of ``dtype``; side of the writer, which also creates readers.

    The ring takes ownership of ``descriptor``. Raises ProtocolError if its memory has another layout.
    """

    def __init__(self, descriptor: int, dtype: np.dtype, slots: int, name: str = "telemetry") -> None:
        self.dtype = dtype
        self.slots = slots
        self._memory = Memory(descriptor, name, _layout(dtype, slots), Slots.memory_size(dtype.itemsize, slots))
        self._records = Slots(self._memory.content, dtype.itemsize, slots)
        self._row: np.ndarray | None = None  # the last row and its bytes: a new view costs 1 us
        self._row_bytes = memoryview(b"")

    @classmethod
    def create(cls, dtype: np.dtype, slots: int, name: str = "telemetry") -> Ring:
        """Create a ring; pass ``descriptor`` to other processes (``pass_fds``)."""
        return cls(
            Memory.create(name, _layout(dtype, slots), Slots.memory_size(dtype.itemsize, slots)), dtype, slots, name
        )

    @property
    def descriptor(self) -> int:
        return self._memory.descriptor

    @property
    def written(self) -> int:
        """Number of records written since the ring was created."""
        return self._records.written

    def put(self, row: np.ndarray) -> None:
        """Write one record, ``row`` of shape (1,). One writer only; never waits. Fastest with the same array."""
        if row is not self._row:
            self._row, self._row_bytes = row, row.view(np.uint8).data
        self._records.put(self._row_bytes)

    def reader(self, from_now: bool = False) -> Reader:
        """Return a reader with its own count; ``from_now``: of future records only."""
        return Reader(self._records, self.dtype, self.written if from_now else 0)

    def close(self) -> None:
        """Release the memory; readers created here become invalid. Idempotent."""
        self._records.release()
        self._memory.close()


class Reader:
    """Reader of the records in order of writing; after reading all of them, got + lost == written."""

    def __init__(self, records: Slots, dtype: np.dtype, first: int) -> None:
        self._records = records
        self._dtype = dtype
        self._next = first
        self.got = 0
        self.lost = 0

    def read(self, at_most: int | None = None) -> np.ndarray:
        """Return the next records, shape (n,), read-only, at most ``at_most``; n = 0 without new ones.

        Records that were overwritten before they were read are counted in ``lost``.
        """
        written = self._records.written
        first = max(self._next, written - self._records.slots + 1)  # the slot before may be being written
        n = written - first if at_most is None else min(written - first, at_most)
        return self._read(first, n)

    def newest(self, at_most: int) -> np.ndarray:
        """Return the newest ``at_most`` of the next records, or fewer; those before them are skipped, not lost."""
        written = self._records.written
        n = min(written - self._next, at_most, self._records.slots - 1)
        self._next = written - n
        return self._read(self._next, n)

    def _read(self, first: int, n: int) -> np.ndarray:
        content, invalid = self._records.many(first, n)
        self.lost += first - self._next + invalid
        self.got += n - invalid
        self._next = first + n
        return np.frombuffer(content, self._dtype)[invalid:]


def _layout(dtype: np.dtype, slots: int) -> str:
    return f"{slots} of {dtype.descr}"
