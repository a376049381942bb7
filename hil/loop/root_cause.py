"""What lies behind a fault: the first to complain is not always the one that failed."""

from __future__ import annotations

import time
from typing import Final

from hil.errors import BenchError, DriveFault, FaultKind, LinkLost
from hil.loop.cycle import Loop
from hil.loop.rate_keeper import Rate
from hil.loop.safety_io_stage import NoSafetyIo

_ESTOP_COMES_S: Final = 0.06  # bench time: the coupler is asked every 20 ms
_CHAIN_COMES_S: Final = 0.6  # until a coupler that is dead is found so
_PAUSE_WALL_S: Final = 0.001


def root_cause(fault: BenchError, loop: Loop, rate: Rate) -> BenchError:
    """Return what lies behind ``fault``, or ``fault``; asked once the axes have been told to stop.

    An emergency stop, an opened interlock or a dead coupler takes the torque from the drives, which may
    complain a moment before the chain is read. Waits for that moment, on the wall only.
    """
    if isinstance(loop.safety_io, NoSafetyIo) or not rate.on_the_wall:
        return fault
    torque_is_off = isinstance(fault, DriveFault) and fault.kind is FaultKind.TORQUE_OFF
    begun_s = now_s = rate.now_s()
    while now_s - begun_s < (_CHAIN_COMES_S if torque_is_off else _ESTOP_COMES_S):
        try:
            loop.bench.poll_emergency_input(now_s)
            if (alarm := loop.bench.safety.interlock_open(now_s)) is not None:
                return alarm.trip()
            loop.safety_io.check(now_s)
        except BenchError as behind:
            return fault if isinstance(fault, LinkLost) else behind  # a wire that is gone is a cause itself
        time.sleep(_PAUSE_WALL_S)
        now_s = rate.now_s()
    return fault
