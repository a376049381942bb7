"""Modbus TCP server of the emulators: ports, connections and the faults of the wire."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import Final

from hil.core.clock import BenchClock
from hil.parts.emulation.fault_injection import FaultyWire

_READ_BYTES: Final = 4096

Feed = Callable[[bytes], tuple[int, list[bytes]]]
"""Returns the number of bytes consumed and the responses to the requests in them; ConnectionError disconnects."""


class ModbusTcpPort:
    """A listening port on 127.0.0.1 and its connections; responses pass the faulty wire."""

    def __init__(self, feed: Feed, wire: FaultyWire, clock: BenchClock) -> None:
        self.number = 0
        self._feed = feed
        self._wire = wire
        self._clock = clock
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()

    @property
    def address(self) -> str:
        """Address of the port, host:port."""
        return f"127.0.0.1:{self.number}"

    async def listen(self) -> None:
        """Accept connections, always on the same port. Idempotent."""
        if self._server is None:
            self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.number)
            self.number = self._server.sockets[0].getsockname()[1]

    def hang_up(self) -> None:
        """Close every connection and refuse new ones."""
        if self._server is not None:
            self._server.close()
            self._server = None
        self.disconnect()

    def disconnect(self) -> None:
        """Close every connection."""
        for writer in self._writers:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        data = b""
        try:
            with contextlib.suppress(ConnectionError):
                while received := await reader.read(_READ_BYTES):
                    data += received
                    used, responses = self._feed(data)
                    data = data[used:]
                    for response in responses:
                        self._send(writer, response)
        finally:
            self._writers.discard(writer)
            writer.transport.abort()

    def _send(self, writer: asyncio.StreamWriter, response: bytes) -> None:
        for delay_s, packet in self._wire.passed(response):
            if delay_s > 0.0:
                asyncio.get_running_loop().call_later(self._clock.wall_s(delay_s), self._write, writer, packet)
            else:
                self._write(writer, packet)

    def _write(self, writer: asyncio.StreamWriter, packet: bytes) -> None:
        if writer in self._writers:
            writer.write(packet)


class ModbusTcpEmulator:
    """Emulated device behind Modbus TCP ports. Subclasses fill ``_ports`` and define ``_step``."""

    def __init__(self, clock: BenchClock, period_s: float) -> None:
        self._clock = clock
        self._period_s = period_s
        self._loop = clock.new_event_loop()
        self._ports: list[ModbusTcpPort] = []

    def _step(self) -> None:
        """Advance the device to the present; called every period, in the event loop."""
        raise NotImplementedError

    def _is_up(self) -> bool:
        """Whether the ports accept connections."""
        return True

    def _listen(self) -> None:
        for port in self._ports:
            self._loop.run_until_complete(port.listen())

    def run(self, stop: threading.Event) -> None:
        """Serve until ``stop`` is set."""
        self._loop.run_until_complete(self._serve(stop))

    def close(self) -> None:
        """Close the ports. Idempotent."""
        if not self._loop.is_closed():
            self._loop.run_until_complete(self._shut_down())
            self._loop.close()

    async def _serve(self, stop: threading.Event) -> None:
        period_wall_s = self._clock.wall_s(self._period_s)
        while not stop.is_set():
            self._step()
            for port in self._ports:
                if self._is_up():
                    await port.listen()
                else:
                    port.hang_up()
            await asyncio.sleep(period_wall_s)

    async def _shut_down(self) -> None:
        for port in self._ports:
            port.hang_up()
        await asyncio.sleep(0.01)  # the tasks of the connections end
