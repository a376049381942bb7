"""Modbus bus of rail drives: pymodbus transfers the bytes, the ``ResponseMatcher`` selects the valid response.

Drives on the same serial line, or behind the same TCP gateway, share a ``ModbusBus`` and use it one after the other.
"""

from __future__ import annotations

import asyncio
import logging
import termios
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, Final

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersResponse

from hil.config.tables.wires import ModbusRtu
from hil.core.clock import BenchClock
from hil.drivers.rails.frames import READ, READ_WRITE, WRITE_ONE, Counters, Expected, ModbusFrame, ResponseMatcher
from hil.drivers.serial_port import set_low_latency, url_of
from hil.errors import LinkLost, LinkTimeout, ProtocolError

_PARITY: Final = {"none": "N", "even": "E", "odd": "O"}
_QUIET_S: Final = 0.005  # after damaged bytes: silence after which the response is lost
_LAST_REQUEST_WALL_S: Final = 0.02
_PYMODBUS_TIMEOUT_S: Final = 60.0  # the time-outs below expire first and report the cause

# Errors are raised with the axis; pymodbus would log a packet trace to standard error.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

Client = AsyncModbusTcpClient | AsyncModbusSerialClient


class _MatchingFramer(FramerBase):
    """Framer of pymodbus that takes responses from the matcher; ``inner`` builds the requests."""

    def __init__(self, inner: FramerBase, matcher: ResponseMatcher, on_damage: Callable[[], None]) -> None:
        super().__init__(inner.decoder)
        self._inner = inner
        self._matcher = matcher
        self._on_damage = on_damage

    def encode(self, payload: bytes, dev_id: int, tid: int) -> bytes:
        return self._inner.encode(payload, dev_id, tid)

    def buildFrame(self, message: ModbusPDU) -> bytes:
        expect = self._matcher.expect
        if expect is not None and self._matcher.tcp:
            self._matcher.expect = Expected(
                expect.device_id, expect.function, expect.count, message.transaction_id, expect.echo, expect.written
            )
        return super().buildFrame(message)

    def handleFrame(self, data: bytes, exp_devid: int, exp_tid: int) -> tuple[int, ModbusPDU | None]:
        used, frame = self._matcher.feed(data)
        if frame is not None:
            return used, _pdu(frame)
        if self._matcher.damaged:
            self._on_damage()
        return used, None


def _pdu(frame: ModbusFrame) -> ModbusPDU:
    pdu: ModbusPDU
    if frame.exception:
        pdu = ExceptionResponse(frame.function & 0x7F, frame.exception)
    else:
        pdu = ReadHoldingRegistersResponse(registers=list(frame.registers))
    pdu.dev_id = frame.device_id
    pdu.transaction_id = frame.transaction
    return pdu


class ModbusBus:
    """A connection shared by drives; requires a running event loop.

    label: name of the wire in messages. exchange_s: time of one exchange on the line, gap_s: silence between two
    frames; both 0 over TCP.
    """

    def __init__(
        self, label: str, tcp: bool, counters: Counters, clock: BenchClock, exchange_s: float = 0.0, gap_s: float = 0.0
    ) -> None:
        self.label = label
        self.tcp = tcp
        self.counters = counters
        self.sampled_s = 0.0  # half way between the last request and its response
        self._clock = clock
        self._exchange_s = exchange_s
        self._gap_s = gap_s
        self._free_at_s = 0.0
        self._matcher = ResponseMatcher(tcp, counters)
        self._lock = asyncio.Lock()
        self._waits: set[asyncio.Timeout] = set()  # the request under way
        self._client: Client
        self._connecting: asyncio.Task[bool] | None = None

    @classmethod
    def to_host(cls, host: str, port: int, counters: Counters, clock: BenchClock) -> ModbusBus:
        """Return a bus over TCP."""
        line = cls(f"{host}:{port}", True, counters, clock)
        line._client = AsyncModbusTcpClient(
            host,
            port=port,
            timeout=_PYMODBUS_TIMEOUT_S,
            retries=0,
            reconnect_delay=0,  # a lost drive stays lost until the bench is opened again
            trace_connect=line._on_connection,
        )
        line._install_framer(FramerSocket(DecodePDU(False)))
        return line

    @classmethod
    def on_port(
        cls, port: str, config: ModbusRtu, exchange_s: float, counters: Counters, clock: BenchClock
    ) -> ModbusBus:
        """Return a bus on a serial port."""
        line = cls(port, False, counters, clock, exchange_s, config.gap_s)
        line._client = AsyncModbusSerialClient(
            url_of(clock, port),
            baudrate=config.baud,
            parity=_PARITY[config.parity],
            stopbits=config.stopbits,
            timeout=_PYMODBUS_TIMEOUT_S,
            retries=0,
            reconnect_delay=0,
            trace_connect=line._on_connection,
        )
        line._install_framer(FramerRTU(DecodePDU(False)))
        return line

    async def connect(self, name: str, timeout_s: float) -> None:
        """Connect once for all drives of the bus; ``name``: requesting axis."""
        if self._connecting is None:
            self._connecting = asyncio.ensure_future(self._client.connect())
        try:
            async with asyncio.timeout(self._clock.wall_s(timeout_s)):
                connected = await asyncio.shield(self._connecting)
        except TimeoutError as error:
            raise LinkTimeout(name, f"no connection to {self.label} in {timeout_s:g} s") from error
        except (OSError, ValueError, termios.error) as error:  # unsupported settings of the port
            raise LinkLost(name, f"no connection to {self.label}: {error}") from error
        if not connected:
            why = "nothing listens there" if self.tcp else "the port cannot be opened"
            raise LinkLost(name, f"no connection to {self.label}: {why}")
        if not self.tcp:
            set_low_latency(getattr(self._client.ctx.transport, "sync_serial", None))

    async def read(
        self, name: str, device_id: int, read: tuple[int, int], timeout_s: float, echo: tuple[int, int] | None = None
    ) -> list[int]:
        """Return the holding registers at (address, count); errors name the axis."""
        return await self._request(
            name,
            Expected(device_id, READ, read[1], echo=echo),
            lambda: self._client.read_holding_registers(read[0], count=read[1], device_id=device_id),
            timeout_s,
        )

    async def write(
        self, name: str, device_id: int, function: int, written: tuple[int, list[int]], timeout_s: float
    ) -> None:
        """Write (address, registers) with ``function``, WRITE_ONE or WRITE; errors name the axis."""
        address, registers = written
        repeated = address, registers[0] if function == WRITE_ONE else len(registers)
        await self._request(
            name,
            Expected(device_id, function, len(repeated), written=repeated),
            lambda: self._write(device_id, function, written, answer=True),
            timeout_s,
        )

    async def write_and_read(
        self,
        name: str,
        device_id: int,
        written: tuple[int, list[int]],
        read: tuple[int, int],
        echo: tuple[int, int] | None,
        timeout_s: float,
    ) -> list[int]:
        """Write (address, registers), then return the registers at (address, count), in one transaction."""
        return await self._request(
            name,
            Expected(device_id, READ_WRITE, read[1], echo=echo),
            lambda: self._transfer(device_id, written, read, answer=True),
            timeout_s,
        )

    async def send(self, device_id: int, function: int, written: tuple[int, list[int]], read: tuple[int, int]) -> None:
        """Send a request without waiting for the response. Never raises. read: of READ_WRITE."""
        with suppress(TimeoutError, ModbusException):  # the wire is gone
            async with asyncio.timeout(_LAST_REQUEST_WALL_S), self._lock:
                self._matcher.await_(None)
                if function == READ_WRITE:
                    await self._transfer(device_id, written, read, answer=False)
                else:
                    await self._write(device_id, function, written, answer=False)
                await asyncio.sleep(0.0)  # a serial port writes in the next iteration of the event loop
                self._free_at_s = self._clock.now_s() + self._exchange_s

    def close(self) -> None:
        """Disconnect. Idempotent."""
        if self._connecting is not None:
            self._connecting.cancel()
        self._client.close()

    def _transfer(
        self, device_id: int, written: tuple[int, list[int]], read: tuple[int, int], answer: bool
    ) -> Awaitable[ModbusPDU]:
        return self._client.readwrite_registers(
            read_address=read[0],
            read_count=read[1],
            write_address=written[0],
            values=written[1],
            device_id=device_id,
            no_response_expected=not answer,
        )

    def _write(
        self, device_id: int, function: int, written: tuple[int, list[int]], answer: bool
    ) -> Awaitable[ModbusPDU]:
        address, registers = written
        how: dict[str, Any] = {"device_id": device_id, "no_response_expected": not answer}
        if function == WRITE_ONE:
            return self._client.write_register(address, registers[0], **how)
        return self._client.write_registers(address, registers, **how)

    def _install_framer(self, inner: FramerBase) -> None:
        self._client.ctx.framer = _MatchingFramer(inner, self._matcher, self._on_damage)

    async def _request(
        self, name: str, expected: Expected, request: Callable[[], Awaitable[ModbusPDU]], timeout_s: float
    ) -> list[int]:
        async with self._lock:
            reply = await self._transact(name, expected, request, timeout_s)
        if reply.isError():
            self.counters["protocol_errors"] += 1
            raise ProtocolError(name, f"Modbus exception {reply.exception_code} to function {expected.function}")
        self.counters["exchanges"] += 1
        return list(reply.registers)

    async def _transact(
        self, name: str, expected: Expected, request: Callable[[], Awaitable[ModbusPDU]], timeout_s: float
    ) -> ModbusPDU:
        await self._wait_for_silence()
        try:
            async with asyncio.timeout(self._clock.wall_s(timeout_s)) as wait:
                self._waits.add(wait)
                try:
                    sent_s = self._clock.now_s()
                    self._matcher.await_(expected)
                    reply = await request()
                    self.sampled_s = 0.5 * (sent_s + self._clock.now_s())
                    return reply
                finally:
                    self._matcher.expect = None
                    self._waits.discard(wait)
                    self._free_at_s = self._clock.now_s() + self._gap_s
        except TimeoutError as error:
            if not self._client.connected:
                raise LinkLost(name, f"{self.label} closed the connection") from error
            if self._matcher.damaged:
                raise ProtocolError(name, f"answer damaged on the way, {self._matcher.damaged}") from error
            stranger = self._matcher.stranger
            hint = (
                "" if stranger is None else f" of unit {expected.device_id}; unit {stranger} has answered: correct it"
            )
            raise LinkTimeout(name, f"no answer{hint}") from error
        except ConnectionException as error:
            raise LinkLost(name, f"{self.label} closed the connection") from error
        except ModbusException as error:
            raise ProtocolError(name, str(error)) from error

    async def _wait_for_silence(self) -> None:
        left_s = self._free_at_s - self._clock.now_s()
        if left_s > 0.0:
            await asyncio.sleep(self._clock.wall_s(left_s))

    def _on_connection(self, connected: bool) -> None:
        """End the wait for a drive that has disconnected (called by pymodbus, which would keep waiting)."""
        if not connected:
            self._cut_waiting(0.0)

    def _on_damage(self) -> None:
        """Limit the wait to the rest of a damaged response."""
        self._cut_waiting(asyncio.get_running_loop().time() + self._clock.wall_s(_QUIET_S + 4.0 * self._gap_s))

    def _cut_waiting(self, when: float) -> None:
        for wait in self._waits:
            due = wait.when()
            if not wait.expired() and (due is None or when < due):
                wait.reschedule(when)
