"""Driver of the coupler: Modbus TCP, one event loop in its own thread.

An exchange writes all outputs, reads them back, and reads the inputs. It is triggered by a change of an output, and
every 20 ms, so that the inputs stay fresh; above real time as often per second of wall time.
"""

from __future__ import annotations

import asyncio
import math
from concurrent.futures import Future
from contextlib import suppress
from typing import Final

from hil.config.tables.io import Io
from hil.core.clock import BenchClock, Order
from hil.core.messages import IoInputs, IoOutputs
from hil.drivers.io import NAME
from hil.drivers.io.codec import LineMap
from hil.drivers.io.coupler import Coupler
from hil.drivers.latest import Latest
from hil.drivers.loop_thread import LoopThread
from hil.errors import DriveFault, LinkLost

IDLE_PERIOD_S: Final = 0.02  # between exchanges while nothing changes
_OFF: Final = IoOutputs(False, b"")
_OPENING_TIME_S: Final = 0.5
_OPENING_POLL_WALL_S: Final = 0.001
_STOP_WAIT_WALL_S: Final = 0.08


class ModbusIo(LoopThread):
    """DiscreteIo on a coupler. May be opened again after ``close``.

    config.timeout_s: longest silence of the coupler. clock: stamps the inputs with bench time, half way
    between the first request and the last answer of an exchange.
    """

    _order = Order.COUPLER_DRIVER

    def __init__(self, config: Io, clock: BenchClock) -> None:
        self.name = NAME
        self._config = config
        self._clock = clock
        self._lines = LineMap(config)
        self._box: Latest[IoInputs] = Latest(NAME)
        self._box.fail(LinkLost(NAME, "is not open"))
        self._outputs = _OFF
        self._pump = self._pump_written = False  # a slow coupler gets each edge
        self._toggled_s = 0.0
        self._coupler: Coupler | None = None
        self._thrusters = b""
        self._thrusters_s = math.nan
        self._stopped = True
        self._is_off = clock.event()

    def open(self, now_s: float) -> None:
        """Connect, check the identity, set all outputs off, read the inputs."""
        bound_s = 6.0 * self._config.timeout_s
        self.close()
        self._await_previous_thread(bound_s)
        self._box = Latest(NAME)
        self._outputs = _OFF
        self._pump = self._pump_written = self._stopped = False
        self._toggled_s = -math.inf
        self._thrusters, self._thrusters_s = bytes(len(self._lines.thrusters)), math.nan
        self._is_off.clear()
        try:
            self._start(bound_s)
        except BaseException:
            self.close()
            raise

    def pulse(self, now_s: float) -> None:
        """Toggle the charge pump, unless it was toggled within the pump's period."""
        due = now_s - self._toggled_s >= self._clock.paced_s(self._config.pump_period_s)
        if due and self._outputs.pump and not self._stopped and self._pump == self._pump_written:
            self._pump = not self._pump
            self._toggled_s = now_s
            self._call(self._wake.set)

    def write(self, outputs: IoOutputs, now_s: float) -> None:
        """Set the outputs; after ``stop`` they stay off."""
        self._box.check()
        if not self._stopped and outputs != self._outputs:
            self._outputs = outputs
            self._call(self._wake.set)

    def read(self, now_s: float) -> IoInputs:
        """Return the inputs of the newest exchange."""
        return self._box.get(now_s, self._config.timeout_s)

    def counters(self) -> dict[str, int]:
        """Return how often the coupler was busy, sent an odd frame, or answered with another unit id."""
        return {} if self._coupler is None else dict(self._coupler.counters)

    def stop(self, now_s: float) -> None:
        """Set all outputs off; wait for the coupler's confirmation, at most 0.08 s of wall time."""
        again = self._stopped
        self._stopped = True
        self._outputs = _OFF
        if again or self._thread is None or not self._thread.is_alive():
            return
        self._call(self._wake.set)
        self._is_off.wait(_STOP_WAIT_WALL_S)

    def close(self) -> None:
        """Set the outputs off and disconnect; at most 0.1 s of wall time."""
        self._stopped = True
        self._outputs = _OFF
        self._box.fail(LinkLost(NAME, "is closed"))
        self._end()

    # The methods below run in the thread.

    def _when_ended(self) -> None:
        self._is_off.set()

    async def _live(self, opened: Future[None]) -> None:
        # Slightly below the limit of the box, so that the error names what was waited for.
        timeout_s = max(0.5 * self._config.timeout_s, self._config.timeout_s - 1.5 * IDLE_PERIOD_S)
        coupler = self._coupler = Coupler(self._config, self._lines, timeout_s, self._clock)
        try:
            await coupler.identify()
            await self._begin(coupler)
            opened.set_result(None)
            idle_wall_s = self._clock.idle_s(self._clock.paced_s(IDLE_PERIOD_S))
            while not self._closing:
                with suppress(TimeoutError):  # nothing changed: exchange all the same
                    async with asyncio.timeout(idle_wall_s):
                        await self._wake.wait()
                self._wake.clear()
                await self._exchange(coupler)
        finally:
            try:
                await coupler.send_off()
            finally:  # close() may cancel this during the request
                await coupler.close()

    async def _begin(self, coupler: Coupler) -> None:
        """Set all outputs off and check that the chain opens: welded contacts of the relay must be detected."""
        deadline_s = self._clock.now_s() + _OPENING_TIME_S
        await self._exchange(coupler)
        while (inputs := self._box.peek()) is not None and inputs.chain_closed:
            if self._clock.now_s() > deadline_s:
                text = f"the safety chain is closed {_OPENING_TIME_S:g} s after enable went off: contacts or wiring"
                raise DriveFault(NAME, text)
            await asyncio.sleep(_OPENING_POLL_WALL_S)
            await self._exchange(coupler)

    async def _exchange(self, coupler: Coupler) -> None:
        stopped = self._stopped
        started_s = self._clock.now_s()
        levels = self._levels()
        inputs = await coupler.exchange(levels)
        self._pump_written = levels[self._lines.coils[0]]
        t_s = 0.5 * (started_s + self._clock.now_s())
        thrusters = bytes(levels[coil] for coil in self._lines.thrusters)
        if thrusters != self._thrusters:
            self._thrusters, self._thrusters_s = thrusters, t_s
        lines = self._lines
        open_interlocks = tuple(name for name, address in lines.interlocks.items() if not inputs[address])
        self._box.put(
            IoInputs(
                t_s,
                inputs[lines.estop],
                inputs[lines.chain],
                open_interlocks,
                self._thrusters_s,
                None if lines.brakes_closed is None else inputs[lines.brakes_closed],
                None if lines.local_enable is None else inputs[lines.local_enable],
            ),
            t_s,
        )
        if stopped:
            self._is_off.set()

    def _levels(self) -> dict[int, bool]:
        """Return the required coils by address."""
        outputs, lines = self._outputs, self._lines
        levels = dict.fromkeys(lines.coils, False)
        if not self._stopped:
            levels[lines.coils[0]] = self._pump
            levels[lines.coils[1]] = outputs.enable
            levels.update(zip(lines.thrusters, map(bool, outputs.thrusters), strict=False))
            if lines.brakes is not None:
                levels[lines.brakes] = outputs.brakes_released
            if lines.warning is not None:
                levels[lines.warning] = outputs.warning
        return levels
