"""The link to the coupler: every request is bounded, every failure names the device."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import Any, Final

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.pdu import ModbusPDU

from hil.config.io import Io
from hil.core.clock import WallClock
from hil.drivers.io import NAME
from hil.drivers.io.codec import Function, LineMap
from hil.errors import DeviceError, LinkLost, LinkTimeout, ProtocolError

_LAST_WORD_WALL_S: Final = 0.02
_HANGS_UP_WALL_S: Final = 0.002
_IDENTITY: Final = ("vendor", "product", "revision")  # objects 0, 1, 2

# What goes wrong is raised and names the device; pymodbus would add a packet trace on standard error.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


class Coupler:
    """One coupler. Must be made and used inside a running event loop.

    timeout_s: bench time that it has for an answer.
    """

    def __init__(self, config: Io, lines: LineMap, timeout_s: float, clock: WallClock) -> None:
        self._lines = lines
        self._identity = config.identity
        self._address = f"{config.host}:{config.port}"
        self._device_id = config.device_id
        self._timeout_s = timeout_s
        self._timeout_wall_s = clock.wall_s(timeout_s)
        self._waits: set[asyncio.Timeout] = set()  # one a request under way
        self._garbled: BaseException | None = None
        asyncio.get_running_loop().set_exception_handler(self._on_garbage)
        self._client = AsyncModbusTcpClient(
            config.host,
            port=config.port or 0,
            timeout=10.0 * self._timeout_wall_s,  # the time-out below comes first: it can tell what happened
            retries=0,
            reconnect_delay=0,  # a lost coupler stays lost until the bench is opened again
            trace_connect=self._on_connection,
        )

    async def identify(self) -> None:
        """Connect, and make sure that it is the coupler that the rig file names, where it names one."""
        try:
            async with asyncio.timeout(self._timeout_wall_s):
                connected = await self._client.connect()
        except TimeoutError as error:
            raise LinkTimeout(NAME, f"no connection to {self._address} in {self._timeout_s:g} s") from error
        if not connected:
            raise LinkLost(NAME, f"no connection to {self._address}: nothing listens there")
        wanted = [(number, name, getattr(self._identity, name)) for number, name in enumerate(_IDENTITY)]
        if all(expected is None for _, _, expected in wanted):
            return
        request = partial(self._client.read_device_information, read_code=1, object_id=0, device_id=self._device_id)
        reply = await self._ask(Function.ENCAPSULATED, request)
        objects: dict[int, object] = getattr(reply, "information", {})
        for number, name, expected in wanted:
            said = objects.get(number, b"")
            found = said.decode("ascii", "replace") if isinstance(said, bytes) else str(said)
            if expected is not None and found != expected:
                text = f"wrong coupler at {self._address}: {name} {found!r}, expected {expected!r}"
                raise ProtocolError(NAME, text)

    async def exchange(self, levels: dict[int, bool]) -> dict[int, bool]:
        """Write the coils, read them back, read the inputs; return the inputs by address.

        Raises ProtocolError where a coil does not read as it was written: the coupler does not work, or
        somebody else writes to it.
        """
        await self.write(levels)
        for run in self._lines.coil_runs:
            found = await self._bits(Function.READ_COILS, self._client.read_coils, run)
            for address, level in found.items():
                if level != levels[address]:
                    name = self._lines.coil_names[self._lines.coils.index(address)]
                    raise ProtocolError(NAME, f"output {name} reads {level:d}, written {levels[address]:d}")
        inputs: dict[int, bool] = {}
        for run in self._lines.input_runs:
            inputs |= await self._bits(Function.READ_INPUTS, self._client.read_discrete_inputs, run)
        return inputs

    async def write(self, levels: dict[int, bool]) -> None:
        """Write all coils."""
        for run in self._lines.coil_runs:
            values = [levels[address] for address in run]
            request = partial(self._client.write_coils, run.start, values, device_id=self._device_id)
            await self._ask(Function.WRITE_COILS, request)

    async def say_off(self) -> None:
        """Leave all outputs off, if that can be had in a moment."""
        if not self._client.connected:
            return  # pymodbus would connect anew
        with suppress(TimeoutError, ModbusException, LinkLost, LinkTimeout, ProtocolError):  # nothing more can be done
            async with asyncio.timeout(_LAST_WORD_WALL_S):
                await self.write(dict.fromkeys(self._lines.coils, False))

    async def close(self) -> None:
        """Hang up, and let the connection see its end."""
        self._client.close()
        await asyncio.sleep(_HANGS_UP_WALL_S)

    async def _bits(self, function: Function, read: Callable[..., Awaitable[ModbusPDU]], run: range) -> dict[int, bool]:
        reply = await self._ask(function, partial(read, run.start, count=len(run), device_id=self._device_id))
        padded = (len(run) + 7) // 8 * 8  # answers come in whole bytes
        if len(reply.bits) != padded:
            raise ProtocolError(NAME, f"{len(reply.bits)} bits came, expected {padded}")
        return dict(zip(run, reply.bits, strict=False))

    def _on_connection(self, connected: bool) -> None:
        """End the waiting for a coupler that has hung up: pymodbus would wait on (it calls this)."""
        if not connected:
            for wait in self._waits:
                if not wait.expired():
                    wait.reschedule(0.0)

    def _on_garbage(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Keep what pymodbus made of bytes that it cannot read; asyncio hangs up after it (and calls this)."""
        self._garbled = context.get("exception", self._garbled)

    def _lost(self) -> DeviceError:
        if self._garbled is not None:
            return ProtocolError(NAME, f"{self._address} sent what cannot be read: {self._garbled}")
        return LinkLost(NAME, f"{self._address} closed the connection")

    async def _ask(self, function: Function, request: Callable[[], Awaitable[ModbusPDU]]) -> ModbusPDU:
        if not self._client.connected:
            raise self._lost()
        try:
            async with asyncio.timeout(self._timeout_wall_s) as wait:
                self._waits.add(wait)
                try:
                    reply = await request()
                finally:
                    self._waits.discard(wait)
        except TimeoutError as error:
            if not self._client.connected:
                raise self._lost() from error
            raise LinkTimeout(NAME, f"no answer within {self._timeout_s:g} s") from error
        except ConnectionException as error:
            raise self._lost() from error
        except ModbusException as error:
            raise ProtocolError(NAME, str(error)) from error
        if reply.isError():
            code = getattr(reply, "exception_code", 0)
            raise ProtocolError(NAME, f"Modbus exception {code} to function {reply.function_code & 0x7F}")
        if reply.function_code != function:  # pymodbus takes any
            raise ProtocolError(NAME, f"answer to function {reply.function_code}, asked for {function:d}")
        return reply
