"""Emulated rail drives behind their Modbus registers: bytes of a request in, bytes of the answer out."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Coroutine, Sequence
from functools import partial
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.simulator import DataType, SimData, SimDevice
from pymodbus.simulator.simcore import SimCore

from hil.core.clock import WallClock
from hil.core.messages import Homing
from hil.drivers.emulated_axes import WATCHDOG_S, EmulatedAxes
from hil.drivers.rails.codec import Command, ControlFlags, DriveIdentity, RegisterBlock, RegisterMap, State, Status

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # a controller that hangs up is no error here


class EmulatedRailDrive:
    """One axis: what the drive's firmware does with commands. No I/O; time is handed in.

    torque_off_code: fault that it reports while the safety chain is open.
    """

    def __init__(self, axes: EmulatedAxes, index: int, torque_off_code: int = 7) -> None:
        self._axes = axes
        self._index = index
        self._torque_off_code = torque_off_code
        self._enabled = False
        self._quick_stop = False
        self._fault = 0
        self._echo = 0
        self._seeking = False
        self._silent_from_s = math.inf  # when the watchdog ends a search

    @property
    def held(self) -> bool:
        """Whether the axis brakes or stands, whatever setpoint it was given."""
        return not self._enabled or self._quick_stop or self._fault != 0

    def trip(self, fault: int) -> None:
        """Let the drive report a fault and stop."""
        self._fault = fault
        self._axes.brake(self._index)

    def command(self, command: Command, now_s: float) -> None:
        """Take what the controller wrote."""
        self._axes.advance(now_s)
        self._echo = command.number
        self._enabled = bool(command.control & ControlFlags.ENABLE)
        if not self._enabled:
            self._quick_stop = False
            if command.control & ControlFlags.FAULT_RESET:
                self._fault = 0
        if command.control & ControlFlags.QUICK_STOP:
            self._quick_stop = True
        self._supervise_chain()
        sought, self._seeking = self._seeking, bool(command.control & ControlFlags.HOME) and not self.held
        self._silent_from_s = now_s + WATCHDOG_S
        if self.held or (sought and not self._seeking and self._under_way):
            self._axes.brake(self._index)
        elif self._seeking:
            if not sought:
                self._axes.home(self._index)
        else:
            self._axes.follow(self._index, command.position_m, command.rate_mps, now_s)

    def supervise(self, now_s: float) -> None:
        """Make a quick stop when the controller has gone silent; tell when the torque is gone."""
        self._supervise_chain()
        silent = self._under_way and now_s > self._silent_from_s
        if self._axes.overdue[self._index] or silent:
            self._axes.overdue[self._index] = False
            self._quick_stop = True
            self._axes.brake(self._index)

    def state(self, now_s: float) -> State:
        """Return what the drive reports."""
        self._axes.advance(now_s)
        self.supervise(now_s)
        axes, i = self._axes, self._index
        flags = {
            Status.READY: self._fault == 0,
            Status.FAULT: self._fault != 0,
            Status.ENABLED: self._enabled and self._fault == 0,
            Status.MOVING: axes.moving(i),
            Status.QUICK_STOP: self._quick_stop,
            Status.LIMIT: axes.limit[i] != 0,
            Status.LIMIT_LOW: axes.limit[i] < 0,
            Status.LIMIT_HIGH: axes.limit[i] > 0,
            Status.HOMED: axes.homing[i] is Homing.DONE,
            Status.HOMING_FAILED: axes.homing[i] is Homing.FAILED,
        }
        status = Status(sum(flag for flag, is_on in flags.items() if is_on))
        return State(status, self._fault, self._echo, float(axes.position[i]), float(axes.rate[i]))

    @property
    def _under_way(self) -> bool:
        return self._axes.homing[self._index] is Homing.UNDER_WAY

    def _supervise_chain(self) -> None:
        if self._axes.torque_off and self._fault == 0:
            self.trip(self._torque_off_code)


class ModbusServer:
    """The drives on one wire. Answers what pymodbus, as a server, would answer; silent to foreign device ids.

    drives: by device id.
    """

    def __init__(
        self,
        drives: dict[int, EmulatedRailDrive],
        register_map: RegisterMap,
        identity: DriveIdentity,
        clock: WallClock,
        tcp: bool,
    ) -> None:
        self._drives = drives
        self._core = SimCore([_device(d, id_, register_map, identity, clock) for id_, d in drives.items()])
        decoder = DecodePDU(True)
        self._framer: FramerBase = FramerSocket(decoder) if tcp else FramerRTU(decoder)

    def feed(self, data: bytes) -> tuple[int, list[bytes]]:
        """Return how many bytes of ``data`` are done with, and the answers to the requests in it."""
        used = 0
        answers: list[bytes] = []
        while used < len(data):
            try:
                taken, request = self._framer.handleFrame(data[used:], 0, 0)
            except (ModbusException, IndexError):
                return len(data), answers
            used += taken
            if request is None:
                break
            if request.dev_id in self._drives:
                answers.append(self._framer.buildFrame(self._answer(request)))
        return used, answers

    def _answer(self, request: ModbusPDU) -> ModbusPDU:
        try:
            answer = _finished(request.datastore_update(self._core, request.dev_id))  # type: ignore[arg-type]
        except (ModbusException, ValueError):
            answer = ExceptionResponse(request.function_code, ExcCodes.DEVICE_FAILURE)
        answer.transaction_id, answer.dev_id = request.transaction_id, request.dev_id
        return answer


def _finished(step: Coroutine[Any, Any, ModbusPDU]) -> ModbusPDU:
    """Return what a coroutine that waits for nothing returns."""
    try:
        step.send(None)
    except StopIteration as end:
        answer: ModbusPDU = end.value
        return answer
    step.close()
    raise asyncio.InvalidStateError("the registers made somebody wait")


def _device(
    drive: EmulatedRailDrive, device_id: int, register_map: RegisterMap, identity: DriveIdentity, clock: WallClock
) -> SimDevice:
    """Return the register file of one drive; every access ends in ``drive``."""

    def registers(block: RegisterBlock, values: list[int], readonly: bool) -> SimData:
        return SimData(block.address, values=values, datatype=DataType.REGISTERS, readonly=readonly)

    blocks = [
        registers(register_map.command, [0] * register_map.command.count, readonly=False),
        registers(register_map.state, [0] * register_map.state.count, readonly=True),
        registers(register_map.identity, register_map.encode_identity(identity), readonly=True),
    ]
    simdata = sorted(blocks, key=lambda block: block.address)
    return SimDevice(id=device_id, simdata=simdata, action=partial(_access, drive, register_map, clock))


async def _access(
    drive: EmulatedRailDrive,
    register_map: RegisterMap,
    clock: WallClock,
    function: int,
    start: int,
    address: int,
    count: int,
    registers: list[int],
    values: Sequence[int] | Sequence[bool] | None,
) -> ExcCodes | None:
    """Take a write, or bring the state block up to date before it is read (pymodbus calls this)."""
    if values is None:
        state = register_map.state
        registers[state.address - start : state.address - start + state.count] = register_map.encode_state(
            drive.state(clock.now_s())
        )
        return None
    block = register_map.command
    written = registers[block.address - start : block.address - start + block.count]
    written[address - block.address : address - block.address + count] = [int(value) for value in values]
    try:
        command = register_map.decode_command(written)
    except ValueError:
        return ExcCodes.ILLEGAL_VALUE
    drive.command(command, clock.now_s())
    return None
