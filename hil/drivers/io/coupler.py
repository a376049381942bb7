"""Link to the coupler: requests are bounded in time, errors name the device."""

from __future__ import annotations

import asyncio
import logging
import struct
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import Any, Final

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU

from hil.config.tables.io import Io
from hil.core.clock import BenchClock
from hil.drivers.io import NAME
from hil.drivers.io.codec import Function, LineMap
from hil.errors import DeviceError, LinkLost, LinkTimeout, ProtocolError

_LAST_REQUEST_WALL_S: Final = 0.02
_HANGS_UP_WALL_S: Final = 0.002
_AGAIN_WALL_S: Final = 0.002
_BUSY: Final = (5, 6, 11)  # exception codes: acknowledge, busy, gateway without a response
_ANY_UNIT: Final = (0, 255)  # of Modbus TCP devices for which the unit id has no meaning
_UNIT_AT: Final = 6
_FUNCTION_AT: Final = 7
_FUNCTIONS: Final = frozenset(Function)
_IDENTITY: Final = ("vendor", "product", "revision")  # objects 0, 1, 2

# Errors are raised with the device; pymodbus would log a packet trace to standard error.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


class Coupler:
    """One coupler; requires a running event loop.

    timeout_s: bench time for a response. counters: of busy responses, of odd frames, of responses with another unit id.
    """

    def __init__(self, config: Io, lines: LineMap, timeout_s: float, clock: BenchClock) -> None:
        self._lines = lines
        self._identity = config.identity
        self._address = f"{config.host}:{config.port}"
        self._device_id = config.device_id
        self._timeout_s = timeout_s
        self._timeout_wall_s = clock.wall_s(timeout_s)
        self._waits: set[asyncio.Timeout] = set()  # time-outs of pending requests
        self._decode_error: BaseException | None = None
        asyncio.get_running_loop().set_exception_handler(self._on_decode_error)
        self.counters = {"busy": 0, "odd": 0, "other_unit": 0}
        self._client = AsyncModbusTcpClient(
            config.host,
            port=config.port or 0,
            timeout=10.0 * self._timeout_wall_s,  # the time-out below expires first and reports the cause
            retries=0,
            reconnect_delay=0,  # a lost coupler stays lost until the bench is opened again
            trace_connect=self._on_connection,
        )
        self._framer = _TolerantFramer(self.counters, self._on_odd_frame)
        self._client.ctx.framer = self._framer

    async def identify(self) -> None:
        """Connect and check the identity, if the rig file requires one."""
        try:
            async with asyncio.timeout(self._timeout_wall_s):
                connected = await self._client.connect()
        except TimeoutError as error:
            raise LinkTimeout(NAME, f"no connection to {self._address} in {self._timeout_s:g} s") from error
        if not connected:
            raise LinkLost(NAME, f"no connection to {self._address}: nothing listens there")
        fields = [(number, name, getattr(self._identity, name)) for number, name in enumerate(_IDENTITY)]
        if all(expected is None for _, _, expected in fields):
            return
        request = partial(self._client.read_device_information, read_code=1, object_id=0, device_id=self._device_id)
        reply = await self._request(Function.ENCAPSULATED, request)
        objects: dict[int, object] = getattr(reply, "information", {})
        for number, name, expected in fields:
            reported = objects.get(number, b"")
            actual = reported.decode("ascii", "replace") if isinstance(reported, bytes) else str(reported)
            if expected is not None and actual != expected:
                text = f"wrong coupler at {self._address}: {name} {actual!r}, expected {expected!r}"
                raise ProtocolError(NAME, text)

    async def exchange(self, levels: dict[int, bool]) -> dict[int, bool]:
        """Write the coils, read them back, read the inputs; return the inputs by address.

        Raises ProtocolError if a coil does not read back as written: a defect of the coupler, or another client writes
        to it.
        """
        await self.write(levels)
        for run in self._lines.coil_runs:
            for address, level in (await self._bits(Function.READ_COILS, self._client.read_coils, run)).items():
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
            await self._request(Function.WRITE_COILS, request)

    async def send_off(self) -> None:
        """Set all outputs off, within a short time or not at all."""
        if not self._client.connected:
            return  # pymodbus would reconnect
        with suppress(TimeoutError, ModbusException, LinkLost, LinkTimeout, ProtocolError):  # the outputs time out
            async with asyncio.timeout(_LAST_REQUEST_WALL_S):
                await self.write(dict.fromkeys(self._lines.coils, False))

    async def close(self) -> None:
        """Disconnect, and let the connection's callbacks run."""
        self._client.close()
        await asyncio.sleep(_HANGS_UP_WALL_S)

    async def _bits(self, function: Function, read: Callable[..., Awaitable[ModbusPDU]], run: range) -> dict[int, bool]:
        reply = await self._request(function, partial(read, run.start, count=len(run), device_id=self._device_id))
        padded = (len(run) + 7) // 8 * 8  # responses are in whole bytes
        if len(reply.bits) != padded:
            raise ProtocolError(NAME, f"{len(reply.bits)} bits received, expected {padded}")
        return dict(zip(run, reply.bits, strict=False))

    def _on_connection(self, connected: bool) -> None:
        """End the wait for a coupler that has disconnected (called by pymodbus, which would keep waiting)."""
        if not connected:
            for wait in self._waits:
                if not wait.expired():
                    wait.reschedule(0.0)

    def _on_odd_frame(self, error: ModbusException) -> None:
        """End the wait for a response that has been damaged: it is requested again."""
        pending = self._client.ctx.response_future
        if not pending.done():
            pending.set_exception(error)

    def _on_decode_error(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Store the error of pymodbus on invalid bytes (called by asyncio, which then disconnects)."""
        self._decode_error = context.get("exception", self._decode_error)

    def _lost(self) -> DeviceError:
        if self._decode_error is not None:
            return ProtocolError(NAME, f"{self._address} sent invalid data: {self._decode_error}")
        return LinkLost(NAME, f"{self._address} closed the connection")

    async def _request(self, function: Function, request: Callable[[], Awaitable[ModbusPDU]]) -> ModbusPDU:
        """Return the response; a busy coupler and odd frames are counted, and asked again for ``timeout_s``."""
        if not self._client.connected:
            raise self._lost()
        problem: DeviceError | None = None
        self._framer.stranger = None
        try:
            async with asyncio.timeout(self._timeout_wall_s) as wait:
                self._waits.add(wait)
                try:
                    while True:
                        try:
                            reply = await request()
                        except ConnectionException:
                            raise
                        except ModbusException as error:
                            problem, code = ProtocolError(NAME, str(error)), 0
                        else:
                            problem, code = self._problem(function, reply), getattr(reply, "exception_code", 0)
                        if problem is None:
                            return reply
                        if code and code not in _BUSY:
                            raise problem
                        self.counters["busy" if code else "odd"] += 1
                        await asyncio.sleep(_AGAIN_WALL_S)
                finally:
                    self._waits.discard(wait)
        except TimeoutError as error:
            if not self._client.connected:
                raise self._lost() from error
            if problem is not None:
                raise problem from error
            raise LinkTimeout(NAME, f"no answer within {self._timeout_s:g} s{self._framer.stranger_text()}") from error
        except ConnectionException as error:
            raise self._lost() from error

    def _problem(self, function: Function, reply: ModbusPDU) -> ProtocolError | None:
        """Return the error of a response that is none to ``function``, None for a good one."""
        if reply.isError():
            code = getattr(reply, "exception_code", 0)
            return ProtocolError(NAME, f"Modbus exception {code} to function {reply.function_code & 0x7F}")
        if reply.function_code != function:  # pymodbus accepts any
            return ProtocolError(NAME, f"response to function {reply.function_code}, expected {function:d}")
        return None


class _TolerantFramer(FramerSocket):
    """Framer of pymodbus that also takes responses of the unit ids 0 and 255, and that outlives odd frames.

    A response is one by its transaction. on_odd: called with the error of a frame that is none. stranger: unit id of a
    response that was not taken.
    """

    def __init__(self, counters: dict[str, int], on_odd: Callable[[ModbusException], None]) -> None:
        super().__init__(DecodePDU(False))
        self._counters = counters
        self._on_odd = on_odd
        self.stranger: int | None = None

    def stranger_text(self) -> str:
        """Return an addition to the text of a time-out."""
        return "" if self.stranger is None else f"; unit {self.stranger} has answered: correct io.device_id"

    def handleFrame(self, data: bytes, exp_devid: int, exp_tid: int) -> tuple[int, ModbusPDU | None]:
        unit, transaction = data[_UNIT_AT] if len(data) > _UNIT_AT else exp_devid, int.from_bytes(data[:2], "big")
        if unit != exp_devid and transaction == exp_tid:
            if unit in _ANY_UNIT:
                self._counters["other_unit"] += 1
                data = data[:_UNIT_AT] + bytes((exp_devid,)) + data[_UNIT_AT + 1 :]
            else:
                self.stranger = unit
        is_known = len(data) <= _FUNCTION_AT or data[_FUNCTION_AT] & 0x7F in _FUNCTIONS
        if len(data) >= _UNIT_AT and (data[2:4] != b"\0\0" or not is_known):
            self._on_odd(ModbusException(f"no response of a coupler: {data[:16].hex(' ')}"))
            return len(data), None
        try:
            return super().handleFrame(data, exp_devid, exp_tid)
        except (ModbusException, ValueError, IndexError, struct.error) as error:
            self._on_odd(ModbusException(f"invalid data: {error}"))
            return len(data), None
