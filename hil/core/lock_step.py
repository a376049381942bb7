"""Lock-step: bench time that advances when every participant of a bench has done its part, however long that takes.

A participant is a thread that drives, serves or emulates a device, in any process. Each has a slot in the shared page
with the time at which it next has work. Nothing but the conductor, the thread of the loop, wakes a participant: once
all of them wait, it sets bench time to the earliest of those times and wakes those that are due, in a fixed order, one
order after the other. Bytes on a wire are counted by their sender; they are work of their receiver, at the time at
which they were sent, and a receiver reads exactly those that are counted. So neither the load of the computer nor the
delay of a wire has an effect on the sequence of events.
"""

from __future__ import annotations

import fcntl
import hashlib
import math
import mmap
import os
import select
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from hil.core.clock import Order
from hil.errors import LinkTimeout

if TYPE_CHECKING:
    import asyncio

_SLOTS: Final = 32
_WIRES: Final = 32  # their ends are bits of one word
_NAME: Final = 32  # bytes
_HEAD: Final = 8  # words of the page's head
_NOW, _GRID = 0, 1

_SLOT_WORDS: Final = 16
(_STATE, _DEADLINE, _GRANTED, _TAKEN, _ORDER, _PROCESS, _WOKEN, _SEEN, _CALLED, _ANSWERED, _LISTENS, _ACCEPTS) = range(
    12
)
_TEXT: Final = 12  # words of the name begin here
_FREE, _WAITING, _BUSY = 0, 1, 2

_WIRE_WORDS: Final = 12
_KEY = 0
_SENT, _RECEIVED, _ATTACHED, _CLOSED, _OWNER = 1, 3, 5, 7, 9  # of end 0; the next word: of end 1

_NEVER: Final = 2**62
_LOOK_WALL_S: Final = 0.1  # between two looks for a participant whose process has ended
_SAME_TIME_MAX: Final = 200_000  # wake-ups at one bench time: more are a livelock


class LockStepPage:
    """The shared page: bench time, slots of the participants, counts of the wires. wakes: an eventfd per slot."""

    def __init__(self, descriptor: int, wakes: Sequence[int]) -> None:
        self.descriptor = descriptor
        self.wakes = tuple(wakes)
        self._map = mmap.mmap(descriptor, self._size())
        self.words = memoryview(self._map).cast("q")
        self._lock = threading.Lock()

    @classmethod
    def create(cls, grid_s: float) -> Self:
        """Create the page of a bench. grid_s: longest time between two steps of a server or an emulator, s."""
        descriptor = os.memfd_create("lock-step")
        os.ftruncate(descriptor, cls._size())
        page = cls(descriptor, [os.eventfd(0, os.EFD_CLOEXEC) for _ in range(_SLOTS)])
        page.words[_GRID] = round(1e9 * grid_s)
        return page

    @staticmethod
    def _size() -> int:
        return 8 * (_HEAD + _SLOTS * _SLOT_WORDS + _WIRES * _WIRE_WORDS)

    @property
    def grid_s(self) -> float:
        """Longest time between two steps of a server or an emulator, s."""
        return 1e-9 * self.words[_GRID]

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
            slot = next(each for each in range(_SLOTS) if words[self.slot_at(each)] == _FREE)
            at = self.slot_at(slot)
            for word in range(_SLOT_WORDS):
                words[at + word] = 0
            words[at + _ORDER], words[at + _PROCESS] = order, os.getpid()
            text = name.encode()[:_NAME].ljust(_NAME, b"\0")
            for part in range(_NAME // 8):
                words[at + _TEXT + part] = int.from_bytes(text[8 * part : 8 * part + 8], "little", signed=True)
            words[at + _STATE] = _BUSY
        return slot

    def remove_process(self, process: int) -> None:
        """Remove the slots of a process that has ended, and close its ends of wires."""
        words = self.words
        for slot in range(_SLOTS):
            if words[self.slot_at(slot) + _PROCESS] == process:
                words[self.slot_at(slot) + _STATE] = _FREE
        for wire in range(_WIRES):
            at = self.wire_at(wire)
            for end in (0, 1):
                if words[at + _OWNER + end] == process:
                    words[at + _CLOSED + end] = 1

    def slot_at(self, slot: int) -> int:
        """Return the first word of a slot."""
        return _HEAD + slot * _SLOT_WORDS

    def wire_at(self, wire: int) -> int:
        """Return the first word of a wire."""
        return _HEAD + _SLOTS * _SLOT_WORDS + wire * _WIRE_WORDS

    def name_of(self, slot: int) -> str:
        """Return the name of the participant."""
        at = self.slot_at(slot) + _TEXT
        text = b"".join(word.to_bytes(8, "little", signed=True) for word in self.words[at : at + _NAME // 8])
        return text.rstrip(b"\0").decode(errors="replace")

    def slot_of(self, name: str) -> int | None:
        """Return the slot of the participant ``name``, None if there is none."""
        taken = (each for each in range(_SLOTS) if self.words[self.slot_at(each)] != _FREE)
        return next((each for each in taken if self.name_of(each) == name), None)

    def wire(self, key: str, end: int) -> int:
        """Return the number of the wire ``key`` with its ``end``, 0 or 1, attached to this process."""
        digest = int.from_bytes(hashlib.blake2b(key.encode(), digest_size=7).digest(), "little") + 1
        words = self.words
        with self.locked():
            at = [self.wire_at(each) for each in range(_WIRES)]
            found = next((each for each in range(_WIRES) if words[at[each] + _KEY] == digest), None)
            if found is None:
                found = next(each for each in range(_WIRES) if words[at[each] + _KEY] == 0)
                for word in range(_WIRE_WORDS):
                    words[at[found] + word] = 0
                words[at[found] + _KEY] = digest
            words[at[found] + _OWNER + end] = os.getpid()
            words[at[found] + _CLOSED + end] = 0
            words[at[found] + _ATTACHED + end] = 1
        return found


class LockStepWire:
    """One end of a wire whose bytes are counted. key: the same for both ends. end: 0 of the device, 1 of its driver.

    of_line: a line persists when an end leaves it; what is sent to nobody is lost. A connection ends with one end.
    """

    def __init__(self, clock: LockStepClock, key: str, end: int, of_line: bool) -> None:
        self._clock, self._page, self._of_line = clock, clock.page, of_line
        self._words = clock.page.words
        wire = clock.page.wire(key, end)
        at = clock.page.wire_at(wire)
        self.listens = 1 << (2 * wire + end)
        self._at = at
        self._mine, self._theirs = end, 1 - end
        self._is_open = True

    @property
    def pending(self) -> int:
        """Number of bytes that are on their way to this end, or there."""
        return self._words[self._at + _SENT + self._theirs] - self._words[self._at + _RECEIVED + self._mine]

    @property
    def is_readable(self) -> bool:
        """Whether bytes are pending, or the other end has gone."""
        return self.pending > 0 or bool(self._words[self._at + _CLOSED + self._theirs])

    def wait(self, descriptor: int, wall_s: float) -> bool:
        """Wait at most ``wall_s`` until the wire is readable; return whether it is."""
        clock = self._clock
        deadline_ns = clock.deadline_ns(wall_s)
        while not self.is_readable:
            if clock.now_ns >= deadline_ns:
                return False
            if clock.wait_until_ns(deadline_ns, self.listens):
                return self.is_readable
        return True

    def read(self, descriptor: int, size: int) -> bytes:
        """Return the pending bytes, at most ``size``, as soon as the wire has delivered them."""
        wanted = min(self.pending, size)
        parts: list[bytes] = []
        while wanted > 0:
            select.select([descriptor], [], [])
            part = os.read(descriptor, wanted)
            if not part:
                break
            self.received(len(part))
            parts.append(part)
            wanted -= len(part)
        return b"".join(parts) if parts else os.read(descriptor, size) if self.is_readable else b""

    def write(self, descriptor: int, data: bytes) -> int:
        """Write ``data``; return how many bytes the line has taken. Without another end they are lost."""
        if not self.sending(len(data)):
            return len(data)
        taken = 0
        try:
            taken = os.write(descriptor, data)
        finally:
            self.sending(taken - len(data))
        return taken

    def sending(self, count: int) -> bool:
        """Count bytes before they are sent; False, and nothing is counted, for a line without another end."""
        if self._of_line and not self._words[self._at + _ATTACHED + self._theirs]:
            return False
        self._words[self._at + _SENT + self._mine] += count
        return True

    def received(self, count: int) -> None:
        """Count bytes that have been read."""
        self._words[self._at + _RECEIVED + self._mine] += count

    def close(self) -> None:
        """Leave the wire. Idempotent."""
        if not self._is_open:
            return
        self._is_open = False
        words, at = self._words, self._at
        if self._of_line:
            words[at + _ATTACHED + self._mine] = 0
            return
        with self._page.locked():
            words[at + _CLOSED + self._mine] = 1
            if words[at + _CLOSED + self._theirs] or not words[at + _ATTACHED + self._theirs]:
                words[at + _KEY] = 0


class LockStepEvent:
    """Event that wakes the participant that waits for it."""

    def __init__(self, clock: LockStepClock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._is_set = False
        self._waiting: int | None = None

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        with self._lock:
            self._is_set = True
            if self._waiting is not None:
                self._clock.page.words[self._clock.page.slot_at(self._waiting) + _WOKEN] += 1
                self._waiting = None

    def clear(self) -> None:
        self._is_set = False

    def begin(self) -> bool:
        """Let ``set`` wake this thread's participant in its next wait; return whether it is set already."""
        with self._lock:
            self._waiting = None if self._is_set else self._clock.slot
            return self._is_set

    def wait(self, wall_s: float | None = None) -> bool:
        """Wait at most ``wall_s`` for the event, for ever if None; return whether it is set."""
        deadline_ns = _NEVER if wall_s is None else self._clock.deadline_ns(wall_s)
        while not self.begin() and self._clock.now_ns < deadline_ns:
            if self._clock.wait_until_ns(deadline_ns):
                break
        self._waiting = None
        return self._is_set


class LockStepClock:
    """Bench time of a bench in lock-step, in one process. order: of the participant that serves this process.

    Durations in "wall time" of drivers are bench time here: the load of the computer ends no wait.
    """

    speed: float = 1.0

    def __init__(self, page: LockStepPage, order: Order, name: str) -> None:
        self.page = page
        self._words = page.words
        self._name = name
        self._main = page.add_slot(order, name)
        self._local = threading.local()
        self._ended: dict[threading.Thread, LockStepEvent] = {}
        self._released = False

    @classmethod
    def attach(cls, configuration: dict[str, Any]) -> Self:
        """Return the clock of a child process."""
        page = LockStepPage(configuration["page"], configuration["wakes"])
        return cls(page, Order(configuration["order"]), configuration["name"])

    def configuration(self, order: Order, name: str) -> dict[str, Any]:
        """Return the configuration with which a child process attaches; it needs the ``descriptors``."""
        return {"page": self.page.descriptor, "wakes": self.page.wakes, "order": int(order), "name": name}

    @property
    def descriptors(self) -> tuple[int, ...]:
        """Descriptors that a child process needs."""
        return (self.page.descriptor, *self.page.wakes)

    @property
    def slot(self) -> int:
        """Slot of this thread's participant."""
        slot: int = getattr(self._local, "slot", self._main)
        return slot

    @property
    def now_ns(self) -> int:
        """Bench time, ns."""
        return self._words[_NOW]

    def now_s(self) -> float:
        return self._words[_NOW] * 1e-9

    def host_s(self) -> float:
        """Return the time by which time-outs of programs are counted, s."""
        return self.now_s()

    def wall_s(self, duration_s: float) -> float:
        return duration_s

    def paced_s(self, period_s: float) -> float:
        """Return the time between two steps of work that is due every ``period_s``, s: at least the grid."""
        return max(period_s, self.page.grid_s)

    poll_s = paced_s

    def deadline_ns(self, wall_s: float) -> int:
        """Return the bench time, ns, at which a wait of ``wall_s`` ends."""
        return self._deadline_ns(self.now_s() + wall_s) if wall_s > 0.0 else self.now_ns

    def _deadline_ns(self, t_s: float) -> int:
        """Return ``t_s`` in ns; later than now, however little, if it is."""
        if t_s > 1e-9 * _NEVER:
            return _NEVER
        least_ns = self.now_ns + (t_s > self.now_s())
        return max(least_ns, math.ceil(1e9 * t_s - 1e-3))

    def sleep_until(self, t_s: float) -> None:
        deadline_ns = self._deadline_ns(t_s)
        while self.now_ns < deadline_ns:
            if self.wait_until_ns(deadline_ns):
                return

    def sleep(self, wall_s: float) -> None:
        self.sleep_until(self.now_s() + wall_s)

    def event(self) -> LockStepEvent:
        return LockStepEvent(self)

    def wire(self, key: str, end: int, of_line: bool = True) -> LockStepWire:
        return LockStepWire(self, key, end, of_line)

    def new_event_loop(self) -> asyncio.AbstractEventLoop:
        from hil.core.lock_step_asyncio import LockStepEventLoop

        return LockStepEventLoop(self)

    def start_thread(self, target: Callable[[], object], name: str, order: Order = Order.DRIVERS) -> threading.Thread:
        """Start a thread that is a participant; it is at work when this returns."""
        slot, ended = self.page.add_slot(order, f"{self._name} {name}"), self.event()

        def run() -> None:
            self._local.slot = slot
            try:
                target()
            finally:
                ended.set()
                self._words[self.page.slot_at(slot) + _STATE] = _FREE
                self._poke()

        thread = threading.Thread(target=run, name=name, daemon=True)
        self._ended = {each: event for each, event in self._ended.items() if each.is_alive()} | {thread: ended}
        thread.start()
        return thread

    def join(self, thread: threading.Thread, wall_s: float) -> None:
        """Wait at most ``wall_s`` for the end of a thread of ``start_thread``."""
        if (ended := self._ended.get(thread)) is None or ended.wait(wall_s):
            thread.join()

    def wake(self, name: str, descriptor: int) -> None:
        """Let the participant ``name`` do its next step now."""
        if (slot := self.page.slot_of(name)) is not None:
            self._words[self.page.slot_at(slot) + _CALLED] += 1

    def wait_wake(self, descriptor: int, wall_s: float) -> None:
        """Wait at most ``wall_s`` for a ``wake``."""
        self.wait_until_ns(self.deadline_ns(wall_s))

    def release(self) -> None:
        """End all waits of this process from now on: the loop that keeps the time has gone."""
        self._released = True
        for slot in range(_SLOTS):
            if self._words[self.page.slot_at(slot) + _PROCESS] == os.getpid():
                os.eventfd_write(self.page.wakes[slot], 1)

    def wait_until_ns(self, deadline_ns: int, listens: int = 0, accepts: bool = False) -> bool:
        """Wait until ``deadline_ns``, or until this thread's participant has other work; return True after ``release``.

        listens: wire ends, by bits, whose bytes are work. accepts: as is a connection that nobody has accepted.
        """
        if self._released:
            time.sleep(1e-3)  # what still runs ends with the process
            return True
        slot, words = self.slot, self._words
        at = self.page.slot_at(slot)
        words[at + _DEADLINE], words[at + _LISTENS], words[at + _ACCEPTS] = deadline_ns, listens, accepts
        words[at + _STATE] = _WAITING
        self._poke()
        os.eventfd_read(self.page.wakes[slot])
        words[at + _STATE] = _BUSY
        words[at + _SEEN], words[at + _ANSWERED] = words[at + _WOKEN], words[at + _CALLED]
        words[at + _TAKEN] = words[at + _GRANTED]
        return self._released

    def _poke(self) -> None:
        os.eventfd_write(self.page.wakes[0], 1)


class LockStepConductor(LockStepClock):
    """The clock of the loop's process, whose main participant advances the time in its own waits; it has slot 0.

    timeout_s: wall time after which a participant that does not answer is named. Others than the loop's thread wait in
    no lock-step: they are not part of it.
    """

    def __init__(self, grid_s: float, timeout_s: float) -> None:
        super().__init__(LockStepPage.create(grid_s), Order.LOOP, "loop")
        assert self._main == 0
        self._timeout_s = timeout_s
        self._at_this_time = 0

    def close(self) -> None:
        """Release the descriptors. Idempotent."""
        self._released = True
        wakes, self.page.wakes = self.page.wakes, ()
        for descriptor in wakes:
            os.close(descriptor)
        if wakes:
            os.close(self.page.descriptor)

    def wait_until_ns(self, deadline_ns: int, listens: int = 0, accepts: bool = False) -> bool:
        """Advance the time to ``deadline_ns``, or until the loop has other work. Raises LinkTimeout."""
        words, page = self._words, self.page
        while True:
            self._await_all()
            due_ns, order, slots = self._next()
            own = page.slot_at(self._main)
            has_work = self._has_bytes(listens) or words[own + _WOKEN] != words[own + _SEEN]
            words[own + _SEEN] = words[own + _WOKEN]
            mine_ns = words[_NOW] if has_work else max(deadline_ns, words[_NOW])
            if mine_ns < due_ns or (mine_ns == due_ns and order > Order.LOOP) or not slots:
                self._set_now(min(mine_ns, due_ns) if slots else mine_ns)
                return False
            self._set_now(due_ns)
            for slot in slots:
                words[page.slot_at(slot) + _GRANTED] += 1
                os.eventfd_write(page.wakes[slot], 1)

    def _set_now(self, now_ns: int) -> None:
        self._at_this_time = self._at_this_time + 1 if now_ns == self._words[_NOW] else 0
        if self._at_this_time > _SAME_TIME_MAX:
            raise LinkTimeout(
                "lock-step", f"bench time stands at {self.now_s():.6f} s: {self._listed(self._next()[2])}"
            )
        self._words[_NOW] = now_ns

    def _await_all(self) -> None:
        """Return once all participants wait. Raises LinkTimeout for one that does not."""
        begun_s = time.monotonic()
        while late := self._at_work():
            if select.select([self.page.wakes[0]], [], [], _LOOK_WALL_S)[0]:
                os.eventfd_read(self.page.wakes[0])
                continue
            for slot in late:
                process = self._words[self.page.slot_at(slot) + _PROCESS]
                if _state(process) in "ZX":
                    self.page.remove_process(process)
                elif _is_debugged(process):
                    begun_s = time.monotonic()
            if time.monotonic() - begun_s > self._timeout_s and (late := self._at_work()):
                text = f"has not done its part at {self.now_s():.6f} s of bench time within {self._timeout_s:g} s"
                for slot in late:
                    self.page.remove_process(self._words[self.page.slot_at(slot) + _PROCESS])
                raise LinkTimeout(self._listed(late), f"{text} of wall time (lock-step)")

    def _listed(self, slots: Sequence[int]) -> str:
        return ", ".join(map(self.page.name_of, slots))

    def _at_work(self) -> list[int]:
        """Return the participants that do not wait."""
        words, found = self._words, []
        at = _HEAD
        for slot in range(1, _SLOTS):
            at += _SLOT_WORDS
            state = words[at]
            if state == _BUSY or (state == _WAITING and words[at + _GRANTED] != words[at + _TAKEN]):
                found.append(slot)
        return found

    def _next(self) -> tuple[int, int, list[int]]:
        """Return the time, ns, of the earliest work, its order, and the participants that have it."""
        words, now_ns = self._words, self._words[_NOW]
        best, slots = (_NEVER, int(Order.LOOP) + 1), list[int]()
        at = _HEAD
        for slot in range(1, _SLOTS):
            at += _SLOT_WORDS
            if words[at] != _WAITING:
                continue
            due_ns, order = words[at + _DEADLINE], words[at + _ORDER]
            if words[at + _ACCEPTS] and self._has_unaccepted():
                due_ns, order = now_ns, -1  # of one of the servers, each of which looks
            elif due_ns > now_ns and (
                words[at + _WOKEN] != words[at + _SEEN]
                or words[at + _CALLED] != words[at + _ANSWERED]
                or self._has_bytes(words[at + _LISTENS])
            ):
                due_ns = now_ns
            key = (max(due_ns, now_ns), order)
            if key < best:
                best, slots = key, [slot]
            elif key == best:
                slots.append(slot)
        return (*best, slots)

    def _has_bytes(self, listens: int) -> bool:
        """Return whether one of the wire ends, given by bits, is readable."""
        words, page = self._words, self.page
        while listens:
            bit = (listens & -listens).bit_length() - 1
            listens &= listens - 1
            at, end = page.wire_at(bit >> 1), bit & 1
            if words[at + _SENT + 1 - end] != words[at + _RECEIVED + end] or words[at + _CLOSED + 1 - end]:
                return True
        return False

    def _has_unaccepted(self) -> bool:
        """Return whether a client has connected to a server that has not accepted it yet."""
        words = self._words
        for wire in range(_WIRES):
            at = self.page.wire_at(wire)
            if words[at + _KEY] and words[at + _ATTACHED + 1] and not words[at + _ATTACHED]:
                return True
        return False


def _state(process: int) -> str:
    """Return the state of a process as of proc(5), "X" for one that has gone."""
    with suppress(OSError, IndexError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    return "X"


def _is_debugged(process: int) -> bool:
    """Return whether a debugger stands in a process."""
    with suppress(OSError):
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
        return any(line.startswith("TracerPid:") and line.split()[1] != "0" for line in lines)
    return False
