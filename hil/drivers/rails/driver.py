"""Driver of the rails: up to six drives on Modbus TCP or RTU, one event loop in its own thread.

An exchange is one transaction (function 23) per drive, or a write and a read for drives without that function, all
at once; those that share a wire go one after the other. It is triggered by ``send``, at most at the rate of the
rig file, and every 20 ms without a setpoint, so that feedback stays fresh and the drives hold the last setpoint. One
lost or damaged response is retried; when one drive fails the others are stopped at once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from math import fsum
from typing import Final, TypeVar

import numpy as np

from hil.config.rig import LinearAxes
from hil.core import alarm_table as table
from hil.core.clock import BenchClock
from hil.core.messages import Array, AxisFeedback, Homing
from hil.drivers.axes import SetpointLimits
from hil.drivers.latest import Latest
from hil.drivers.loop_thread import LoopThread
from hil.drivers.rails.codec import ControlFlags, RegisterMap, State
from hil.drivers.rails.drive import (
    CONNECT_TIMEOUT_S,
    ENABLE_TIMEOUT_S,
    OFF,
    STOP,
    Drive,
    HomingMonitor,
    limit_switch,
    make_wires,
)
from hil.drivers.rails.frames import new_counters
from hil.drivers.setpoint_limiter import ExchangePacer, SetpointLimiter, setpoint_limiters
from hil.errors import DeviceError, DriveFault, LinkLost

IDLE_PERIOD_S: Final = 0.02  # between exchanges without setpoints
_STOP_WAIT_WALL_S: Final = 0.08

_Result = TypeVar("_Result")


class ModbusRails(LoopThread):
    """AxisGroup of the rails (m, m/s). May be opened again after ``close``.

    config.timeout_s: longest silence of a drive. clock: stamps feedback with bench time, half way between request and
    response. name: of the device, for errors.
    """

    def __init__(self, config: LinearAxes, clock: BenchClock, name: str = "rails") -> None:
        self.name = name
        self._limits = SetpointLimits(name, config)
        self.axis_names = self._limits.names
        self._config = config
        self._timeout_s = config.timeout_s
        self._clock = clock
        self._map = RegisterMap(config.map)
        self._counters = new_counters()
        self._homing = HomingMonitor(config)
        self._box: Latest[AxisFeedback] = Latest(self.name)
        self._box.fail(LinkLost(self.name, "is not open"))
        self._setpoint: tuple[list[float], list[float], float] = ([], [], 0.0)  # position, rate, when sent
        self._serving = False
        self._stopping = False
        self._disabled = False
        self._stop_was_called = False
        self._jogging = False
        self._all_stopped = clock.event()
        self._drives: list[Drive] = []
        self._limiters: list[SetpointLimiter] = []
        self._pacer = ExchangePacer(config.exchanges_max_hz)
        self._stop_task: asyncio.Task[None] | None = None

    def open(self, now_s: float) -> None:
        """Connect to the drives, check their identity, enable them at their present positions."""
        bound_s = CONNECT_TIMEOUT_S + ENABLE_TIMEOUT_S + 6.0 * self._timeout_s
        self.close()
        self._await_previous_thread(bound_s)
        self._box = Latest(self.name)
        self._counters = new_counters()
        self._homing = HomingMonitor(self._config)
        self._serving = self._stopping = self._stop_was_called = self._jogging = self._disabled = False
        self._stop_task = None
        self._pacer.restart()
        self._all_stopped.clear()
        try:
            self._start(bound_s)
        except BaseException:
            self.close()
            raise

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed."""
        self._box.check()
        self._call(self._begin_homing)

    def set_jogging(self, on: bool) -> None:
        self._jogging = on

    def set_limits(self, rate: Array, acceleration: Array) -> None:
        """Set the limits (n,), m/s and m/s2, within which an axis catches up after a lost response."""
        for limiter, limits in zip(self._limiters, zip(rate.tolist(), acceleration.tolist(), strict=True), strict=True):
            limiter.set_limits(*limits)

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Set the next setpoint; a stopped device returns the position that it holds.

        Raises SafetyTrip also if an axis is not homed.
        """
        self._box.check()
        accepted, feedforward = self._limits.accepted(position, rate, self._jogging)
        feedback = self._box.peek()
        if self._stopping and feedback is not None:
            return feedback.position.copy()
        for axis, homing in enumerate(self._homing.state):
            if homing is not Homing.DONE and not self._jogging:
                raise table.SETPOINT.trip(self.axis_names[axis], "before homing", "once the axis is homed")
        self._setpoint = (accepted.tolist(), feedforward.tolist(), now_s)
        if self._pacer.is_due(now_s):
            self._call(self._wake.set)
        return accepted

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest exchange in which all drives responded."""
        return self._box.get(now_s, self._timeout_s)

    def stop(self, now_s: float) -> None:
        """Command a quick stop; wait for its acknowledgement, at most 0.08 s of wall time."""
        again = self._stop_was_called
        self._stopping = self._stop_was_called = True
        if self._thread is None or not self._thread.is_alive():
            return
        self._call(self._begin_stop)
        if not again:
            self._all_stopped.wait(_STOP_WAIT_WALL_S)

    def disable(self, now_s: float) -> None:
        """Switch the torque of all drives off."""
        self._stopping = self._disabled = True
        if self._thread is not None and self._thread.is_alive():
            self._call(self._begin_stop)

    def close(self) -> None:
        """Send a quick stop, unless the torque is off, and disconnect; at most 0.1 s of wall time."""
        self._stopping = True
        self._box.fail(LinkLost(self.name, "is closed"))
        self._end()

    def counters(self) -> dict[str, int]:
        """Return the counters of the wires since ``open``.

        exchanges: requests with a response; retries: repeated requests; protocol_errors: damaged or implausible
        responses and exceptions; late: responses to an older request; duplicates: responses received twice.
        """
        return dict(self._counters)

    # The methods below run in the thread.

    async def _live(self, opened: Future[None]) -> None:
        # Slightly below the limit of the box, so that the error names the silent drive.
        timeout_s = max(0.5 * self._timeout_s, self._timeout_s - 1.5 * IDLE_PERIOD_S)
        wires = make_wires(self._config, timeout_s, self._counters, self._clock)
        self._drives = [
            Drive(name, wire, self._map, float(rate_max), self._clock)
            for name, wire, rate_max in zip(self.axis_names, wires, self._limits.rate_max, strict=True)
        ]
        try:
            await _all(drive.identify() for drive in self._drives)
            held = await _all(drive.enable() for drive in self._drives)
            self._setpoint = (held, [0.0] * len(held), self._clock.now_s())
            self._limiters = setpoint_limiters(self._config)
            for limiter, position_m in zip(self._limiters, held, strict=True):
                limiter.restart(position_m, self._setpoint[2])
            self._serving = True
            await self._exchange_all()
            self._box.check()
            opened.set_result(None)
            await self._serve()
        finally:
            try:
                await asyncio.gather(*(drive.send(self._stop_control) for drive in self._drives))
            finally:  # close() may cancel this during the requests
                for wire in wires:
                    wire.bus.close()

    async def _serve(self) -> None:
        idle_wall_s = self._clock.idle_s(IDLE_PERIOD_S)
        while not self._closing:
            with suppress(TimeoutError):  # no setpoint: exchange all the same
                async with asyncio.timeout(idle_wall_s):
                    await self._wake.wait()
            self._wake.clear()
            await self._exchange_all()

    async def _exchange_all(self) -> None:
        states = await asyncio.gather(*(self._exchange(index) for index in range(len(self._drives))))
        received = [state for state in states if state is not None]
        if len(received) == len(self._drives):
            t_s = fsum(drive.sampled_s for drive in self._drives) / len(self._drives)
            position = np.array([state.position_m for state in received])
            rate = np.array([state.rate_mps for state in received])
            limit = tuple(self._limit(axis, received) for axis in range(len(received)))
            self._box.put(AxisFeedback(t_s, position, rate, tuple(self._homing.state), limit), t_s)

    def _limit(self, axis: int, states: list[State]) -> int:
        middle_m = 0.5 * float(self._limits.low[axis] + self._limits.high[axis])
        return limit_switch(states[axis].status, states[axis].position_m, middle_m)

    async def _exchange(self, index: int) -> State | None:
        """Exchange with one drive; any failure stops all of them."""
        drive = self._drives[index]
        if drive.failed:
            return None
        stopping = self._stopping
        position_m, rate_mps = self._setpoint_of(index)
        homing = not stopping and self._homing.is_homing(index)
        control = self._stop_control if stopping else ControlFlags.ENABLE
        if homing:
            control |= ControlFlags.HOME
            drive.forget_position()

        def problem(state: State) -> DriveFault | None:  # a stop may be requested during this exchange
            return drive.problem(state, stopping or self._stopping)

        try:
            state = await drive.exchange(control, position_m, rate_mps, problem)
            if fault := problem(state):
                raise fault
        except DeviceError as error:
            drive.failed = self._stopping = True
            self._box.fail(error)
            self._begin_stop()
            await drive.send(self._stop_control)
            return None
        if self._homing.update(index, state, homing) or homing:
            self._hold_at(index, state.position_m)
        return state

    @property
    def _stop_control(self) -> ControlFlags:
        return OFF if self._disabled else STOP

    def _begin_homing(self) -> None:
        self._homing.begin()
        self._wake.set()

    def _hold_at(self, index: int, position_m: float) -> None:
        """Set the reported position as setpoint: homing has moved the zero."""
        position, rate, sent_s = self._setpoint
        moved, stood = list(position), list(rate)
        moved[index], stood[index] = position_m, 0.0
        self._limiters[index].restart(position_m, sent_s)
        self._setpoint = (moved, stood, sent_s)

    def _setpoint_of(self, index: int) -> tuple[float, float]:
        """Return position and rate to send; the rate of an old setpoint is 0."""
        position, rate, sent_s = self._setpoint
        now_s = self._clock.now_s()
        fresh = now_s - sent_s <= self._timeout_s
        setpoint = position[index], rate[index] if fresh else 0.0
        return self._limiters[index].next(*setpoint, sent_s, now_s, self._drives[index].measured)

    def _begin_stop(self) -> None:
        self._homing.abort()
        if self._serving and (self._stop_task is None or self._stop_task.done()):
            self._stop_task = asyncio.get_running_loop().create_task(self._stop_all())

    async def _stop_all(self) -> None:
        # Independent of the exchange under way, which may be waiting for a dead drive.
        for drive in self._drives:
            if drive.failed:  # no exchange any more
                await drive.send(self._stop_control)
        await asyncio.gather(*(self._exchange(index) for index in range(len(self._drives))))
        self._all_stopped.set()


async def _all(steps: Iterable[Awaitable[_Result]]) -> list[_Result]:
    """Run the steps concurrently, wait for all, raise the first failure."""
    results = await asyncio.gather(*steps, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return [result for result in results if not isinstance(result, BaseException)]
