"""One wire with rail drives on it: pymodbus carries the bytes, the sieve says which answer counts.

Drives on the same serial line, or behind the same TCP gateway, share a ``ModbusBus`` and take turns.
"""

from __future__ import annotations

import asyncio
import logging
import termios
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException
from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersResponse

from hil.config.rail_wires import ModbusRtu
from hil.core.clock import WallClock
from hil.drivers.rails.frames import READ, READ_WRITE, Counters, Expected, ModbusFrame, ResponseMatcher
from hil.errors import LinkLost, LinkTimeout, ProtocolError

_PARITY: Final = {"none": "N", "even": "E", "odd": "O"}
_QUIET_S: Final = 0.005  # after damaged bytes: when nothing follows for so long, the answer is lost
_LAST_WORD_WALL_S: Final = 0.02
_PYMODBUS_TIMEOUT_S: Final = 60.0  # the time-outs here come first: they can tell what happened

# What goes wrong is raised and names the axis; pymodbus would add a packet trace on standard error.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

Client = AsyncModbusTcpClient | AsyncModbusSerialClient


class _SieveFramer(FramerBase):
    """What pymodbus asks for the answers in the bytes that came; ``inner`` builds the requests."""

    def __init__(self, inner: FramerBase, sieve: ResponseMatcher, on_damage: Callable[[], None]) -> None:
        super().__init__(inner.decoder)
        self._inner = inner
        self._sieve = sieve
        self._on_damage = on_damage

    def encode(self, payload: bytes, dev_id: int, tid: int) -> bytes:
        return self._inner.encode(payload, dev_id, tid)

    def buildFrame(self, message: ModbusPDU) -> bytes:
        expect = self._sieve.expect
        if expect is not None and self._sieve.tcp:
            self._sieve.expect = Expected(
                expect.device_id, expect.function, expect.count, message.transaction_id, expect.echo
            )
        return super().buildFrame(message)

    def handleFrame(self, data: bytes, exp_devid: int, exp_tid: int) -> tuple[int, ModbusPDU | None]:
        used, frame = self._sieve.feed(data)
        if frame is not None:
            return used, _answer(frame)
        if self._sieve.damaged:
            self._on_damage()
        return used, None


def _answer(frame: ModbusFrame) -> ModbusPDU:
    pdu: ModbusPDU
    if frame.exception:
        pdu = ExceptionResponse(frame.function & 0x7F, frame.exception)
    else:
        pdu = ReadHoldingRegistersResponse(registers=list(frame.registers))
    pdu.dev_id = frame.device_id
    pdu.transaction_id = frame.transaction
    return pdu


class ModbusBus:
    """A connection that drives use in turn. Must be made and used inside a running event loop.

    label: the wire as people know it, for texts. exchange_s: how long one exchange keeps the line busy, gap_s:
    silence that it needs between two frames; both 0 over TCP.
    """

    def __init__(
        self, label: str, tcp: bool, counters: Counters, clock: WallClock, exchange_s: float = 0.0, gap_s: float = 0.0
    ) -> None:
        self.label = label
        self.tcp = tcp
        self.counters = counters
        self.moment_s = 0.0  # half way between the last answered request and its answer
        self._clock = clock
        self._exchange_s = exchange_s
        self._gap_s = gap_s
        self._free_at_s = 0.0
        self._sieve = ResponseMatcher(tcp, counters)
        self._turn = asyncio.Lock()
        self._waits: set[asyncio.Timeout] = set()  # the request under way
        self._client: Client
        self._connecting: asyncio.Task[bool] | None = None

    @classmethod
    def to_host(cls, host: str, port: int, counters: Counters, clock: WallClock) -> ModbusBus:
        """Return a line over TCP."""
        line = cls(f"{host}:{port}", True, counters, clock)
        line._client = AsyncModbusTcpClient(
            host,
            port=port,
            timeout=_PYMODBUS_TIMEOUT_S,
            retries=0,
            reconnect_delay=0,  # a lost drive stays lost until the bench is opened again
            trace_connect=line._on_connection,
        )
        line._use_sieve(FramerSocket(DecodePDU(False)))
        return line

    @classmethod
    def on_port(
        cls, port: str, config: ModbusRtu, exchange_s: float, counters: Counters, clock: WallClock
    ) -> ModbusBus:
        """Return a line over a serial port."""
        line = cls(port, False, counters, clock, exchange_s, config.gap_s)
        line._client = AsyncModbusSerialClient(
            port,
            baudrate=config.baud,
            parity=_PARITY[config.parity],
            stopbits=config.stopbits,
            timeout=_PYMODBUS_TIMEOUT_S,
            retries=0,
            reconnect_delay=0,
            trace_connect=line._on_connection,
        )
        line._use_sieve(FramerRTU(DecodePDU(False)))
        return line

    async def connect(self, name: str, timeout_s: float) -> None:
        """Connect once for all who share the line; ``name``: the axis that asks."""
        if self._connecting is None:
            self._connecting = asyncio.ensure_future(self._client.connect())
        try:
            async with asyncio.timeout(self._clock.wall_s(timeout_s)):
                connected = await asyncio.shield(self._connecting)
        except TimeoutError as error:
            raise LinkTimeout(name, f"no connection to {self.label} in {timeout_s:g} s") from error
        except (OSError, ValueError, termios.error) as error:  # a port that cannot do what it is to be set to
            raise LinkLost(name, f"no connection to {self.label}: {error}") from error
        if not connected:
            why = "nothing listens there" if self.tcp else "the port cannot be opened"
            raise LinkLost(name, f"no connection to {self.label}: {why}")

    async def read(self, name: str, device_id: int, address: int, count: int, timeout_s: float) -> list[int]:
        """Return ``count`` holding registers; DeviceError in the name of the axis."""
        return await self._ask(
            name,
            Expected(device_id, READ, count),
            lambda: self._client.read_holding_registers(address, count=count, device_id=device_id),
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
        return await self._ask(
            name,
            Expected(device_id, READ_WRITE, read[1], echo=echo),
            lambda: self._transfer(device_id, written, read, answer=True),
            timeout_s,
        )

    async def leave(self, device_id: int, written: tuple[int, list[int]], read: tuple[int, int]) -> None:
        """Put a request on the wire whose answer nobody awaits. Never raises."""
        with suppress(TimeoutError, ModbusException):  # the wire is gone; nothing more can be done from here
            async with asyncio.timeout(_LAST_WORD_WALL_S), self._turn:
                self._sieve.await_(None)
                await self._transfer(device_id, written, read, answer=False)
                await asyncio.sleep(0.0)  # a serial port takes the bytes in the next turn of the event loop
                self._free_at_s = self._clock.now_s() + self._exchange_s

    def close(self) -> None:
        """Hang up; idempotent."""
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

    def _use_sieve(self, inner: FramerBase) -> None:
        self._client.ctx.framer = _SieveFramer(inner, self._sieve, self._on_damage)

    async def _ask(
        self, name: str, expected: Expected, request: Callable[[], Awaitable[ModbusPDU]], timeout_s: float
    ) -> list[int]:
        async with self._turn:
            reply = await self._turn_of(name, expected, request, timeout_s)
        if reply.isError():
            self.counters["protocol_errors"] += 1
            raise ProtocolError(name, f"Modbus exception {reply.exception_code} to function {expected.function}")
        self.counters["exchanges"] += 1
        return list(reply.registers)

    async def _turn_of(
        self, name: str, expected: Expected, request: Callable[[], Awaitable[ModbusPDU]], timeout_s: float
    ) -> ModbusPDU:
        await self._wait_for_silence()
        try:
            async with asyncio.timeout(self._clock.wall_s(timeout_s)) as wait:
                self._waits.add(wait)
                try:
                    asked_s = self._clock.now_s()
                    self._sieve.await_(expected)
                    reply = await request()
                    self.moment_s = 0.5 * (asked_s + self._clock.now_s())
                    return reply
                finally:
                    self._sieve.expect = None
                    self._waits.discard(wait)
                    self._free_at_s = self._clock.now_s() + self._gap_s
        except TimeoutError as error:
            if not self._client.connected:
                raise LinkLost(name, f"{self.label} closed the connection") from error
            if self._sieve.damaged:
                raise ProtocolError(name, f"answer damaged on the way, {self._sieve.damaged}") from error
            raise LinkTimeout(name, "no answer") from error
        except ConnectionException as error:
            raise LinkLost(name, f"{self.label} closed the connection") from error
        except ModbusException as error:
            raise ProtocolError(name, str(error)) from error

    async def _wait_for_silence(self) -> None:
        left_s = self._free_at_s - self._clock.now_s()
        if left_s > 0.0:
            await asyncio.sleep(self._clock.wall_s(left_s))

    def _on_connection(self, connected: bool) -> None:
        """End the waiting for a drive that has hung up: pymodbus would wait on (it calls this)."""
        if not connected:
            self._cut_waiting(0.0)

    def _on_damage(self) -> None:
        """Wait no longer than the rest of a damaged answer takes."""
        self._cut_waiting(asyncio.get_running_loop().time() + self._clock.wall_s(_QUIET_S + 4.0 * self._gap_s))

    def _cut_waiting(self, when: float) -> None:
        for wait in self._waits:
            due = wait.when()
            if not wait.expired() and (due is None or when < due):
                wait.reschedule(when)
