"""Root cause of a fault: the first reported error may be a consequence."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Final

from hil.errors import BenchError, DriveFault, FaultKind, LinkLost, SafetyTrip
from hil.loop.cycle import Loop
from hil.loop.rate_keeper import Rate
from hil.loop.safety_io_stage import SAFETY_CHAIN, NoSafetyIo

_ESTOP_DETECTED_S: Final = 0.06  # bench time: the coupler is polled every 20 ms
_COUPLER_LOSS_DETECTED_S: Final = 0.6  # until a dead coupler is detected
_POLL_WALL_S: Final = 0.001


def root_cause(fault: BenchError, loop: Loop, rate: Rate, chain_opened: bool = False) -> BenchError:
    """Return the root cause of ``fault``, or ``fault`` itself; called after the axes have been stopped.

    chain_opened: the stop has opened the safety chain, which is then no cause.

    An emergency stop, an opened interlock or a dead coupler removes the torque, and the drives may report that before
    the safety chain is read. Waits until the chain has been read; in simulated time it does not wait.
    """
    if isinstance(loop.safety_io, NoSafetyIo) or not rate.paced:
        return fault
    torque_is_off = isinstance(fault, DriveFault) and fault.kind is FaultKind.TORQUE_OFF
    start_s = now_s = rate.now_s()
    while now_s - start_s < (_COUPLER_LOSS_DETECTED_S if torque_is_off else _ESTOP_DETECTED_S):
        try:
            loop.bench.poll_emergency_input(now_s)
            if (alarm := loop.bench.safety.interlock_open(now_s)) is not None:
                return alarm.trip()
            loop.safety_io.check(now_s)
        except BenchError as cause:
            if isinstance(fault, LinkLost):  # a root cause itself
                return fault
            if not (chain_opened and isinstance(cause, SafetyTrip) and cause.quantity == SAFETY_CHAIN):
                return cause
        with suppress(BenchError):
            loop.bench.read(now_s, loop.now.feedback)  # the loop's heartbeat: the axes still have torque
        time.sleep(_POLL_WALL_S)
        now_s = rate.now_s()
    return fault
