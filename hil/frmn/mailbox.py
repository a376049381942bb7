"""Mailboxes in shared memory: typed records of which the newest wins, one writer and any number of readers each."""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Final, NamedTuple

import numpy as np

from hil.errors import ProtocolError
from hil.frmn.shared_memory import Memory, Slots

_SLOTS: Final = 8  # values that a writer completes while a reader copies one, and the copy is still intact
_TRIES: Final = 1000  # against a writer that writes continuously; then the read fails
_STAMP: Final = struct.Struct("=dII")  # time, writer, checksum
_HEAD: Final = struct.Struct("=dI")  # the part of the stamp that the checksum covers, with the record


class Stamp(NamedTuple):
    """Stamp of a mailbox's newest value: number of values written up to it, writer's time, writer's process."""

    number: int
    t_s: float
    writer: int

    def age_s(self, now_s: float) -> float:
        """Return the age of the value at ``now_s`` of bench time; inf before the first."""
        return now_s - self.t_s if self.number else math.inf


NOTHING: Final = Stamp(0, 0.0, 0)
"""Stamp of a mailbox that was never written."""


class Mailbox:
    """One value of ``dtype`` with its writer, the time of writing and a checksum.

    The newest complete value can be read at any time, also while the next one is being written and after a
    writer has died in the middle of one; its time shows its age.
    """

    def __init__(self, name: str, dtype: np.dtype, content: memoryview) -> None:
        self.name = name
        self.dtype = dtype
        self._slots = Slots(content, self.size(dtype), _SLOTS)
        self._writer = 0  # this process, once it has written

    @staticmethod
    def size(dtype: np.dtype) -> int:
        """Return the size of one value with its stamp, bytes."""
        return _STAMP.size + dtype.itemsize

    @classmethod
    def memory_size(cls, dtype: np.dtype) -> int:
        """Return the size of a mailbox in memory, bytes."""
        return Slots.memory_size(cls.size(dtype), _SLOTS)

    @property
    def written(self) -> int:
        """Number of values written so far; unchanged, the last value read is still the newest."""
        return self._slots.written

    def write(self, record: np.ndarray | np.void, t_s: float) -> None:
        """Make ``record`` (one of ``dtype``) the newest value, written at ``t_s`` of bench time. Never waits.

        Raises ProtocolError, at the first value that this process writes, if another live process is the writer.
        """
        if not self._writer:
            self._take_over()
        body = record.tobytes()
        head = _HEAD.pack(t_s, self._writer)
        self._slots.put(head + zlib.crc32(body, zlib.crc32(head)).to_bytes(4, "little") + body)

    def read(self, into: np.ndarray) -> tuple[int, float]:
        """Copy the newest value into ``into``, shape (1,) of ``dtype``.

        Returns the number of values written up to this one, 0 for none yet (``into`` is unchanged), and
        its writer's bench time, s. Raises ProtocolError if the writer overruns every try.
        """
        number, t_s, _ = self.read_stamped(into)
        return number, t_s

    def read_stamped(self, into: np.ndarray) -> Stamp:
        """Read as ``read`` does, and return the stamp of the value."""
        overrun = False
        for _ in range(_TRIES):
            number = self._slots.written
            if number == 0:
                return NOTHING
            whole = self._slots.one(number - 1)
            if whole is None:
                overrun = True
                continue
            t_s, writer, checksum = _STAMP.unpack_from(whole)
            value = memoryview(whole)[_STAMP.size :]
            if zlib.crc32(value, zlib.crc32(whole[: _HEAD.size])) == checksum:
                into.view(np.uint8)[:] = np.frombuffer(value, np.uint8)
                return Stamp(number, t_s, writer)
        why = (
            "written faster than it can be read" if overrun else "its checksum is wrong: overwritten by another process"
        )
        raise ProtocolError(self.name, f"{why}: no complete value in {_TRIES} tries")

    def _take_over(self) -> None:
        """Become the writer, unless another one is alive."""
        number = self._slots.written
        last = self._slots.one(number - 1) if number else None
        writer = _STAMP.unpack_from(last)[1] if last is not None else 0
        if writer not in (0, os.getpid()) and _is_alive(writer):
            raise ProtocolError(self.name, f"process {os.getpid()} is a second writer: process {writer} is alive")
        self._writer = os.getpid()

    def release(self) -> None:
        """Release the memory."""
        self._slots.release()


class MailboxBlock:
    """Mailboxes by name in one shared memory; every process must give the same ones in the same order.

    ``block["rails"].write(...)``. The block takes ownership of ``descriptor``. Raises ProtocolError if its memory has
    another layout.
    """

    def __init__(self, descriptor: int, cells: Mapping[str, np.dtype], name: str = "frmn") -> None:
        self._memory = Memory(descriptor, name, _layout(cells), _size(cells))
        self._cells: dict[str, Mailbox] = {}
        start = 0
        for cell, dtype in cells.items():
            end = start + Mailbox.memory_size(dtype)
            self._cells[cell] = Mailbox(f"{name}.{cell}", dtype, self._memory.content[start:end])
            start = end

    @classmethod
    def create(cls, cells: Mapping[str, np.dtype], name: str = "frmn") -> MailboxBlock:
        """Create a block; pass ``descriptor`` to other processes (``pass_fds``)."""
        return cls(Memory.create(name, _layout(cells), _size(cells)), cells, name)

    @property
    def descriptor(self) -> int:
        return self._memory.descriptor

    def __getitem__(self, cell: str) -> Mailbox:
        return self._cells[cell]

    def close(self) -> None:
        """Release the memory; idempotent."""
        for cell in self._cells.values():
            cell.release()
        self._cells.clear()
        self._memory.close()


class SharedMailbox:
    """One mailbox in a shared memory of its own, which the loop writes and other processes read.

    Subclasses give its ``layout``, and the ``label`` of the memory. descriptor: of the memory, of which this object
    takes ownership; None: it is created.
    """

    layout: ClassVar[np.dtype]
    label: ClassVar[str]

    def __init__(self, descriptor: int | None = None) -> None:
        cells = {"value": self.layout}
        if descriptor is None:
            self._block = MailboxBlock.create(cells, self.label)
        else:
            self._block = MailboxBlock(descriptor, cells, self.label)
        self._mailbox, self._row = self._block["value"], np.zeros(1, self.layout)

    @property
    def descriptor(self) -> int:
        """To pass to other processes (``pass_fds``)."""
        return self._block.descriptor

    def close(self) -> None:
        """Release the memory; idempotent."""
        self._block.close()


def _is_alive(pid: int) -> bool:
    """Return whether a process is running; zombies are not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return False
    return state not in ("Z", "X")


def _layout(cells: Mapping[str, np.dtype]) -> str:
    return ", ".join(f"{_SLOTS} of {name} {dtype.descr}" for name, dtype in cells.items())


def _size(cells: Mapping[str, np.dtype]) -> int:
    return sum(Mailbox.memory_size(dtype) for dtype in cells.values())
