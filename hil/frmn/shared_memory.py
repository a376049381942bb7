"""Anonymous shared memory and the lock-free slots in it, from which mailboxes and rings are made.

The memory has no name in the system and is released with its last user. The one writer fills the slots in rotation and
counts a record only when it is complete. A reader copies a record and then checks the count: unless the writer has
returned to that slot meanwhile, the copy is intact. The writer never waits, and if it is killed in the middle of a
record, the complete ones before it remain.

That a reader sees the record before the count depends on the order in which x86-64 makes stores visible;
docs/decisions/0007-exchange-records-through-lock-free-shared-memory.md gives the requirements of other processors.
"""

from __future__ import annotations

import hashlib
import mmap
import os
from typing import Final

from hil.errors import ProtocolError

HEADER: Final = 64  # one cache line: digest of the layout
_DIGEST: Final = 8
_COUNT: Final = 64  # bytes before the slots: the count has a cache line to itself


class Memory:
    """``content`` holds ``size`` bytes shared by all processes with the ``descriptor`` (``pass_fds``).

    The object takes ownership of the descriptor. name: used in errors. layout: description of the content, the same
    for writer and readers. Raises ProtocolError for a descriptor of another layout.
    """

    def __init__(self, descriptor: int, name: str, layout: str, size: int) -> None:
        self.descriptor = descriptor
        self.name = name
        actual, expected = os.fstat(descriptor).st_size, HEADER + size
        if actual != expected:
            raise ProtocolError(name, f"shared memory of {actual} bytes, expected {expected}: another layout")
        self._map = mmap.mmap(descriptor, expected)
        if self._map[:_DIGEST] != _digest(layout):
            self._map.close()
            raise ProtocolError(name, f"shared memory of another layout, expected {layout}")
        self._view = memoryview(self._map)
        self.content = self._view[HEADER:]

    @staticmethod
    def create(name: str, layout: str, size: int) -> int:
        """Create zeroed memory; return its descriptor."""
        descriptor = os.memfd_create(name)
        os.ftruncate(descriptor, HEADER + size)
        os.pwrite(descriptor, _digest(layout), 0)
        return descriptor

    def close(self) -> None:
        """Release the memory, after all views of ``content`` have been released. Idempotent."""
        if not self._map.closed:
            self.content.release()
            self._view.release()
            self._map.close()
            os.close(self.descriptor)


class Slots:
    """``slots`` records of ``size`` bytes in ``content``; record number i (from 0) is in slot i % slots."""

    def __init__(self, content: memoryview, size: int, slots: int) -> None:
        self.size = size
        self.slots = slots
        self._counter = content[:8].cast("q")
        self._bytes = content[_COUNT : self.memory_size(size, slots)]

    @staticmethod
    def memory_size(size: int, slots: int) -> int:
        """Return the size of the memory, bytes, a multiple of cache lines."""
        return _COUNT + -(-size * slots // 64) * 64

    @property
    def written(self) -> int:
        """Number of records written since the memory was created."""
        return self._counter[0]

    def put(self, whole: bytes | memoryview) -> None:
        """Write the next record, ``size`` bytes. One writer only; never waits."""
        number = self._counter[0]
        start = number % self.slots * self.size
        self._bytes[start : start + self.size] = whole
        self._counter[0] = number + 1

    def one(self, number: int) -> bytes | None:
        """Return record ``number``, which must have been written; None if it was being overwritten meanwhile."""
        whole = self._copy(number % self.slots, 1)
        return None if self._first_intact() > number else whole

    def many(self, first: int, n: int) -> tuple[bytes, int]:
        """Return ``n`` records from ``first`` on, which must have been written, concatenated.

        The second value is how many of the first of them are invalid, because they were being overwritten meanwhile.
        """
        slot = first % self.slots
        to_the_end = min(n, self.slots - slot)
        whole = self._copy(slot, to_the_end) + self._copy(0, n - to_the_end)
        return whole, min(max(self._first_intact() - first, 0), n)

    def _first_intact(self) -> int:
        """Return the first record that is certainly intact: the writer may be writing to the slot of the one before."""
        return self._counter[0] - self.slots + 1

    def _copy(self, slot: int, n: int) -> bytes:
        return bytes(self._bytes[slot * self.size : (slot + n) * self.size])

    def release(self) -> None:
        """Release the memory."""
        self._counter.release()
        self._bytes.release()


def _digest(layout: str) -> bytes:
    return hashlib.blake2b(layout.encode(), digest_size=_DIGEST).digest()
