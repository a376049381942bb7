"""Root cause of a fault: the first reported error may be a consequence."""

from __future__ import annotations

from typing import Final

from hil.errors import BenchError, DriveFault, FaultKind, LinkLost, SafetyTrip
from hil.loop.cycle import Loop
from hil.loop.rate_keeper import Rate
from hil.loop.safety_io_stage import SAFETY_CHAIN, SafetyIo

_ESTOP_DETECTED_S: Final = 0.06  # bench time: the coupler is polled every 20 ms
_COUPLER_LOSS_DETECTED_S: Final = 0.6  # until a dead coupler is detected


class RootCause:
    """Search for the root cause of ``fault`` while the bench is being stopped.

    An emergency stop, an opened interlock or a dead coupler removes the torque, and the drives may report that before
    the safety chain is read. The search ends when the chain has been read; in simulated time it ends at once.
    A fault before the drives were ``powered`` has no other cause: devices may not be open yet.
    """

    def __init__(self, fault: BenchError, loop: Loop, rate: Rate, powered: bool = True) -> None:
        self._fault = fault
        self._loop = loop
        torque_is_off = isinstance(fault, DriveFault) and fault.kind is FaultKind.TORQUE_OFF
        wait_s = _COUPLER_LOSS_DETECTED_S if torque_is_off else _ESTOP_DETECTED_S
        self._end_s = rate.now_s() + wait_s
        self._found = not powered or type(loop.safety_io) is SafetyIo or not rate.paced

    def poll(self, now_s: float, chain_opened: bool) -> BenchError | None:
        """Return the root cause, which may be the fault itself; None until it is found.

        chain_opened: the stop has opened the safety chain, which is then no cause.
        """
        if self._found or now_s >= self._end_s:
            return self._fault
        bench = self._loop.bench
        try:
            bench.poll_safety_inputs(now_s)
            if (alarm := bench.safety.interlock_power(now_s)) is not None:
                return alarm.trip()
            self._loop.safety_io.check(now_s)
        except BenchError as cause:
            if isinstance(self._fault, LinkLost):  # a root cause itself
                return self._fault
            if not (chain_opened and isinstance(cause, SafetyTrip) and cause.quantity == SAFETY_CHAIN):
                return cause
        return None
