"""Lock-step: bench time that advances when every participant of a bench has done its part, however long that takes.

A participant is a thread that drives, serves or emulates a device, in any process. Each has a slot in the shared page
with the time at which it next has work. One participant works at a time: when it has done its part, it sets bench time
to the earliest of those times and wakes the participant that has it, in a fixed order at equal times. Bytes on a wire
are counted by their sender; they are work of their receiver, at the time at which they were sent, and a receiver reads
exactly those that are counted. So neither the load of the computer nor the delay of a wire has an effect on the
sequence of events.
"""

from __future__ import annotations

import errno
import logging
import math
import os
import select
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from hil.core.child_process import child_of
from hil.core.clock import Order
from hil.core.plug_ins import Stack, place_in
from hil.errors import LinkTimeout
from hil.parts.emulation import lock_step_page as pages

if TYPE_CHECKING:
    import asyncio

log = logging.getLogger("hil")

_IDLE: Final = 1.25  # periods: what a cycle triggers comes before what nothing has triggered
_DEVICE: Final = 0  # end of a wire
_NOTICE_WALL_S: Final = 5.0  # after which a plug-in that all wait for is logged
_LOOK_WALL_S: Final = 0.1  # between two looks for a participant whose process has ended


class LockStepWire:
    """One end of a wire whose bytes are counted. key: the same for both ends. end: 0 of the device, 1 of its driver.

    of_line: a line persists when an end leaves it; what is sent without another end is lost. A connection ends with its
    first end.
    """

    def __init__(self, clock: LockStepClock, key: str, end: int, of_line: bool) -> None:
        self._clock, self._page, self._of_line = clock, clock.page, of_line
        self._words = clock.page.words
        wire = clock.page.wire(key, end)
        at = pages.wire_at(wire)
        self.listens = 1 << (2 * wire + end)
        self._at = at
        self._mine, self._theirs = end, 1 - end
        self._is_open = True

    @property
    def pending(self) -> int:
        """Number of bytes that are on their way to this end, or there."""
        return self._words[self._at + pages.SENT + self._theirs] - self._words[self._at + pages.RECEIVED + self._mine]

    @property
    def is_readable(self) -> bool:
        """Whether bytes are pending, or the other end has gone."""
        return self.pending > 0 or bool(self._words[self._at + pages.CLOSED + self._theirs])

    def wait(self, descriptor: int, wall_s: float) -> bool:
        """Wait at most ``wall_s`` until the wire is readable; return whether it is. Raises OSError after ``release``.

        descriptor: not used, the counts decide.
        """
        clock = self._clock
        deadline_ns = clock.deadline_ns(wall_s)
        while not self.is_readable:
            if clock.now_ns >= deadline_ns:
                return False
            if clock.wait_until_ns(deadline_ns, self.listens):
                raise OSError(errno.ESHUTDOWN, "the bench has ended")
        return True

    def read(self, descriptor: int, size: int) -> bytes:
        """Return the pending bytes, at most ``size``, as soon as the wire has delivered them."""
        remaining = min(self.pending, size)
        parts: list[bytes] = []
        while remaining > 0:
            select.select([descriptor], [], [])
            part = os.read(descriptor, remaining)
            if not part:
                break
            self.received(len(part))
            parts.append(part)
            remaining -= len(part)
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
        if self._of_line and not self._words[self._at + pages.ATTACHED + self._theirs]:
            return False
        self._words[self._at + pages.SENT + self._mine] += count
        return True

    def received(self, count: int) -> None:
        """Count bytes that have been read."""
        self._words[self._at + pages.RECEIVED + self._mine] += count

    def close(self) -> None:
        """Leave the wire. Idempotent."""
        if not self._is_open:
            return
        self._is_open = False
        words, at = self._words, self._at
        if self._of_line:
            words[at + pages.ATTACHED + self._mine] = 0
            words[at + pages.CLOSED + self._mine] = int(self._mine == _DEVICE)  # its driver finds it gone
            return
        with self._page.locked():
            words[at + pages.CLOSED + self._mine] = 1
            if words[at + pages.CLOSED + self._theirs] or not words[at + pages.ATTACHED + self._theirs]:
                words[at + pages.KEY] = 0


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
                self._clock.page.words[pages.slot_at(self._waiting) + pages.WOKEN] += 1
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
        deadline_ns = pages.NEVER if wall_s is None else self._clock.deadline_ns(wall_s)
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
    counts_bytes = True
    """Whether the time advances by the bytes of the wires."""

    def __init__(self, page: pages.LockStepPage, order: Order, name: str) -> None:
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
        page = pages.LockStepPage(configuration["page"], configuration["wakes"])
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
        return self._words[pages.NOW]

    def now_s(self) -> float:
        return self._words[pages.NOW] / 1e9

    def host_s(self) -> float:
        """Return the time by which time-outs of programs are counted, s."""
        return self.now_s()

    def wall_s(self, duration_s: float) -> float:
        return duration_s

    def paced_s(self, period_s: float) -> float:
        """Return the time between two steps of work that is due every ``period_s``, s: at least the grid."""
        return max(period_s, self._words[pages.GRID] / 1e9)

    poll_s = paced_s

    def idle_s(self, period_s: float) -> float:
        return _IDLE * period_s

    def deadline_ns(self, wall_s: float) -> int:
        """Return the bench time, ns, at which a wait of ``wall_s`` ends."""
        return self._deadline_ns(self.now_s() + wall_s) if wall_s > 0.0 else self.now_ns

    def _deadline_ns(self, t_s: float) -> int:
        """Return ``t_s`` in ns; later than now, however little, if it is."""
        if t_s > 1e-9 * pages.NEVER:
            return pages.NEVER
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
        from hil.parts.emulation.lock_step_asyncio import LockStepEventLoop

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
                self._words[pages.slot_at(slot) + pages.STATE] = pages.FREE
                if self._words[pages.BATON] == slot:
                    self._words[pages.BATON] = pages.LOOP_SLOT
                with suppress(OSError, IndexError):  # the bench has ended
                    os.eventfd_write(self.page.wakes[pages.LOOP_SLOT], 1)

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
            self._words[pages.slot_at(slot) + pages.CALLED] += 1

    def wait_wake(self, descriptor: int, wall_s: float) -> None:
        """Wait at most ``wall_s`` for a ``wake``."""
        self.wait_until_ns(self.deadline_ns(wall_s))

    def release(self) -> None:
        """End all waits of this process from now on: the loop that keeps the time has gone."""
        self._released = True
        for slot in self.page.slots_of(os.getpid()):
            os.eventfd_write(self.page.wakes[slot], 1)

    def wait_until_ns(self, deadline_ns: int, listens: int = 0, accepts: bool = False) -> bool:
        """Wait until ``deadline_ns``, or until this thread's participant has other work; return True after ``release``.

        listens: wire ends, by bits, whose bytes are work. accepts: as is a connection that has not been accepted yet.
        """
        if self._released:
            time.sleep(1e-3)  # what still runs ends with the process
            return True
        slot, words = self.slot, self._words
        at = pages.slot_at(slot)
        words[at + pages.DEADLINE], words[at + pages.LISTENS] = deadline_ns, listens
        words[at + pages.ACCEPTS] = words[at + pages.ACCEPTS] + 1 if accepts else 0
        words[at + pages.STATE] = pages.WAITING
        try:
            if words[pages.BATON] != slot:  # a thread that has begun, while another participant is at work
                os.eventfd_write(self.page.wakes[pages.LOOP_SLOT], 1)
                os.eventfd_read(self.page.wakes[slot])
            elif not self._pass_on(slot):
                os.eventfd_read(self.page.wakes[slot])
        except (OSError, IndexError):  # the bench has ended meanwhile
            if not self._released:
                raise
            return True
        self._begin(at)
        return self._released

    def _begin(self, at: int) -> None:
        words = self._words
        words[at + pages.STATE] = pages.BUSY
        words[at + pages.SEEN], words[at + pages.ANSWERED] = words[at + pages.WOKEN], words[at + pages.CALLED]

    def _pass_on(self, slot: int) -> bool:
        """Advance the time to the next work and wake its participant; return whether it is that of ``slot``.

        While threads that have begun are at work, the loop's process waits for them.
        """
        words = self._words
        following, due_ns = self.page.next_work()
        if following == pages.AT_WORK:
            following = pages.LOOP_SLOT
        elif due_ns != words[pages.NOW]:
            words[pages.NOW] = due_ns
            words[pages.PASSES] += 1
        words[pages.BATON] = following
        if following == slot:
            return True
        os.eventfd_write(self.page.wakes[following], 1)
        return False


class LockStepConductor(LockStepClock):
    """The clock of the loop's process, whose main participant watches over the others in its waits.

    grid_s: longest step of servers and emulators, s. timeout_s: wall time after which a participant that does not do
    its part is named.
    """

    def __init__(self, grid_s: float, timeout_s: float) -> None:
        super().__init__(pages.LockStepPage.create(grid_s), Order.LOOP, "loop")
        self._timeout_s = timeout_s

    def close(self) -> None:
        """Release the descriptors. Idempotent."""
        self._released = True
        wakes, self.page.wakes = self.page.wakes, ()
        for descriptor in wakes:
            os.close(descriptor)
        if wakes:
            os.close(self.page.descriptor)

    def wait_until_ns(self, deadline_ns: int, listens: int = 0, accepts: bool = False) -> bool:
        """Wait until ``deadline_ns``, or until the loop has other work. Raises LinkTimeout for a silent participant."""
        if self.slot != pages.LOOP_SLOT or self._released:
            return super().wait_until_ns(deadline_ns, listens, accepts)
        words = self._words
        at = pages.slot_at(pages.LOOP_SLOT)
        words[at + pages.DEADLINE], words[at + pages.LISTENS], words[at + pages.STATE] = (
            deadline_ns,
            listens,
            pages.WAITING,
        )
        moved_s, passes, is_noticed = time.monotonic(), words[pages.PASSES], False
        while not (words[pages.BATON] == pages.LOOP_SLOT and self._has_turn()):
            if select.select([self.page.wakes[pages.LOOP_SLOT]], [], [], _LOOK_WALL_S)[0]:
                os.eventfd_read(self.page.wakes[pages.LOOP_SLOT])
                continue
            now_s = time.monotonic()
            if words[pages.PASSES] != passes or any(map(_is_debugged, self._remove_ended())):
                moved_s, passes = now_s, words[pages.PASSES]
            if now_s - moved_s > _NOTICE_WALL_S and not is_noticed:
                is_noticed = True
                self._notice()
            if now_s - moved_s > self._timeout_s and not self._give_up():
                moved_s = time.monotonic()
        self._begin(at)
        return False

    def _has_turn(self) -> bool:
        """Return whether the next work is the loop's; let others do theirs before."""
        return self.page.next_work()[0] != pages.AT_WORK and self._pass_on(pages.LOOP_SLOT)

    def _late(self) -> list[int]:
        """Return the participants for which all others wait."""
        baton = self._words[pages.BATON]
        return sorted({*self.page.at_work(), *([baton] if baton != pages.LOOP_SLOT else [])})

    def _remove_ended(self) -> list[int]:
        """Remove the participants of processes that have ended; return the processes for which all others wait."""
        words, processes = self._words, []
        for slot in self._late():
            process = words[pages.slot_at(slot) + pages.PROCESS]
            if _state(process) in "ZX":
                self.page.remove_process(process)
                if words[pages.BATON] == slot:
                    words[pages.BATON] = pages.LOOP_SLOT
            else:
                processes.append(process)
        return processes

    def _stacks(self) -> dict[int, Stack]:
        """Return the stack of each process for which all others wait."""
        processes = {self._words[pages.slot_at(slot) + pages.PROCESS] for slot in self._late()}
        return {each: child.stack() if (child := child_of(each)) is not None else Stack() for each in processes}

    def _notice(self) -> None:
        """Log which code of a plug-in all others wait for."""
        names = ", ".join(map(self.page.name_of, self._late()))
        for where in filter(None, map(place_in, self._stacks().values())):
            log.warning(
                "%s: all wait for it at %.6f s of bench time: it stands %s, and is ended after %g s "
                "(rig.host.lock_step_timeout_s)", names, self.now_s(), where, self._timeout_s,
            )  # fmt: skip

    def _give_up(self) -> bool:
        """End the processes that do not do their part, whose wires end then, and name them: raise LinkTimeout.

        Return False if a debugger of Python stands in one of them.
        """
        late, stacks = self._late(), self._stacks()
        if any(stack.is_debugged for stack in stacks.values()):
            return False
        places = [*filter(None, map(place_in, stacks.values()))]
        names = ", ".join(map(self.page.name_of, late)) or "lock-step"
        text = f"has not done its part at {self.now_s():.6f} s of bench time within {self._timeout_s:g} s of wall time"
        for process in stacks:
            if process != os.getpid():
                os.kill(process, signal.SIGKILL)
            self.page.remove_process(process)
        self._words[pages.BATON] = pages.LOOP_SLOT
        self._begin(pages.slot_at(pages.LOOP_SLOT))
        raise LinkTimeout(names, f"{text} (lock-step){f': it stands {places[0]}' if places else ''}")


def _state(process: int) -> str:
    """Return the state of a process as in proc(5), "X" for one that has gone."""
    with suppress(OSError, IndexError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    return "X"


def _is_debugged(process: int) -> bool:
    """Return whether a debugger stands in a process."""
    with suppress(OSError):
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
        return any(line.startswith("TracerPid:") and line.split()[1] != "0" for line in lines)
    return False
