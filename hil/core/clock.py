"""Bench time: seconds since the bench was opened. Time is injected as a clock or a number.

And pauses of the host: times by which it let a thread continue later than planned.
"""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final, Protocol

from hil.core.part import provided

if TYPE_CHECKING:
    import asyncio


class Order(IntEnum):
    """Order of the participants of a bench in lock-step that have work at the same time."""

    COUPLER = 0
    AXES = 1
    CAMERAS = 2
    COUPLER_DRIVER = 3
    DRIVERS = 4
    REQUESTS = 5
    WATCHDOG = 6
    IO = 7
    LOOP = 8


class Clock(Protocol):
    """Bench time in seconds; ``speed`` is relative to real time (inf: no wall clock)."""

    @property
    def speed(self) -> float: ...

    def now_s(self) -> float: ...


class ClockEvent(Protocol):
    """Event with the interface of ``threading.Event``."""

    def is_set(self) -> bool: ...

    def set(self) -> None: ...

    def clear(self) -> None: ...

    def wait(self, timeout: float | None = None, /) -> bool: ...


class WireEnd(Protocol):
    """One end of a serial line, whose descriptor is an argument."""

    def wait(self, descriptor: int, wall_s: float) -> bool:
        """Wait at most ``wall_s`` until there is something to read; return whether there is."""

    def read(self, descriptor: int, size: int) -> bytes:
        """Return what has arrived, at most ``size`` bytes."""

    def write(self, descriptor: int, data: bytes) -> int:
        """Write ``data``; return the number of bytes that the line has taken."""

    def close(self) -> None:
        """Leave the line. Idempotent."""


class BenchClock(Clock, Protocol):
    """Bench time for drivers, emulators and servers, and every wait for it: by the wall clock, or in lock-step.

    Times named ``wall_s`` are wall time by the wall clock, and bench time in lock-step.
    """

    def host_s(self) -> float:
        """Return the monotonic time by which time-outs of programs are counted, s."""

    def wall_s(self, duration_s: float) -> float:
        """Return ``duration_s`` of bench time in s of wall time."""

    def paced_s(self, period_s: float) -> float:
        """Return the bench time between two steps of work of this host that is due every ``period_s`` in real time."""

    def poll_s(self, period_s: float) -> float:
        """Return the period of a server that is to check its devices every ``period_s``, s of wall time."""

    def idle_s(self, period_s: float) -> float:
        """Return the time, s of wall time, after which an exchange of ``period_s`` takes place without a trigger."""

    def sleep_until(self, t_s: float) -> None:
        """Sleep until bench time ``t_s``; return at once if that has passed."""

    def sleep(self, wall_s: float) -> None:
        """Sleep for ``wall_s``."""

    def event(self) -> ClockEvent:
        """Return an event, whose wait has its time-out in wall time."""

    def wire(self, key: str, end: int, of_line: bool = True) -> WireEnd:
        """Return an end of the wire ``key``: 0 of the emulated device, 1 of its driver.

        of_line: a serial line, rather than a connection.
        """

    def new_event_loop(self) -> asyncio.AbstractEventLoop:
        """Return an event loop whose time is wall time."""

    def start_thread(self, target: Callable[[], object], name: str, order: Order = Order.DRIVERS) -> threading.Thread:
        """Start and return a thread that waits by this clock."""

    def join(self, thread: threading.Thread, wall_s: float) -> None:
        """Wait at most ``wall_s`` for the end of a thread of ``start_thread``."""

    def wake(self, name: str, descriptor: int) -> None:
        """End the ``wait_wake`` of the process ``name``, by the eventfd ``descriptor``; never waits."""

    def wait_wake(self, descriptor: int, wall_s: float) -> None:
        """Wait at most ``wall_s`` for a ``wake``."""

    def release(self) -> None:
        """End all waits of this process: its parent ends it."""

    def configuration(self, order: Order, name: str) -> dict[str, Any]:
        """Return the clock of the child process ``name`` for ``clock_of``."""

    @property
    def descriptors(self) -> tuple[int, ...]:
        """Descriptors that a child process needs for this clock."""


def clock_of(configuration: Mapping[str, Any]) -> BenchClock:
    """Return the clock of a child process, of its configuration's key ``clock``."""
    if "page" not in configuration["clock"]:
        return WallClock(**configuration["clock"])
    clock: BenchClock = provided("rig.host.time=lock_step").attach(configuration["clock"])
    return clock


@dataclass(slots=True)
class SimulatedClock:
    """Time that changes only when ``t_s`` is set."""

    t_s: float = 0.0
    speed: float = field(default=float("inf"), init=False)

    def now_s(self) -> float:
        return self.t_s


@dataclass(frozen=True, slots=True)
class WallClock:
    """The monotonic clock of this host, scaled. Processes that share ``epoch_ns`` share bench time."""

    epoch_ns: int = field(default_factory=time.monotonic_ns)
    speed: float = 1.0

    def now_s(self) -> float:
        return (time.monotonic_ns() - self.epoch_ns) * 1e-9 * self.speed

    def wall_ns(self, t_s: float) -> int:
        """Return the monotonic time, ns, at which bench time will be ``t_s``."""
        return self.epoch_ns + round(t_s / self.speed * 1e9)

    def wall_s(self, duration_s: float) -> float:
        return duration_s / self.speed

    def paced_s(self, period_s: float) -> float:
        """Return the bench time between two steps of work of this host that is due every ``period_s`` in real time.

        Above real time the steps follow one another as fast as in real time: the host is no faster than before.
        """
        return period_s * max(1.0, self.speed)

    def sleep_until(self, t_s: float) -> None:
        left_ns = self.wall_ns(t_s) - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns * 1e-9)

    def host_s(self) -> float:
        return time.monotonic()

    def poll_s(self, period_s: float) -> float:
        return period_s

    def idle_s(self, period_s: float) -> float:
        return period_s / self.speed

    def sleep(self, wall_s: float) -> None:
        time.sleep(wall_s)

    def event(self) -> threading.Event:
        return threading.Event()

    def wire(self, key: str, end: int, of_line: bool = True) -> PlainWire:
        return PlainWire()

    def new_event_loop(self) -> asyncio.AbstractEventLoop:
        import asyncio  # takes 20 ms, and only drivers on wires need it

        return asyncio.new_event_loop()

    def start_thread(self, target: Callable[[], object], name: str, order: Order = Order.DRIVERS) -> threading.Thread:
        thread = threading.Thread(target=target, name=name, daemon=True)
        thread.start()
        return thread

    def join(self, thread: threading.Thread, wall_s: float) -> None:
        thread.join(wall_s)

    def wake(self, name: str, descriptor: int) -> None:
        os.eventfd_write(descriptor, 1)

    def wait_wake(self, descriptor: int, wall_s: float) -> None:
        if select.select([descriptor], [], [], wall_s)[0]:
            with suppress(BlockingIOError):
                os.eventfd_read(descriptor)

    def release(self) -> None:
        """Do nothing: every wait by the wall clock ends."""

    def configuration(self, order: Order, name: str) -> dict[str, Any]:
        return {"epoch_ns": self.epoch_ns, "speed": self.speed}

    @property
    def descriptors(self) -> tuple[int, ...]:
        return ()


class PlainWire:
    """End of a serial line by the wall clock."""

    def wait(self, descriptor: int, wall_s: float) -> bool:
        return bool(select.select([descriptor], [], [], wall_s)[0])

    def read(self, descriptor: int, size: int) -> bytes:
        return os.read(descriptor, size)

    def write(self, descriptor: int, data: bytes) -> int:
        return os.write(descriptor, data)

    def close(self) -> None:
        """Do nothing."""


def utc_ns() -> int:
    """Return nanoseconds since 1970, UTC."""
    return time.time_ns()


def utc_text(time_ns: int | None = None) -> str:
    """Return ``2026-03-01T14:05:06.123Z`` of ``time_ns``, by default of now; the texts sort by time."""
    when = datetime.fromtimestamp((utc_ns() if time_ns is None else time_ns) * 1e-9, UTC)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


_SHORTEST_S: Final = 0.005  # a shorter one is lateness, and no cause of a silence
_KEPT_S: Final = 1.0


class HostPauses:
    """The pause of a thread that was noted last; times are those of the monotonic clock, s."""

    def __init__(self) -> None:
        self._pause_s, self._at_s = 0.0, 0.0

    def note(self, late_s: float, wall_s: float) -> None:
        """Take a wait that has ended ``late_s`` late at ``wall_s``; it is a pause if it is long enough."""
        if late_s > _SHORTEST_S:
            self._pause_s, self._at_s = late_s, wall_s

    def recent_s(self, wall_s: float) -> float:
        """Return the pause, s, if it was within the last second; 0 otherwise."""
        return self._pause_s if wall_s - self._at_s < _KEPT_S else 0.0


def pause_text(what: str, pause_s: float) -> str:
    """Return a pause of ``what`` as an addition to the text of an alarm, with what to do; "" without one."""
    if pause_s <= 0.0:
        return ""
    return f" (the host paused {what} for {1e3 * pause_s:.0f} ms: end other programs, check with hil preflight)"
