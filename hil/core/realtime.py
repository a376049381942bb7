"""Real-time privileges requested from the operating system: scheduling policy, locked memory, timer slack.

Any request may be refused; the run continues without it and reports the refusal. All are undone at the end.
"""

from __future__ import annotations

import ctypes
import errno
import gc
import os
import platform
import resource
import signal
import struct
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from typing import Final, Protocol, Self

from hil.errors import BenchError

FIFO_PRIORITY: Final = 80
FIFO, NICE, SLICE, MEMORY, SLACK, CPU = "sched_fifo", "nice", "slice", "mlockall", "timer_slack", "cpu"
REAL_TIME: Final = (FIFO, MEMORY)
"""Without these, other processes of the computer delay the loop."""

_NICE: Final = -15
_SLICE_NS: Final = 100_000  # the shortest that the scheduler accepts: a short slice is an early deadline
_SLACK_NS: Final = 1
SWITCH_INTERVAL_S: Final = 5e-5  # damage limit for the I/O threads that share the loop's interpreter

_MCL_CURRENT, _MCL_FUTURE = 1, 2  # linux/mman.h
_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30  # linux/prctl.h
_CAP_IPC_LOCK: Final = 14  # linux/capability.h
_SYS_SCHED_SETATTR, _SYS_SCHED_GETATTR = {"x86_64": (314, 315)}.get(platform.machine(), (274, 275))
_SCHED_ATTR: Final = struct.Struct("=IIQiIQQQ")  # linux/sched/types.h: size policy flags nice priority runtime ...

_HINTS: Final = {
    FIFO: "rtprio 80 in limits.conf, or a container with --cap-add=SYS_NICE",
    MEMORY: "memlock unlimited in limits.conf, or a container with --ulimit memlock=-1",
    NICE: "nice -15 in limits.conf, or a container with --cap-add=SYS_NICE",
    SLICE: "Linux 6.12 or newer",
}


@dataclass(frozen=True, slots=True)
class Grant:
    """Result of one request: its name, whether it was granted, what was granted or why not, and a hint."""

    name: str
    granted: bool
    detail: str
    hint: str = ""

    def __str__(self) -> str:
        if self.granted:
            return self.detail
        return f"{self.name} refused: {self.detail}" + (f"; would help: {self.hint}" if self.hint else "")


class SchedulingPolicy(Protocol):
    """Privileges of the loop, and the priority of its thread while cycles have deadlines."""

    grants: list[Grant]

    def realtime_priority(self) -> AbstractContextManager[None]:
        """Give the calling thread the loop's priority as long as this lasts. Raises BenchError if that fails."""


class DefaultScheduling:
    """For simulated time, which has no deadlines."""

    def __init__(self) -> None:
        self.grants: list[Grant] = []

    def realtime_priority(self) -> AbstractContextManager[None]:
        return nullcontext()


class RealTime:
    """Requests all privileges; a context in which the bench is opened, run and closed.

    Entering locks the memory (some 0.5 s: do it before a drive is enabled), raises the niceness of this process and of
    the threads and processes that it starts, and tests whether SCHED_FIFO is allowed. ``realtime_priority`` gives the
    loop's thread its real-time priority. No other thread gets it: together they can fill a core, and the kernel then
    withholds 50 ms of each second from all of them.

    fifo: whether to request SCHED_FIFO. cpu: the CPU of the loop's thread, None for any.
    """

    def __init__(self, fifo: bool = True, cpu: int | None = None) -> None:
        self._fifo = fifo
        self._cpu = cpu
        self.grants: list[Grant] = []
        self._undo: list[Callable[[], object]] = []

    def __enter__(self) -> Self:
        self.grants.clear()
        before_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._undo.append(lambda: sys.setswitchinterval(before_s))
        self._request(MEMORY, self._lock_memory)
        self._request(FIFO, self._try_fifo)
        self._request(NICE, self._raise_niceness)
        return self

    def __exit__(self, *_: object) -> None:
        self._undo_all()

    def refused(self) -> list[Grant]:
        """Return the requests refused so far."""
        return [grant for grant in self.grants if not grant.granted]

    def granted(self, name: str) -> bool:
        """Return whether the request ``name`` was made and granted."""
        return any(grant.granted for grant in self.grants if grant.name == name)

    @contextmanager
    def realtime_priority(self) -> Iterator[None]:
        """Give the calling thread its CPU, timer slack and policy; threads that it starts do not inherit the policy."""
        outside, self._undo = self._undo, []
        try:
            if self._cpu is not None:
                self._request(CPU, self._stay_on_cpu)
            self._request(SLACK, _cut_timer_slack, self._undo)
            if self.granted(FIFO):
                self._enter_fifo()
            else:
                self._request(SLICE, _shorten_slice, self._undo)
            yield
        finally:
            self._undo_all()
            self._undo = outside

    def _undo_all(self) -> None:
        while self._undo:
            self._undo.pop()()

    def _request(self, name: str, request: Callable[..., str], *arguments: object) -> None:
        try:
            self.grants.append(Grant(name, True, request(*arguments)))
        except OSError as refusal:
            hint = "" if refusal.errno == errno.ECANCELED else _HINTS.get(name, "")
            self.grants.append(Grant(name, False, _why(refusal), hint))

    def _lock_memory(self) -> str:
        """Lock all pages; future ones only if no limit could make a later allocation fail."""
        free = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY or _has_capability(
            _CAP_IPC_LOCK
        )
        _call("mlockall", _MCL_CURRENT | (_MCL_FUTURE if free else 0))
        self._undo.append(lambda: _call("munlockall"))
        return "all memory locked" if free else "memory of the start locked"

    def _try_fifo(self) -> str:
        if not self._fifo:
            raise OSError(errno.ECANCELED, "switched off by host.fifo")
        previous = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
        os.sched_setscheduler(0, *previous)
        return f"SCHED_FIFO {FIFO_PRIORITY}"

    def _enter_fifo(self) -> None:
        previous = os.sched_getscheduler(0), os.sched_getparam(0)

        def restore() -> None:
            try:
                os.sched_setscheduler(0, *previous)
            except PermissionError:  # without CAP_SYS_NICE the reset-on-fork flag stays
                os.sched_setscheduler(0, previous[0] | os.SCHED_RESET_ON_FORK, previous[1])

        try:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(FIFO_PRIORITY))
        except OSError as refusal:
            raise BenchError(f"host: SCHED_FIFO was granted before and is refused now: {_why(refusal)}") from refusal
        self._undo.append(restore)

    def _raise_niceness(self) -> str:
        previous = os.getpriority(os.PRIO_PROCESS, 0)
        os.setpriority(os.PRIO_PROCESS, 0, min(_NICE, previous))
        self._undo.append(lambda: os.setpriority(os.PRIO_PROCESS, 0, previous))
        return f"niceness {min(_NICE, previous)} for drivers and emulators"

    def _stay_on_cpu(self) -> str:
        assert self._cpu is not None
        previous = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {self._cpu})
        self._undo.append(lambda: os.sched_setaffinity(0, previous))
        return f"loop on CPU {self._cpu}"


@contextmanager
def short_turns() -> Iterator[None]:
    """Let other programs delay the wake-ups of this process, and of what it starts, little, if the system allows it.

    For many processes that wake one another, each with short work: in lock-step.
    """
    undo: list[Callable[[], object]] = []
    previous = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, min(_NICE, previous))
        undo.append(lambda: os.setpriority(os.PRIO_PROCESS, 0, previous))
    with suppress(OSError):
        _shorten_slice(undo)
    try:
        yield
    finally:
        while undo:
            undo.pop()()


def fair_share() -> tuple[int, int, list[int]]:
    """Return niceness, slice of the fair scheduler, ns, and processors of this thread, which a new process inherits."""
    return os.getpriority(os.PRIO_PROCESS, 0), _slice_ns(), sorted(os.sched_getaffinity(0))


def take_fair_share(niceness: int, slice_ns: int, processors: Iterable[int]) -> None:
    """Give this thread what ``fair_share`` returned in another one, as far as the system allows it."""
    with suppress(OSError):
        os.sched_setaffinity(0, processors)
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    with suppress(OSError):
        _set_slice_ns(slice_ns)


def take_fifo(priority: int) -> None:
    """Put this thread, and those it starts, under SCHED_FIFO until they end, if the system allows it.

    For processes other than the loop's, which reports what the system allows.
    """
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def speed_held() -> float:
    """Return the speed, relative to real time, up to which this computer keeps the time of an emulated rig.

    All processes of such a rig together take about a third of a CPU per unit of speed: at the number of CPUs two thirds
    of the computer are left to other programs.
    """
    return float(len(os.sched_getaffinity(0)))


def limit_fifo(cpu_s: float) -> None:
    """Take this thread, the main one, out of SCHED_FIFO when it has used ``cpu_s`` without waiting.

    ``take_fifo`` puts it back. The kernel withholds 50 ms of each second from all real-time processes if they fill a
    core; a thread whose work is short but for exceptions has a real-time priority for the short part only.
    """
    signal.signal(signal.SIGXCPU, lambda *_: drop_priority())
    hard = resource.getrlimit(resource.RLIMIT_RTTIME)[1]
    resource.setrlimit(resource.RLIMIT_RTTIME, (round(1e6 * cpu_s), hard))


def drop_priority() -> None:
    """Take this thread out of real-time scheduling, which it inherits; its niceness stays."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def no_garbage_collection(freeze: bool = True) -> Iterator[None]:
    """Disable garbage collection while drives are enabled: one full collection can exceed their watchdogs' time-out.

    freeze: collect first, and exclude all present objects from later collections. Without effect inside another one.
    """
    if not gc.isenabled():
        yield
        return
    if freeze:
        gc.collect()
        gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


def _cut_timer_slack(undo: list[Callable[[], object]]) -> str:
    previous = _call("prctl", _PR_GET_TIMERSLACK)
    _call("prctl", _PR_SET_TIMERSLACK, _SLACK_NS)
    undo.append(lambda: _call("prctl", _PR_SET_TIMERSLACK, previous))
    return f"timer slack {_SLACK_NS} ns"


def _shorten_slice(undo: list[Callable[[], object]]) -> str:
    """Request a short slice of the fair scheduler; needs no privilege. Older kernels accept and ignore the call."""
    previous = _slice_ns()
    _set_slice_ns(_SLICE_NS)
    if _slice_ns() != _SLICE_NS:
        raise OSError(errno.ENOSYS, "the kernel keeps its own slice")
    undo.append(lambda: _set_slice_ns(previous))
    return f"slice {_SLICE_NS / 1e6:g} ms"


def _slice_ns() -> int:
    attributes = ctypes.create_string_buffer(_SCHED_ATTR.size)
    _call("syscall", _SYS_SCHED_GETATTR, 0, attributes, _SCHED_ATTR.size, 0)
    return int(_SCHED_ATTR.unpack(attributes.raw)[5])


def _set_slice_ns(slice_ns: int) -> None:
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_OTHER, 0, niceness, 0, slice_ns, 0, 0)
    _call("syscall", _SYS_SCHED_SETATTR, 0, attributes, 0)


def _has_capability(number: int) -> bool:
    with open("/proc/self/status", encoding="ascii", errors="replace") as status:
        effective = next((line.split()[1] for line in status if line.startswith("CapEff:")), "0")
    return bool(int(effective, 16) >> number & 1)


def _call(name: str, *arguments: object) -> int:
    """Call the C library's ``name``; raise OSError if it fails. Integers are passed as longs."""
    library = ctypes.CDLL(None, use_errno=True)
    longs = [ctypes.c_long(value) if isinstance(value, int) else value for value in arguments]
    result = int(getattr(library, name)(*longs))
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return result


def _why(refusal: OSError) -> str:
    code = errno.errorcode.get(refusal.errno or 0, "")
    text = refusal.strerror or str(refusal)
    return text if code in ("", "ECANCELED") else f"{text} ({code})"
