"""Typed cells in shared memory, newest value wins: one writer and any number of readers a cell."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Final

import numpy as np

from hil.errors import ProtocolError
from hil.frmn.memory import Memory
from hil.frmn.slots import Slots

_SLOTS: Final = 8  # values that a writer finishes while a reader copies one, and it is still whole
_TRIES: Final = 1000  # against a writer that does nothing but write; then the reader says so
_STAMP: Final = struct.Struct("=d")


class Cell:
    """One value of ``dtype`` with the time at which its writer wrote it.

    The newest whole value can be read at any time, also while the next one is being written and after a
    writer has died in the middle of one: then its time tells.
    """

    def __init__(self, name: str, dtype: np.dtype, content: memoryview) -> None:
        self.name = name
        self.dtype = dtype
        self._slots = Slots(content, self.size(dtype), _SLOTS)

    @staticmethod
    def size(dtype: np.dtype) -> int:
        """Return the bytes of one value with its time."""
        return _STAMP.size + dtype.itemsize

    @classmethod
    def room(cls, dtype: np.dtype) -> int:
        """Return how many bytes of memory a cell takes."""
        return Slots.room(cls.size(dtype), _SLOTS)

    def write(self, record: np.ndarray | np.void, t_s: float) -> None:
        """Make ``record`` (one of ``dtype``) the newest value, written at ``t_s`` of bench time. Never waits."""
        self._slots.put(_STAMP.pack(t_s) + record.tobytes())

    def read(self, into: np.ndarray) -> tuple[int, float]:
        """Copy the newest value into ``into``, shape (1,) of ``dtype``.

        Returns how many values have been written up to this one, 0 for none yet (``into`` is left alone), and
        its writer's bench time, s. Raises ProtocolError when the writer overruns every try.
        """
        for _ in range(_TRIES):
            number = self._slots.written
            if number == 0:
                return 0, 0.0
            whole = self._slots.one(number - 1)
            if whole is not None:
                into.view(np.uint8)[:] = np.frombuffer(whole, np.uint8, offset=_STAMP.size)
                return number, _STAMP.unpack_from(whole)[0]
        raise ProtocolError(self.name, f"written faster than it can be read: no whole value in {_TRIES} tries")

    def release(self) -> None:
        """Let go of the memory."""
        self._slots.release()


class Block:
    """Cells by name in one stretch of shared memory; every process must name the same ones in the same order.

    ``block["rails"].write(...)``. ``descriptor`` belongs to the block from now on. Raises ProtocolError when the
    memory behind it has another layout.
    """

    def __init__(self, descriptor: int, cells: Mapping[str, np.dtype], name: str = "frmn") -> None:
        self._memory = Memory(descriptor, name, _layout(cells), _room(cells))
        self._cells: dict[str, Cell] = {}
        start = 0
        for cell, dtype in cells.items():
            end = start + Cell.room(dtype)
            self._cells[cell] = Cell(f"{name}.{cell}", dtype, self._memory.content[start:end])
            start = end

    @classmethod
    def create(cls, cells: Mapping[str, np.dtype], name: str = "frmn") -> Block:
        """Make a new block; hand ``descriptor`` to other processes (``pass_fds``)."""
        return cls(Memory.create(name, _layout(cells), _room(cells)), cells, name)

    @property
    def descriptor(self) -> int:
        return self._memory.descriptor

    def __getitem__(self, cell: str) -> Cell:
        return self._cells[cell]

    def close(self) -> None:
        """Let go of the memory; idempotent."""
        for cell in self._cells.values():
            cell.release()
        self._cells.clear()
        self._memory.close()


def _layout(cells: Mapping[str, np.dtype]) -> str:
    return ", ".join(f"{_SLOTS} of {name} {dtype.descr}" for name, dtype in cells.items())


def _room(cells: Mapping[str, np.dtype]) -> int:
    return sum(Cell.room(dtype) for dtype in cells.values())
