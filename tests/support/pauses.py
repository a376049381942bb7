"""Pauses of the computer that the tests run on, as far as other programs than the test cause them.

A process of its own sleeps for 5 ms at a time, passes a byte through a pseudo-terminal, and measures by how much it is
late. The pause is the lateness times the fraction of processor time that others used in that interval: what is neither
idle nor used by the test's tree, which is the process of the tests and its descendants, as well those that have ended.
A program that loads all cores by itself thus causes none, nor does a watcher that is stopped while cores are idle.

Under a high load the threads of a test wait often and for short times each, which the watcher, who mostly sleeps, does
not meet. A thread of the tree that waits for a processor for more than half of 0.1 s counts as a pause, too.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
import tty
from collections import deque
from contextlib import suppress
from typing import NamedTuple

PERIOD_S = 0.005
SHORTEST_S = 0.005
WAITS_PERIOD_S = 0.1
SHORTEST_WAITS = 0.5
"""Fraction of ``WAITS_PERIOD_S``."""
REPLY_S = 10.0
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


class Pause(NamedTuple):
    """End of an interval, s of the monotonic clock, its lateness, s, and the others' fraction of processor time."""

    end_s: float
    late_s: float
    fraction: float

    @property
    def duration_s(self) -> float:
        return self.late_s * self.fraction

    def __str__(self) -> str:
        return f"{1e3 * self.duration_s:.0f} ms ({1e3 * self.late_s:.0f} ms late, others had {self.fraction:.0%})"


class Usage(NamedTuple):
    """Processor time until ``time_s``, s: unused, and that of the test's tree."""

    time_s: float
    idle_s: float
    own_s: float


def pause_between(before: Usage, after: Usage, cores: int, waited_s: float | None = None) -> Pause:
    """Return the pause in an interval of the watcher; its fraction is 0 if the tree's time is not known.

    It lasts for ``waited_s``, by default for the lateness of the watcher.
    """
    length_s = after.time_s - before.time_s
    own_s, idle_s = after.own_s - before.own_s, max(0.0, after.idle_s - before.idle_s)
    fraction = 1.0 - (own_s + idle_s) / (cores * length_s) if own_s >= 0.0 else 0.0
    late_s = max(0.0, length_s - PERIOD_S) if waited_s is None else waited_s
    return Pause(after.time_s, late_s, max(0.0, fraction))


class ProcessTree:
    """A process and its descendants."""

    def __init__(self, root: int) -> None:
        self._members: dict[int, int] = {}  # the descriptor of each one's stat: it never becomes that of another
        self._seen: set[int] = set()
        self._last_pid = b""
        self._loadavg = os.open("/proc/loadavg", os.O_RDONLY)
        self._waited: dict[str, int] = {}
        self._add(root)

    def used_s(self) -> float:
        """Return the processor time of all members and of those that they have reaped, s.

        An orphan takes its time with it.
        """
        self._find_new()
        used_s = 0.0
        for pid, descriptor in tuple(self._members.items()):
            try:
                used_s += time.clock_gettime((~pid << 3) | 2)  # linux/posix-timers.h: all threads of the process
                reaped = _stat(descriptor)[13:15]
            except OSError:
                os.close(self._members.pop(pid))
                continue
            used_s += _TICK_S * sum(map(int, reaped))
        return used_s

    def longest_wait_s(self) -> float:
        """Return for how long the thread that waited longest has waited for a processor since the last call, s."""
        before, self._waited = self._waited, {}
        for pid in self._members:
            self._waited |= _waited(pid)
        return 1e-9 * max((ns - before.get(thread, ns) for thread, ns in self._waited.items()), default=0)

    def _find_new(self) -> None:
        if (last_pid := os.pread(self._loadavg, 100, 0).split()[-1]) == self._last_pid:
            return
        self._last_pid = last_pid
        pids = {int(name) for name in os.listdir("/proc") if name.isdigit()}
        new, self._seen = pids - self._seen, pids
        parents = {pid: _parent(pid) for pid in new if pid not in self._members}
        while children := [pid for pid, parent in parents.items() if parent in self._members]:
            for pid in children:
                del parents[pid]
                self._add(pid)

    def _add(self, pid: int) -> None:
        try:
            self._members[pid] = os.open(f"/proc/{pid}/stat", os.O_RDONLY)
        except OSError:
            return


def _stat(descriptor: int) -> list[bytes]:
    """Return the fields of a process behind its name: state, parent, ..."""
    return os.pread(descriptor, 1000, 0).rpartition(b")")[2].split()


def _waited(pid: int) -> dict[str, int]:
    """Return for how long each thread of a process has been ready without a processor, ns; empty if it has ended."""
    waited = {}
    with suppress(OSError):
        for thread in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{thread}/schedstat", "rb") as file:
                waited[thread] = int(file.read().split()[1])
    return waited


def _parent(pid: int) -> int:
    try:
        descriptor = os.open(f"/proc/{pid}/stat", os.O_RDONLY)
    except OSError:
        return 0
    try:
        return int(_stat(descriptor)[1])
    except OSError:
        return 0
    finally:
        os.close(descriptor)


class Pauses:
    """The pauses since ``begin``. Their watcher starts with the first interval."""

    def __init__(self) -> None:
        self._watcher: subprocess.Popen[bytes] | None = None
        self._begin_s = 0.0

    def begin(self) -> None:
        """Start a new interval."""
        if self._watcher is None:
            command = [sys.executable, "-IS", __file__, str(os.getpid())]
            self._watcher = subprocess.Popen(command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._begin_s = time.monotonic()

    def longest(self) -> Pause | None:
        """Return the longest pause since ``begin``, None without one. Raises TimeoutError if the watcher is silent."""
        assert self._watcher is not None
        assert self._watcher.stdin is not None
        assert self._watcher.stdout is not None
        os.write(self._watcher.stdin.fileno(), f"{self._begin_s}\n".encode())
        if not select.select([self._watcher.stdout], [], [], REPLY_S)[0]:
            raise TimeoutError("the watcher over the pauses of the computer is silent")
        numbers = [float(number) for number in self._watcher.stdout.readline().split()]
        return Pause(*numbers) if numbers else None


class _Watcher:
    """Samples every ``PERIOD_S``, for a process and its descendants."""

    def __init__(self, root: int) -> None:
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        self._tree = ProcessTree(root)
        self._processors = {f"cpu{number}".encode() for number in os.sched_getaffinity(0)}
        self._stat = os.open("/proc/stat", os.O_RDONLY)
        self._pauses = deque[Pause](maxlen=100_000)
        self._usage = self._usage_of_waits = self._measure()

    def sample(self) -> None:
        """Wait for the next sample, and note the pause if there was one."""
        time.sleep(PERIOD_S)
        os.write(self._near, b".")
        os.read(self._far, 1)
        before, self._usage = self._usage, self._measure()
        self._note(pause_between(before, self._usage, len(self._processors)), SHORTEST_S)
        before, length_s = self._usage_of_waits, self._usage.time_s - self._usage_of_waits.time_s
        if length_s > WAITS_PERIOD_S:
            self._usage_of_waits = self._usage
            waited_s = self._tree.longest_wait_s()
            pause = pause_between(before, self._usage, len(self._processors), waited_s)
            self._note(pause, SHORTEST_WAITS * length_s)

    def _note(self, pause: Pause, shortest_s: float) -> None:
        if pause.duration_s > shortest_s:
            self._pauses.append(pause)

    def longest(self, begin_s: float) -> Pause | None:
        return max(
            (each for each in self._pauses if each.end_s > begin_s), key=lambda each: each.duration_s, default=None
        )

    def _measure(self) -> Usage:
        own_s = self._tree.used_s()
        idle_s = 0.0
        for line in os.pread(self._stat, 1 << 16, 0).split(b"\n"):
            if not line.startswith(b"cpu"):
                break
            name, *ticks = line.split()
            if name in self._processors:  # idle + iowait, less what a hypervisor withheld: it counts as idle, too
                idle_s += _TICK_S * (int(ticks[3]) + int(ticks[4]) - int(ticks[7]))
        return Usage(time.monotonic(), idle_s, own_s)


def _watch(parent: int) -> None:
    """Answer each line on stdin, a time, with the longest pause since then, until the parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal
    watcher = _Watcher(parent)
    while os.getppid() == parent:
        watcher.sample()
        if select.select([0], [], [], 0.0)[0] and (line := os.read(0, 100)):
            pause = watcher.longest(float(line))
            os.write(1, f"{' '.join(map(str, pause or ()))}\n".encode())


if __name__ == "__main__":
    _watch(int(sys.argv[1]))
