"""Emulated rails: three Modbus TCP servers with the servo's dynamics behind them."""

from __future__ import annotations

import asyncio
import logging
import threading
from functools import partial
from typing import Final

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from hil.clock import WallClock
from hil.config.rig import Modbus, Rails
from hil.drivers.base import RAIL_NAMES, full_names
from hil.drivers.board import AxisBoard
from hil.drivers.emulated_axes import STEP_S, EmulatedAxes
from hil.drivers.rails.codec import DRIVE_MAP, Block, Command, Control, Identity, State, Status

FIRMWARE: Final = (1, 0)

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # a controller that hangs up is no error here


class EmulatedDrive:
    """One axis: what the drive's firmware does with commands. No I/O; time is handed in."""

    def __init__(self, axes: EmulatedAxes, index: int) -> None:
        self._axes = axes
        self._index = index
        self._enabled = False
        self._quick_stop = False
        self._fault = 0
        self._echo = 0

    @property
    def held(self) -> bool:
        """Whether the axis brakes or stands, whatever setpoint it was given."""
        return not self._enabled or self._quick_stop or self._fault != 0

    def trip(self, fault: int) -> None:
        """Let the drive report a fault (codec.FAULTS) and stop."""
        self._fault = fault
        self._axes.brake(self._index)

    def command(self, command: Command, now_s: float) -> None:
        """Take what the controller wrote."""
        self._axes.advance(now_s)
        self._echo = command.number
        self._enabled = bool(command.control & Control.ENABLE)
        if not self._enabled:
            self._quick_stop = False
            if command.control & Control.FAULT_RESET:
                self._fault = 0
        if command.control & Control.QUICK_STOP:
            self._quick_stop = True
        if self.held:
            self._axes.brake(self._index)
        else:
            self._axes.follow(self._index, command.position_m, command.rate_mps, now_s)

    def supervise(self) -> None:
        """Make a quick stop when the controller has gone silent."""
        if self._axes.overdue[self._index]:
            self._axes.overdue[self._index] = False
            self._quick_stop = True

    def state(self, now_s: float) -> State:
        """Return what the drive reports."""
        self._axes.advance(now_s)
        self.supervise()
        axes, i = self._axes, self._index
        status = Status.READY if self._fault == 0 else Status.FAULT
        if self._enabled and self._fault == 0:
            status |= Status.ENABLED
        if axes.moving(i):
            status |= Status.MOVING
        if self._quick_stop:
            status |= Status.QUICK_STOP
        if axes.limit[i]:
            status |= Status.LIMIT
        return State(status, self._fault, self._echo, float(axes.position[i]), float(axes.rate[i]))


class RailsEmulator:
    """Three drives on 127.0.0.1, ports by the system; their places go to ``board`` every 4 ms of bench time."""

    def __init__(self, config: Rails, clock: WallClock, board: AxisBoard, name: str = "rails") -> None:
        self._name = name
        wires = config.modbus or Modbus()
        self._device_ids = [getattr(wires, name).device_id for name in RAIL_NAMES]
        self._clock = clock
        self._axes = EmulatedAxes(name, config, clock, board)
        self.faults = self._axes.faults
        self._loop = asyncio.new_event_loop()
        self._servers: list[ModbusTcpServer] = []
        self.drives = [EmulatedDrive(self._axes, index) for index in range(len(RAIL_NAMES))]

    def start(self) -> dict[str, str]:
        """Listen; return axis name -> "host:port"."""
        self._servers = self._loop.run_until_complete(self._listen())
        ports = [server.transport.sockets[0].getsockname()[1] for server in self._servers]  # type: ignore[attr-defined]
        names = full_names(self._name, RAIL_NAMES)
        return {name: f"127.0.0.1:{port}" for name, port in zip(names, ports, strict=True)}

    def run(self, stop: threading.Event) -> None:
        """Serve until ``stop`` is set."""
        self._loop.run_until_complete(self._serve(stop))

    def close(self) -> None:
        """Hang up. Idempotent."""
        if self._loop.is_closed():
            return
        self._loop.run_until_complete(self._shut_down())
        self._loop.close()

    async def _listen(self) -> list[ModbusTcpServer]:
        servers = []
        for drive, device_id in zip(self.drives, self._device_ids, strict=True):
            server = ModbusTcpServer(_device(drive, device_id, self._clock), address=("127.0.0.1", 0))
            await server.serve_forever(background=True)
            servers.append(server)
        return servers

    async def _serve(self, stop: threading.Event) -> None:
        tick_wall_s = self._clock.wall_s(STEP_S)
        while not stop.is_set():
            self._axes.advance(self._clock.now_s())
            for drive in self.drives:
                drive.supervise()
            await asyncio.sleep(tick_wall_s)

    async def _shut_down(self) -> None:
        for server in self._servers:
            await server.shutdown()
        await asyncio.sleep(0.01)  # let the connections' own callbacks see their end


def _device(drive: EmulatedDrive, device_id: int, clock: WallClock) -> SimDevice:
    """Return the register file of one drive; every access ends in ``drive``."""

    def registers(block: Block, values: list[int], readonly: bool) -> SimData:
        return SimData(block.address, values=values, datatype=DataType.REGISTERS, readonly=readonly)

    identity = DRIVE_MAP.encode_identity(Identity(DRIVE_MAP.vendor, FIRMWARE))
    return SimDevice(
        id=device_id,
        simdata=[
            registers(DRIVE_MAP.command, [0] * DRIVE_MAP.command.count, readonly=False),
            registers(DRIVE_MAP.state, [0] * DRIVE_MAP.state.count, readonly=True),
            registers(DRIVE_MAP.identity, identity, readonly=True),
        ],
        action=partial(_access, drive, clock),
    )


async def _access(
    drive: EmulatedDrive,
    clock: WallClock,
    function: int,
    start: int,
    address: int,
    count: int,
    registers: list[int],
    values: list[int] | list[bool] | None,
) -> ExcCodes | None:
    """Take a write, or bring the state block up to date before it is read (pymodbus calls this)."""
    if values is None:
        _place(registers, start, DRIVE_MAP.state, DRIVE_MAP.encode_state(drive.state(clock.now_s())))
        return None
    block = DRIVE_MAP.command
    written = registers[block.address - start : block.address - start + block.count]
    written[address - block.address : address - block.address + count] = [int(value) for value in values]
    drive.command(DRIVE_MAP.decode_command(written), clock.now_s())
    return None


def _place(registers: list[int], start: int, block: Block, values: list[int]) -> None:
    registers[block.address - start : block.address - start + block.count] = values
