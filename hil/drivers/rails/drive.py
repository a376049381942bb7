"""The link to one rail drive: every request is bounded, every failure names the axis."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.pdu import ModbusPDU

from hil.clock import WallClock
from hil.drivers.rails.codec import DRIVE_MAP, Block, Command, Control, State, Status, fault_text
from hil.errors import DriveFault, LinkLost, LinkTimeout, ProtocolError

ENABLE_TIMEOUT_S: Final = 2.0  # a holding brake takes some tenths of a second to open
STOP: Final = Control.ENABLE | Control.QUICK_STOP
_ENABLE_POLL_S: Final = 0.005
_LAST_WORD_WALL_S: Final = 0.02
_NUMBERS: Final = 1 << 16

# What goes wrong is raised and names the axis; pymodbus would add a packet trace on standard error.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


class Drive:
    """One drive. Must be made and used inside a running event loop.

    timeout_s: bench time that the drive has for an answer.
    """

    def __init__(self, name: str, host: str, port: int, device_id: int, timeout_s: float, clock: WallClock) -> None:
        self.name = name
        self.failed = False
        self._address = f"{host}:{port}"
        self._device_id = device_id
        self._map = DRIVE_MAP
        self._clock = clock
        self._timeout_s = timeout_s
        self._timeout_wall_s = clock.wall_s(timeout_s)
        self._number = 0
        self._identified = False
        self._waits: set[asyncio.Timeout] = set()  # one a request under way
        self._client = AsyncModbusTcpClient(
            host,
            port=port,
            timeout=10.0 * self._timeout_wall_s,  # the time-out below comes first: it can tell what happened
            retries=0,
            reconnect_delay=0,  # a lost drive stays lost until the bench is opened again
            trace_connect=self._on_connection,
        )

    async def identify(self) -> None:
        """Connect, and make sure that the right kind of drive answers."""
        try:
            async with asyncio.timeout(self._timeout_wall_s):
                connected = await self._client.connect()
        except TimeoutError as error:
            raise LinkTimeout(self.name, f"no connection to {self._address} in {self._timeout_s:g} s") from error
        if not connected:
            raise LinkLost(self.name, f"no connection to {self._address}: nothing listens there")
        identity = self._map.decode_identity(await self._read(self._map.identity))
        if problem := self._map.identity_problem(identity):
            raise ProtocolError(self.name, f"wrong drive at {self._address}: {problem}")
        self._identified = True

    async def enable(self) -> float:
        """Clear what an earlier run left, then switch on; return the position that is held, m."""
        state = self._map.decode_state(await self._read(self._map.state))
        state = await self.exchange(Control.FAULT_RESET, state.position_m)
        deadline_s = self._clock.now_s() + ENABLE_TIMEOUT_S
        while True:
            held_m = state.position_m
            state = await self.exchange(Control.ENABLE, held_m)
            if state.status & Status.FAULT:
                raise DriveFault(self.name, fault_text(state.fault))
            if state.status & Status.ENABLED:
                return held_m
            if self._clock.now_s() > deadline_s:
                raise DriveFault(self.name, f"not enabled {ENABLE_TIMEOUT_S:g} s after the command")
            await asyncio.sleep(self._clock.wall_s(_ENABLE_POLL_S))

    async def exchange(self, control: Control, position_m: float, rate_mps: float = 0.0) -> State:
        """Write one command and read the state that follows it, in one transaction."""
        command = self._next(control, position_m, rate_mps)
        state = self._map.decode_state(await self._ask(lambda: self._send(command), self._map.state))
        if state.echo != command.number:
            raise ProtocolError(self.name, f"echo {state.echo}, expected {command.number}")
        return state

    def check(self, state: State, stopping: bool) -> None:
        """Raise DriveFault when the drive is not in the state that it was commanded to."""
        if state.status & Status.FAULT:
            raise DriveFault(self.name, fault_text(state.fault))
        if stopping:
            return
        if state.status & Status.QUICK_STOP:
            raise DriveFault(self.name, "made a quick stop of its own (its watchdog or its stop input)")
        if not state.status & Status.ENABLED:
            raise DriveFault(self.name, "switched itself off")

    async def stop_blindly(self) -> None:
        """Leave a quick stop on the wire without waiting for an answer: the drive may be unable to give one."""
        if not self._identified:
            return
        with suppress(TimeoutError, ModbusException):  # the wire is gone; nothing more can be done from here
            async with asyncio.timeout(_LAST_WORD_WALL_S):
                await self._send(self._next(STOP, 0.0, 0.0), answer=False)

    def close(self) -> None:
        self._client.close()

    def _next(self, control: Control, position_m: float, rate_mps: float) -> Command:
        self._number = (self._number + 1) % _NUMBERS
        return Command(control, self._number, position_m, rate_mps)

    def _send(self, command: Command, answer: bool = True) -> Awaitable[ModbusPDU]:
        return self._client.readwrite_registers(
            read_address=self._map.state.address,
            read_count=self._map.state.count,
            write_address=self._map.command.address,
            values=self._map.encode_command(command),
            device_id=self._device_id,
            no_response_expected=not answer,
        )

    async def _read(self, block: Block) -> list[int]:
        return await self._ask(
            lambda: self._client.read_holding_registers(block.address, count=block.count, device_id=self._device_id),
            block,
        )

    def _on_connection(self, connected: bool) -> None:
        """End the waiting for a drive that has hung up: pymodbus would wait on (it calls this)."""
        if not connected:
            for wait in self._waits:
                if not wait.expired():
                    wait.reschedule(0.0)

    async def _ask(self, request: Callable[[], Awaitable[ModbusPDU]], block: Block) -> list[int]:
        try:
            async with asyncio.timeout(self._timeout_wall_s) as wait:
                self._waits.add(wait)
                try:
                    reply = await request()
                finally:
                    self._waits.discard(wait)
        except TimeoutError as error:
            if not self._client.connected:
                raise LinkLost(self.name, f"{self._address} closed the connection") from error
            raise LinkTimeout(self.name, f"no answer within {self._timeout_s:g} s") from error
        except ConnectionException as error:
            raise LinkLost(self.name, f"{self._address} closed the connection") from error
        except ModbusException as error:
            raise ProtocolError(self.name, str(error)) from error
        if reply.isError():
            raise ProtocolError(self.name, f"Modbus exception {reply.exception_code} at register {block.address}")
        if len(reply.registers) != block.count:
            raise ProtocolError(self.name, f"{len(reply.registers)} registers came, expected {block.count}")
        return list(reply.registers)
