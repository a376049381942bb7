"""An emulated coupler on Modbus TCP with the safety relay, the emergency stop and the interlocks behind it."""

from __future__ import annotations

import asyncio
import struct
import threading
from collections.abc import Callable
from typing import Final

from hil.config.io import Io
from hil.core.clock import WallClock
from hil.drivers.fault_injection import WIRE, Faults, FaultyWire, InjectableFault, kinds
from hil.drivers.io import NAME
from hil.drivers.io.codec import Image, LineMap, answer
from hil.drivers.io.relay import SafetyRelay
from hil.maths.random_streams import stream

STEP_S: Final = 0.004  # of bench time, between two looks at the relay
IDENTITY: Final = ("hil", "io-coupler", "1.0")
BUTTONS: Final = {
    "estop": InjectableFault("the emergency stop is pressed"),
    "interlock": InjectableFault("an interlock's contact is open", of_axis=True),
}
_HEADER: Final = struct.Struct(">HHHB")  # transaction, protocol 0, bytes from here on with the unit, unit
_UNIT_BYTES: Final = 1
_LONGEST: Final = 254  # bytes after the length field

ChainBoard = Callable[[bool, float], None]
"""Told whether the chain is closed, and when, s of bench time."""


class EmulatedCoupler:
    """The coupler and what is wired to it. Time is handed in, s of bench time.

    pump_timeout_s: what the emulated relay waits for an edge of the charge pump.
    """

    def __init__(self, config: Io, pump_timeout_s: float) -> None:
        self.map = LineMap(config)
        self.faults = Faults(NAME, kinds(WIRE, BUTTONS), tuple(self.map.interlocks))
        coils, inputs = dict.fromkeys(self.map.coils, False), dict.fromkeys(self.map.inputs, False)
        self.image = Image(coils, inputs, IDENTITY)
        self.relay = SafetyRelay(pump_timeout_s)
        self.advance(0.0)

    @property
    def thrusters(self) -> tuple[bool, ...]:
        """The thrusters' lines."""
        return tuple(self.image.coils[address] for address in self.map.coils[2:])

    def advance(self, now_s: float) -> bool:
        """Bring relay and inputs up to date; return whether the chain is closed."""
        image, lines = self.image, self.map
        released = self.faults.value("estop") is None
        open_now = {name for name in lines.interlocks if self.faults.value("interlock", name) is not None}
        pump, enable = (image.coils[address] for address in lines.coils[:2])
        closed = self.relay.update(now_s, pump, enable, released and not open_now)
        if self.faults.value("freeze") is None:
            image.inputs[lines.estop] = released
            image.inputs[lines.chain] = closed
            for name, address in lines.interlocks.items():
                image.inputs[address] = name not in open_now
        return closed

    def answer(self, request: bytes, now_s: float) -> bytes:
        """Return the answer (PDU) to a request (PDU)."""
        self.advance(now_s)
        if self.faults.value("freeze") is not None:  # it accepts whatever comes, and its lines stay as they are
            frozen = Image(dict(self.image.coils), self.image.inputs, self.image.identity)
            return answer(frozen, request)
        answered = answer(self.image, request)
        self.advance(now_s)
        return answered


class IoEmulator:
    """A coupler on 127.0.0.1, port by the system; ``tell`` hears of the chain every 4 ms of bench time.

    Where bench time runs faster than the wall's, the relay waits for the charge pump as long on the wall
    as it does at the speed of time: what it waits for is a program on this computer.
    """

    def __init__(self, config: Io, clock: WallClock, tell: ChainBoard, seed: int = 0) -> None:
        self._clock = clock
        self._tell = tell
        self._unit = config.device_id
        self.coupler = EmulatedCoupler(config, config.pump_timeout_s * max(1.0, clock.speed))
        self.faults = self.coupler.faults
        self._wire = FaultyWire(self.faults, stream(seed, "wire"))
        self._loop = asyncio.new_event_loop()
        self._server: asyncio.Server | None = None
        self.connections: set[asyncio.Transport] = set()
        tell(False, clock.now_s())

    def start(self) -> dict[str, str]:
        """Listen; return ``{"io": "host:port"}``."""
        self._server = self._loop.run_until_complete(
            self._loop.create_server(lambda: _Connection(self._exchange, self.connections), "127.0.0.1", 0)
        )
        return {NAME: f"127.0.0.1:{self._server.sockets[0].getsockname()[1]}"}

    def run(self, stop: threading.Event) -> None:
        """Serve until ``stop`` is set."""
        self._loop.run_until_complete(self._serve(stop))

    def close(self) -> None:
        """Hang up. Idempotent."""
        if self._loop.is_closed():
            return
        if self._server is not None:
            self._server.close()
        for connection in list(self.connections):
            connection.close()
        self._loop.run_until_complete(asyncio.sleep(0.01))  # let the connections' own callbacks see their end
        self._loop.close()

    async def _serve(self, stop: threading.Event) -> None:
        tick_wall_s = self._clock.wall_s(STEP_S)
        while not stop.is_set():
            now_s = self._clock.now_s()
            self._tell(self.coupler.advance(now_s), now_s)
            await asyncio.sleep(tick_wall_s)

    def _exchange(self, transport: asyncio.Transport, transaction: int, unit: int, request: bytes) -> None:
        """Answer one request, as far as the wire lets it through."""
        if unit != self._unit or self.faults.value("link_down") is not None:
            return
        now_s = self._clock.now_s()
        answered = self.coupler.answer(request, now_s)
        self._tell(self.coupler.relay.closed, now_s)
        packet = _HEADER.pack(transaction, 0, len(answered) + _UNIT_BYTES, unit) + answered
        for delay_s, arrived in self._wire.passed(packet):
            self._loop.call_later(self._clock.wall_s(delay_s), _send, transport, arrived)


def _send(transport: asyncio.Transport, packet: bytes) -> None:
    if not transport.is_closing():
        transport.write(packet)


class _Connection(asyncio.Protocol):
    """Cuts one connection's bytes into requests; hangs up on bytes that are no Modbus TCP."""

    def __init__(
        self, exchange: Callable[[asyncio.Transport, int, int, bytes], None], everyone: set[asyncio.Transport]
    ) -> None:
        self._exchange = exchange
        self._everyone = everyone
        self._buffer = bytearray()
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._everyone.add(transport)

    def connection_lost(self, cause: Exception | None) -> None:
        self._everyone.discard(self._transport)

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        while len(self._buffer) >= _HEADER.size:
            transaction, protocol, length, unit = _HEADER.unpack_from(self._buffer)
            if protocol != 0 or not _UNIT_BYTES < length <= _LONGEST:
                self._transport.abort()
                return
            end = _HEADER.size - _UNIT_BYTES + length
            if len(self._buffer) < end:
                return
            request = bytes(self._buffer[_HEADER.size : end])
            del self._buffer[:end]
            self._exchange(self._transport, transaction, unit, request)
