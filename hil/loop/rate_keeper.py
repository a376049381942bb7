"""Rate keeper of the loop: absolute deadlines; late cycles are counted, never made up.

The wait for a deadline is outside of Python: sleep, then spin, without the interpreter's lock.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import types

from hil.core.clock import BenchClock, Clock, HostPauses, SimulatedClock, WallClock
from hil.core.jit import kernel

_MONOTONIC: Final = 1  # CLOCK_MONOTONIC, linux/time.h
_ABSOLUTE: Final = 1  # TIMER_ABSTIME
_SECOND_NS: Final = 1_000_000_000

# functions of the C library, found by name when a kernel is loaded: (clock, timespec), (clock, flags, timespec, 0)
_clock_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.uintp))
_clock_nanosleep: Any = types.ExternalFunction(
    "clock_nanosleep", types.int32(types.int32, types.int32, types.uintp, types.uintp)
)


@kernel
def wait_until(deadline_ns, spin_ns, timespec):
    """Sleep until ``spin_ns`` before ``deadline_ns`` of the monotonic clock, spin to it; return that clock, ns.

    A signal ends the sleep: the result is then earlier than the deadline, and the caller lets Python handle the signal
    and calls again. timespec: scratch, (2,) of int64.
    """
    address = timespec.ctypes.data
    _clock_gettime(_MONOTONIC, address)
    now_ns = timespec[0] * _SECOND_NS + timespec[1]
    wake_ns = deadline_ns - spin_ns
    if now_ns < wake_ns:
        timespec[0], timespec[1] = wake_ns // _SECOND_NS, wake_ns % _SECOND_NS
        interrupted = _clock_nanosleep(_MONOTONIC, _ABSOLUTE, address, 0)
        _clock_gettime(_MONOTONIC, address)
        now_ns = timespec[0] * _SECOND_NS + timespec[1]
        if interrupted != 0:
            return now_ns
    while now_ns < deadline_ns:
        _clock_gettime(_MONOTONIC, address)
        now_ns = timespec[0] * _SECOND_NS + timespec[1]
    return now_ns


_PAUSE_S = 0.001
_SPIN_NS = 200_000  # the last of each wait: the kernel's wake-up is coarser than this
_RETURN_NS = 6_000  # from compiled code, with the interpreter's lock: the rest of the wait is in Python
_SPIN_FRACTION = 0.5  # of a period at most: the kernel preempts a real-time thread that never sleeps


@dataclass(frozen=True, slots=True)
class Tick:
    """Start of one cycle: bench time, bench time at which run time is zero, and lateness in wall time.

    skipped: periods lost because the previous cycle ended ``overrun_s`` (wall time) after this one's deadline.
    """

    now_s: float
    run_zero_s: float
    lateness_s: float
    skipped: int = 0
    overrun_s: float = 0.0


class Rate:
    """Starts each cycle and counts since ``restart``: executed + skipped_periods == elapsed periods."""

    paced = True
    """Whether time passes between cycles: in real time, or in lock-step."""
    _clock: Clock

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self.executed = 0
        """Cycles started."""
        self.overruns = 0
        """Cycles that ended after the deadline of the next one."""
        self.skipped_periods = 0
        """Periods in which no cycle started, because an earlier one was still running."""
        self.restart()

    @property
    def pause_s(self) -> float:
        """Longest time, s of wall time, by which the host woke the loop late in the last second; 0 without a pause."""
        return 0.0

    def now_s(self) -> float:
        """Return bench time."""
        return self._clock.now_s()

    def restart(self) -> None:
        """Start a new count; its cycle 0 is one period from now."""
        self._zero_s = self._clock.now_s() + self._step_s
        self.executed = self.overruns = self.skipped_periods = 0

    def wait(self) -> Tick:
        """Wait for the next cycle's deadline."""
        raise NotImplementedError

    def pause(self) -> None:
        """Let a short time pass outside of the cycles, and other threads run."""
        time.sleep(_PAUSE_S)


class SimulatedRate(Rate):
    """Simulated time without waiting: cycle k is at exactly ``k * step_s`` after the restart."""

    paced = False
    _clock: SimulatedClock

    def __init__(self, clock: SimulatedClock, step_s: float) -> None:
        self._clock = clock
        super().__init__(step_s)

    def restart(self) -> None:
        super().restart()
        self._zero_s = self._clock.now_s()

    def seek(self, cycle: int) -> None:
        """Make ``cycle``, counted from the restart, the next one."""
        self.executed = cycle

    def wait(self) -> Tick:
        self._clock.t_s = self._zero_s + self.executed * self._step_s
        self.executed += 1
        return Tick(self._clock.t_s, self._zero_s, 0.0)


class LockStepRate(Rate):
    """Bench time in lock-step: a cycle is never late, so it has no lateness: nan."""

    _clock: BenchClock

    def __init__(self, clock: BenchClock, step_s: float) -> None:
        self._clock = clock
        super().__init__(step_s)

    def wait(self) -> Tick:
        while (due_s := self._zero_s + self.executed * self._step_s) < self._clock.now_s():
            self._zero_s += self._step_s  # as after the opening of a device
        self._clock.sleep_until(due_s)
        self.executed += 1
        return Tick(self._clock.now_s(), self._zero_s, math.nan)

    def pause(self) -> None:
        self._clock.sleep(_PAUSE_S)


class WallClockRate(Rate):
    """Absolute deadlines on the monotonic clock.

    A cycle that ends after the next deadline is an overrun: the periods that it covers are skipped and counted, and
    run time is delayed by them; no cycle is made up. The wait holds no lock of the interpreter: other threads of the
    process run meanwhile.
    """

    _clock: WallClock

    def __init__(self, clock: WallClock, step_s: float) -> None:
        self._clock = clock
        self._period_ns = round(step_s / clock.speed * 1e9)
        self._spin_ns = min(_SPIN_NS, int(_SPIN_FRACTION * self._period_ns))
        self._timespec = np.zeros(2, np.int64)
        wait_until(0, 0, self._timespec)  # loads the kernel before the first deadline
        self._pauses = HostPauses()
        super().__init__(step_s)

    def restart(self) -> None:
        super().restart()
        self._deadline_ns = time.monotonic_ns()
        self._zero_s = self._bench_s(self._deadline_ns + self._period_ns)

    @property
    def pause_s(self) -> float:
        return self._pauses.recent_s(1e-9 * time.monotonic_ns())

    def wait(self) -> Tick:
        self._deadline_ns += self._period_ns
        late_ns = time.monotonic_ns() - self._deadline_ns
        skipped = 0
        if late_ns >= 0:
            skipped = late_ns // self._period_ns + 1
            self.overruns += 1
            self.skipped_periods += skipped
            self._deadline_ns += skipped * self._period_ns
            self._zero_s += skipped * self._step_s
        nearly_ns = self._deadline_ns - _RETURN_NS
        spin_ns = max(0, self._spin_ns - _RETURN_NS)
        while wait_until(nearly_ns, spin_ns, self._timespec) < nearly_ns:
            pass  # a signal: Python handles it here
        while (now_ns := time.monotonic_ns()) < self._deadline_ns:
            pass
        self.executed += 1
        lateness_s = (now_ns - self._deadline_ns) * 1e-9
        if lateness_s > self._pauses.recent_s(1e-9 * now_ns):
            self._pauses.note(lateness_s, 1e-9 * now_ns)
        if not skipped:
            return Tick(self._bench_s(now_ns), self._zero_s, lateness_s)
        return Tick(self._bench_s(now_ns), self._zero_s, lateness_s, skipped, late_ns * 1e-9)

    def _bench_s(self, monotonic_ns: int) -> float:
        return (monotonic_ns - self._clock.epoch_ns) * 1e-9 * self._clock.speed
