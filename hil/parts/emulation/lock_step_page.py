"""Shared page of a bench in lock-step: bench time, slots of its participants, counts of the bytes on its wires."""

from __future__ import annotations

import fcntl
import hashlib
import mmap
import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final, Self

import numpy as np

from hil.core.clock import Order
from hil.core.jit import kernel

NOW, GRID, BATON, PASSES = range(4)
"""Words of the head: bench time, ns; longest step of servers and emulators, ns; slot at work; times that changed."""

STATE, DEADLINE, ORDER, PROCESS, WOKEN, SEEN, CALLED, ANSWERED, LISTENS, ACCEPTS = range(10)
"""Words of a slot. Bits of LISTENS: 2 * wire + end."""
FREE, WAITING, BUSY = 0, 1, 2
NEVER: Final = 2**62

KEY: Final = 0
SENT, RECEIVED, ATTACHED, CLOSED, OWNER = 1, 3, 5, 7, 9
"""Words of a wire: of its end 0; those of end 1 follow."""

LOOP_SLOT: Final = 0
AT_WORK: Final = -1
_SLOTS: Final = 32
_WIRES: Final = 31  # their ends are bits of a word
_NAME: Final = 48  # bytes
_TEXT: Final = 10  # word at which the name begins
_HEAD: Final = 8  # words
_SLOT_WORDS: Final = 16
_WIRE_WORDS: Final = 12
_WORDS: Final = _HEAD + _SLOTS * _SLOT_WORDS + _WIRES * _WIRE_WORDS


def slot_at(slot: int) -> int:
    """Return the first word of a slot."""
    return _HEAD + slot * _SLOT_WORDS


class LockStepPage:
    """The page in one process. wakes: descriptor of an eventfd per slot."""

    def __init__(self, descriptor: int, wakes: Sequence[int]) -> None:
        self.descriptor = descriptor
        self.wakes = tuple(wakes)
        self._map = mmap.mmap(descriptor, 8 * _WORDS)
        self.words = memoryview(self._map).cast("q")
        self._array = np.frombuffer(self._map, np.int64)
        self._lock = threading.Lock()
        self.next_work()  # compiles

    @classmethod
    def create(cls, grid_s: float) -> Self:
        """Create the page of a bench. grid_s: longest step of a server or an emulator, s."""
        descriptor = os.memfd_create("lock-step")
        os.ftruncate(descriptor, 8 * _WORDS)
        page = cls(descriptor, [os.eventfd(0, os.EFD_CLOEXEC) for _ in range(_SLOTS)])
        page.words[GRID] = round(1e9 * grid_s)
        return page

    def next_work(self) -> tuple[int, int]:
        """Return the slot that has the next work and its time, ns; AT_WORK while a participant is."""
        slot, due_ns = _next_work(self._array)
        return int(slot), int(due_ns)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Exclude all other threads and processes that add or remove slots and wires."""
        with self._lock:
            fcntl.lockf(self.descriptor, fcntl.LOCK_EX)
            try:
                yield
            finally:
                fcntl.lockf(self.descriptor, fcntl.LOCK_UN)

    def add_slot(self, order: Order, name: str) -> int:
        """Return the number of a new slot, whose participant is at work."""
        words = self.words
        with self.locked():
            slot = next(each for each in range(_SLOTS) if words[slot_at(each)] == FREE)
            at = slot_at(slot)
            for word in range(1, _SLOT_WORDS):
                words[at + word] = 0
            words[at + ORDER], words[at + PROCESS] = order, os.getpid()
            text = name.encode()[:_NAME].ljust(_NAME, b"\0")
            for part in range(_NAME // 8):
                words[at + _TEXT + part] = int.from_bytes(text[8 * part : 8 * part + 8], "little", signed=True)
            words[at + STATE] = BUSY
        return slot

    def remove_process(self, process: int) -> None:
        """Remove the slots of a process that has ended, and close its ends of wires."""
        words = self.words
        for slot in range(_SLOTS):
            if words[slot_at(slot) + PROCESS] == process:
                words[slot_at(slot) + STATE] = FREE
        for wire in range(_WIRES):
            at = wire_at(wire)
            for end in (0, 1):
                if words[at + OWNER + end] == process:
                    words[at + CLOSED + end] = 1

    def slots_of(self, process: int) -> list[int]:
        """Return the slots of a process."""
        words = self.words
        return [n for n in range(_SLOTS) if words[slot_at(n)] != FREE and words[slot_at(n) + PROCESS] == process]

    def at_work(self) -> list[int]:
        """Return the slots whose participants are at work, the loop's excepted."""
        return [slot for slot in range(1, _SLOTS) if self.words[slot_at(slot)] == BUSY]

    def name_of(self, slot: int) -> str:
        """Return the name of the participant."""
        at = slot_at(slot) + _TEXT
        text = b"".join(word.to_bytes(8, "little", signed=True) for word in self.words[at : at + _NAME // 8])
        return text.rstrip(b"\0").decode(errors="replace")

    def slot_of(self, name: str) -> int | None:
        """Return the slot of the participant ``name``, None if there is none."""
        taken = (each for each in range(_SLOTS) if self.words[slot_at(each)] != FREE)
        return next((each for each in taken if self.name_of(each) == name), None)

    def wire(self, key: str, end: int) -> int:
        """Return the number of the wire ``key`` with its ``end``, 0 or 1, attached to this process."""
        digest = int.from_bytes(hashlib.blake2b(key.encode(), digest_size=7).digest(), "little") + 1
        words = self.words
        with self.locked():
            slot = next((each for each in range(_WIRES) if words[wire_at(each) + KEY] == digest), None)
            if slot is None:
                slot = next(each for each in range(_WIRES) if words[wire_at(each) + KEY] == 0)
                for word in range(_WIRE_WORDS):
                    words[wire_at(slot) + word] = 0
                words[wire_at(slot) + KEY] = digest
            at = wire_at(slot)
            words[at + OWNER + end] = os.getpid()
            words[at + CLOSED + end] = 0
            words[at + ATTACHED + end] = 1
        return slot


def wire_at(wire: int) -> int:
    """Return the first word of a wire."""
    return _HEAD + _SLOTS * _SLOT_WORDS + wire * _WIRE_WORDS


@kernel
def _next_work(words: np.ndarray) -> tuple[int, int]:
    """Return the slot with the next work and its time, ns; AT_WORK while a participant is.

    The loop's comes after all others of the same time. A participant has work at its time, or now: bytes, the end of a
    wire, a call, or, of a server, a connection that has not been accepted.
    """
    now_ns = words[NOW]
    is_unaccepted = False
    for wire in range(_WIRES):
        at = _HEAD + _SLOTS * _SLOT_WORDS + wire * _WIRE_WORDS
        is_waiting = words[at + ATTACHED + 1] != 0 and words[at + ATTACHED] == 0 and words[at + CLOSED] == 0
        if words[at + KEY] != 0 and is_waiting:
            is_unaccepted = True
    best, best_ns, best_order = AT_WORK, NEVER, 1000
    for slot in range(_SLOTS):
        at = _HEAD + slot * _SLOT_WORDS
        if words[at] == BUSY:
            return AT_WORK, now_ns
        if words[at] == FREE:
            continue
        due_ns, order = max(words[at + DEADLINE], now_ns), words[at + ORDER]
        if words[at + WOKEN] != words[at + SEEN] or words[at + CALLED] != words[at + ANSWERED]:
            due_ns = now_ns
        listens = words[at + LISTENS]
        bit = 0
        while listens != 0 and due_ns > now_ns:
            if listens & 1 != 0:
                wire, end = _HEAD + _SLOTS * _SLOT_WORDS + (bit >> 1) * _WIRE_WORDS, bit & 1
                if words[wire + SENT + 1 - end] != words[wire + RECEIVED + end] or words[wire + CLOSED + 1 - end] != 0:
                    due_ns = now_ns
            listens >>= 1
            bit += 1
        if is_unaccepted and words[at + ACCEPTS] != 0:
            # each server looks in turn: the connection is one of theirs
            due_ns, order = now_ns, words[at + ACCEPTS] - 1000000
        if due_ns < best_ns or (due_ns == best_ns and order < best_order):
            best, best_ns, best_order = slot, due_ns, order
    return best, best_ns
