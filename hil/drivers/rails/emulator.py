"""Emulated rails on the wire: three drives on Modbus TCP, or on one serial line, with the servo's dynamics."""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import threading
from typing import Final

from hil.config.rail_wires import ModbusRtu
from hil.config.rig import Rails
from hil.core.clock import WallClock
from hil.drivers.base import RAIL_NAMES, full_names
from hil.drivers.emulated_axes import STEP_S, ChainClosed, EmulatedAxes
from hil.drivers.fault_injection import FaultyWire
from hil.drivers.pty_line import PtyLine
from hil.drivers.rails.codec import DriveIdentity, RegisterMap
from hil.drivers.rails.modbus_server import EmulatedRailDrive, ModbusServer
from hil.drivers.rails.wiring import tcp_axes
from hil.drivers.shared_state import SharedAxisState
from hil.errors import FaultKind
from hil.maths.random_streams import stream

FIRMWARE: Final = (1, 0)
_READ_BYTES: Final = 4096
_SILENCE_S: Final = 0.02  # much longer than between the bytes of one request, however busy this host is
_PTY_BITS_A_BYTE: Final = 10  # that PtyLine reckons with


class _Rails:
    """The three drives, whatever their wire. seed: of everything that chance decides in them."""

    def __init__(
        self,
        config: Rails,
        clock: WallClock,
        board: SharedAxisState,
        chain_closed: ChainClosed | None = None,
        seed: int = 0,
        name: str = "rails",
    ) -> None:
        self._config = config
        self._clock = clock
        self._map = RegisterMap(config.map)
        self._identity = DriveIdentity(config.map.vendor, max(FIRMWARE, config.map.firmware_min))
        self._axes = EmulatedAxes(name, config, clock, board, chain_closed=chain_closed, seed=seed)
        self.faults = self._axes.faults
        self._wire = FaultyWire(self.faults, stream(seed, "wire"))
        torque_off = self._map.code_of(FaultKind.TORQUE_OFF)
        self.drives = [EmulatedRailDrive(self._axes, index, torque_off) for index in range(len(RAIL_NAMES))]

    def _advance(self) -> None:
        """Bring axes and drives to now."""
        now_s = self._clock.now_s()
        self._axes.advance(now_s)
        for name, drive in zip(RAIL_NAMES, self.drives, strict=True):
            code = self.faults.pop("drive_fault", name)
            if code is not None:
                drive.trip(int(code) or self._map.code_of(FaultKind.OTHER))
            drive.supervise(now_s)


class RailsEmulator(_Rails):
    """Three drives on 127.0.0.1, ports by the system; those with one host and port in the rig file share one.

    Their places go to the board every 4 ms of bench time.
    """

    def __init__(
        self,
        config: Rails,
        clock: WallClock,
        board: SharedAxisState,
        chain_closed: ChainClosed | None = None,
        seed: int = 0,
        name: str = "rails",
    ) -> None:
        super().__init__(config, clock, board, chain_closed, seed, name)
        self._loop = asyncio.new_event_loop()
        self._ports: list[_TcpPort] = []

    def start(self) -> dict[str, str]:
        """Listen; return axis name -> "host:port"."""
        names = full_names(self.faults.device, RAIL_NAMES)
        groups: dict[object, list[int]] = {}
        axes = tcp_axes(self._config)
        for index, axis in enumerate(axes):
            groups.setdefault(index if axis.port is None else (axis.host, axis.port), []).append(index)
        addresses: dict[str, str] = {}
        for group in groups.values():
            drives = {axes[index].device_id: self.drives[index] for index in group}
            port = _TcpPort(
                ModbusServer(drives, self._map, self._identity, self._clock, tcp=True), self._wire, self._clock
            )
            self._loop.run_until_complete(port.listen())
            self._ports.append(port)
            addresses |= {names[index]: f"127.0.0.1:{port.number}" for index in group}
        return {name: addresses[name] for name in names}

    def run(self, stop: threading.Event) -> None:
        """Serve until ``stop`` is set."""
        self._loop.run_until_complete(self._serve(stop))

    def close(self) -> None:
        """Hang up. Idempotent."""
        if self._loop.is_closed():
            return
        self._loop.run_until_complete(self._shut_down())
        self._loop.close()

    async def _serve(self, stop: threading.Event) -> None:
        tick_wall_s = self._clock.wall_s(STEP_S)
        while not stop.is_set():
            self._advance()
            down = self.faults.value("link_down") is not None
            for port in self._ports:
                await (port.hang_up() if down else port.listen())
            await asyncio.sleep(tick_wall_s)

    async def _shut_down(self) -> None:
        for port in self._ports:
            await port.hang_up()
        await asyncio.sleep(0.01)  # let the connections' own tasks see their end


class _TcpPort:
    """A listening port and its connections; each answer passes the faulty wire."""

    def __init__(self, slave: ModbusServer, wire: FaultyWire, clock: WallClock) -> None:
        self.number = 0
        self._slave = slave
        self._wire = wire
        self._clock = clock
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()

    async def listen(self) -> None:
        """Take connections, always on the same port; nothing to do when it is listening."""
        if self._server is None:
            self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.number)
            self.number = self._server.sockets[0].getsockname()[1]

    async def hang_up(self) -> None:
        """Close every connection and refuse new ones."""
        if self._server is not None:
            self._server.close()
            self._server = None
        for writer in self._writers:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        data = b""
        try:
            with contextlib.suppress(ConnectionError):
                while received := await reader.read(_READ_BYTES):
                    data += received
                    used, answers = self._slave.feed(data)
                    data = data[used:]
                    for answer in answers:
                        self._send(writer, answer)
        finally:
            self._writers.discard(writer)
            writer.transport.abort()

    def _send(self, writer: asyncio.StreamWriter, answer: bytes) -> None:
        for delay_s, packet in self._wire.passed(answer):
            if delay_s > 0.0:
                asyncio.get_running_loop().call_later(self._clock.wall_s(delay_s), self._write, writer, packet)
            else:
                self._write(writer, packet)

    def _write(self, writer: asyncio.StreamWriter, packet: bytes) -> None:
        if writer in self._writers:
            writer.write(packet)


class RtuRailsEmulator(_Rails):
    """Three drives on one serial line, a pseudo terminal that takes as long as the real one."""

    def __init__(
        self,
        config: Rails,
        clock: WallClock,
        board: SharedAxisState,
        chain_closed: ChainClosed | None = None,
        seed: int = 0,
        name: str = "rails",
    ) -> None:
        super().__init__(config, clock, board, chain_closed, seed, name)
        self._rtu = config.rtu or ModbusRtu()
        drives = dict(zip(self._rtu.device_ids, self.drives, strict=True))
        self._slave = ModbusServer(drives, self._map, self._identity, clock, tcp=False)
        self._line: PtyLine | None = None
        self._on_the_way: list[tuple[float, int, bytes]] = []  # a heap by time of sending
        self._sent = 0

    def start(self) -> dict[str, str]:
        """Open the line; return its path."""
        self._line = PtyLine(round(self._rtu.baud * _PTY_BITS_A_BYTE / self._rtu.bits_per_byte), self._clock)
        return {self.faults.device: self._line.path}

    def run(self, stop: threading.Event) -> None:
        """Serve the line until ``stop`` is set."""
        line = self._line
        if line is None:
            raise RuntimeError("start the emulator first")
        data, heard_s = b"", 0.0
        while not stop.is_set():
            received = line.read(STEP_S)
            self._advance()
            if received:
                now_s = self._clock.now_s()
                # what was no request before a silence never will be one
                data = received if now_s - heard_s > _SILENCE_S else data + received
                heard_s = now_s
                used, answers = self._slave.feed(data)
                data = data[used:]
                for answer in answers:
                    self._take(answer)
            self._send_what_is_due(line)

    def close(self) -> None:
        """Close the line; idempotent."""
        if self._line is not None:
            self._line.close()
        self._line = None

    def _take(self, answer: bytes) -> None:
        for delay_s, packet in self._wire.passed(answer):
            heapq.heappush(self._on_the_way, (self._clock.now_s() + delay_s, self._sent, packet))
            self._sent += 1

    def _send_what_is_due(self, line: PtyLine) -> None:
        while self._on_the_way and self._on_the_way[0][0] <= self._clock.now_s():
            line.write(heapq.heappop(self._on_the_way)[2])
            self._advance()
