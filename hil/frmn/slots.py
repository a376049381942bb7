"""Records handed from one writer to any number of readers, without a lock: what cells and rings are made of.

The writer fills the slots in turn and counts a record only when it is whole. A reader copies a record
and then looks at the count: while the writer has not come round to that slot again, the copy is whole.
The writer never waits, and one that is killed in the middle of a record leaves the whole ones before it.

That a reader sees the record before it sees the count rests on the order in which x86-64 makes stores
visible. docs/decisions/0030-hand-over.md says what another processor would need.
"""

from __future__ import annotations

from typing import Final

_COUNT: Final = 64  # bytes before the slots: the count has a cache line to itself


class Slots:
    """``slots`` places for records of ``size`` bytes in ``content``; record number i (from 0) is in slot i % slots."""

    def __init__(self, content: memoryview, size: int, slots: int) -> None:
        self.size = size
        self.slots = slots
        self._counter = content[:8].cast("q")
        self._bytes = content[_COUNT : self.room(size, slots)]

    @staticmethod
    def room(size: int, slots: int) -> int:
        """Return how many bytes of memory they take, a whole number of cache lines."""
        return _COUNT + -(-size * slots // 64) * 64

    @property
    def written(self) -> int:
        """How many records were written since the memory was made."""
        return self._counter[0]

    def put(self, whole: bytes | memoryview) -> None:
        """Write the next record, all ``size`` bytes of it. One writer only; never waits."""
        number = self._counter[0]
        start = number % self.slots * self.size
        self._bytes[start : start + self.size] = whole
        self._counter[0] = number + 1

    def one(self, number: int) -> bytes | None:
        """Return record ``number``, which must have been written; None when the writer came round to it meanwhile."""
        whole = self._copy(number % self.slots, 1)
        return None if self._spoilt_before() > number else whole

    def many(self, first: int, n: int) -> tuple[bytes, int]:
        """Return ``n`` records from ``first`` on, which must have been written, one after the other.

        And how many of the first of them are not to be used, because the writer came round to them meanwhile.
        """
        slot = first % self.slots
        to_the_end = min(n, self.slots - slot)
        whole = self._copy(slot, to_the_end) + self._copy(0, n - to_the_end)
        return whole, min(max(self._spoilt_before() - first, 0), n)

    def _spoilt_before(self) -> int:
        """Return the first record that is whole for sure: that before it lies where the writer may be writing."""
        return self._counter[0] - self.slots + 1

    def _copy(self, slot: int, n: int) -> bytes:
        return bytes(self._bytes[slot * self.size : (slot + n) * self.size])

    def release(self) -> None:
        """Let go of the memory."""
        self._counter.release()
        self._bytes.release()
