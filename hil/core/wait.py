"""Wait for a deadline outside of Python: sleep, then spin, without the interpreter's lock."""

from __future__ import annotations

from typing import Any, Final

from numba import types

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
    place = timespec.ctypes.data
    _clock_gettime(_MONOTONIC, place)
    now_ns = timespec[0] * _SECOND_NS + timespec[1]
    wake_ns = deadline_ns - spin_ns
    if now_ns < wake_ns:
        timespec[0], timespec[1] = wake_ns // _SECOND_NS, wake_ns % _SECOND_NS
        interrupted = _clock_nanosleep(_MONOTONIC, _ABSOLUTE, place, 0)
        _clock_gettime(_MONOTONIC, place)
        now_ns = timespec[0] * _SECOND_NS + timespec[1]
        if interrupted != 0:
            return now_ns
    while now_ns < deadline_ns:
        _clock_gettime(_MONOTONIC, place)
        now_ns = timespec[0] * _SECOND_NS + timespec[1]
    return now_ns
