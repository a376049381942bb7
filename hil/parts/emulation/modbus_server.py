"""Modbus server of emulated rail drives: bytes of requests in, bytes of responses out."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Coroutine, Sequence
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.simulator import DataType, SimData, SimDevice
from pymodbus.simulator.simcore import SimCore

from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.rails.codec import Command, ControlFlags, RegisterMap, State, Status
from hil.drivers.rails.frames import READ_WRITE
from hil.parts.emulation.emulated_axes import WATCHDOG_S, EmulatedAxes

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # a client that disconnects is not an error


class EmulatedRailDrive:
    """Firmware of the drive of one axis. No I/O; time is an argument.

    torque_off_code, following_error_code: fault codes reported while the safety chain is open, and once the axis has
    lost its torque because of its following error.
    """

    def __init__(self, axes: EmulatedAxes, index: int, torque_off_code: int = 7, following_error_code: int = 1) -> None:
        self._axes = axes
        self._index = index
        self._torque_off_code = torque_off_code
        self._following_error_code = following_error_code
        self._enabled = False
        self._quick_stop = False
        self._fault = 0
        self._echo = 0
        self._homing = False
        self._homing_deadline_s = math.inf  # deadline of the watchdog

    @property
    def held(self) -> bool:
        """Whether the axis brakes or holds, regardless of setpoints."""
        return not self._enabled or self._quick_stop or self._fault != 0

    def trip(self, fault: int) -> None:
        """Enter fault ``fault`` and brake."""
        self._fault = fault
        self._axes.brake(self._index)

    def command(self, command: Command, now_s: float) -> None:
        """Execute a command of the controller."""
        self._axes.advance(now_s)
        self._echo = command.number
        self._enabled = bool(command.control & ControlFlags.ENABLE)
        if self._enabled:
            self._axes.enable(self._index)
        else:
            self._axes.disable(self._index)
            self._quick_stop = False
            if command.control & ControlFlags.FAULT_RESET:
                self._fault = 0
                self._axes.astray[self._index] = False
        if command.control & ControlFlags.QUICK_STOP:
            self._quick_stop = True
        self._supervise_chain()
        was_homing, self._homing = self._homing, bool(command.control & ControlFlags.HOME) and not self.held
        self._homing_deadline_s = now_s + WATCHDOG_S
        if self.held or (was_homing and not self._homing and self._under_way):
            self._axes.brake(self._index)
        elif self._homing:
            if not was_homing:
                self._axes.home(self._index)
        else:
            self._axes.follow(self._index, command.position_m, command.rate_mps, now_s)

    def supervise(self, now_s: float) -> None:
        """Make a quick stop if commands have ceased; enter the torque-off fault if the chain is open."""
        self._supervise_chain()
        silent = self._under_way and now_s > self._homing_deadline_s
        if self._axes.overdue[self._index] or silent:
            self._axes.overdue[self._index] = False
            self._quick_stop = True
            self._axes.brake(self._index)

    def state(self, now_s: float) -> State:
        """Return the state that the drive reports."""
        self._axes.advance(now_s)
        self.supervise(now_s)
        axes, i = self._axes, self._index
        flags = {
            Status.READY: self._fault == 0,
            Status.FAULT: self._fault != 0,
            Status.ENABLED: self._enabled and self._fault == 0,
            Status.MOVING: axes.moving(i),
            Status.QUICK_STOP: self._quick_stop,
            Status.LIMIT: axes.limit(i) != 0,
            Status.LIMIT_LOW: axes.limit(i) < 0,
            Status.LIMIT_HIGH: axes.limit(i) > 0,
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
        if self._axes.astray[self._index] and self._fault == 0:
            self.trip(self._following_error_code)


class DriveAccess:
    """Access of the Modbus registers to one drive."""

    def __init__(self, drive: EmulatedRailDrive, register_map: RegisterMap, clock: BenchClock) -> None:
        self.map = register_map
        self._drive = drive
        self._clock = clock

    async def on_access(
        self, function: int, start: int, address: int, count: int, *content: list[int] | Sequence[int] | None
    ) -> ExcCodes | None:
        """Execute a write, or update the state block before it is read (called by pymodbus).

        content: registers of the device from ``start``, and the values to be written, None for a read.
        """
        registers, values = content
        assert isinstance(registers, list)
        if function == READ_WRITE and READ_WRITE not in self.map.functions:
            return ExcCodes.ILLEGAL_FUNCTION
        if values is None:
            state = self.map.state
            encoded = self.map.encode_state(self._drive.state(self._clock.now_s()))
            registers[state.address - start : state.address - start + state.count] = encoded
            return None
        block = self.map.command
        written = registers[block.address - start : block.address - start + block.count]
        written[address - block.address : address - block.address + count] = [int(value) for value in values]
        try:
            command = self.map.decode_command(written)
        except ValueError:
            return ExcCodes.ILLEGAL_VALUE
        self._drive.command(command, self._clock.now_s())
        return None

    def device(self, device_id: int, identity: list[int]) -> SimDevice:
        """Return the register file of the drive."""
        command, state = self.map.command, self.map.state
        blocks = [
            (command.address, [0] * command.count, False),
            (state.address, [0] * state.count, True),
            (self.map.identity.address, identity, True),
        ]
        simdata = [
            SimData(address, values=values, datatype=DataType.REGISTERS, readonly=readonly)
            for address, values, readonly in sorted(blocks)
        ]
        return SimDevice(id=device_id, simdata=simdata, action=self.on_access)


class ModbusServer:
    """Server of the drives on one wire. Responds as pymodbus does; ignores other device ids.

    drives: by device id. identity: registers of the identity block.
    """

    def __init__(self, drives: dict[int, DriveAccess], identity: list[int], tcp: bool) -> None:
        self._device_ids = set(drives)
        self._core = SimCore([drive.device(device_id, identity) for device_id, drive in drives.items()])
        decoder = DecodePDU(True)
        self._framer: FramerBase = FramerSocket(decoder) if tcp else FramerRTU(decoder)

    def feed(self, data: bytes) -> tuple[int, list[bytes]]:
        """Return the number of bytes consumed and the responses to the requests in them."""
        used = 0
        responses: list[bytes] = []
        while used < len(data):
            try:
                taken, request = self._framer.handleFrame(data[used:], 0, 0)
            except (ModbusException, IndexError):
                return len(data), responses
            used += taken
            if request is None:
                break
            if request.dev_id in self._device_ids:
                responses.append(self._framer.buildFrame(self._respond(request)))
        return used, responses

    def _respond(self, request: ModbusPDU) -> ModbusPDU:
        try:
            response = _result(request.datastore_update(self._core, request.dev_id))  # type: ignore[arg-type]
        except (ModbusException, ValueError):
            response = ExceptionResponse(request.function_code, ExcCodes.DEVICE_FAILURE)
        response.transaction_id, response.dev_id = request.transaction_id, request.dev_id
        return response


def _result(step: Coroutine[Any, Any, ModbusPDU]) -> ModbusPDU:
    """Return the result of a coroutine that does not suspend."""
    try:
        step.send(None)
    except StopIteration as end:
        response: ModbusPDU = end.value
        return response
    step.close()
    raise asyncio.InvalidStateError("access to the registers was suspended")
