"""Modbus codec of the I/O coupler: map of its lines, and responses of a coupler to requests.

========= =========================== ==============================================================
kind      address (rig file, [io])    meaning
========= =========================== ==============================================================
coil      coils.charge_pump           heartbeat: toggles while the watchdog process runs
coil      coils.enable                1 asks the safety relay to close; an edge is needed each time
coil      coils.thrusters_first + n   1 while thruster n is open
coil      coils.brakes_released       1 releases the holding brakes
coil      coils.warning               1 warns before the first motion
input     inputs.estop_closed         1 while the emergency stop is released
input     inputs.chain_closed         1 while the relay lets the drives have torque
input     inputs.brakes_closed        1 while all holding brakes are closed
input     inputs.local_enable         1 while the switch at the bench permits power and motion
input     interlocks.NAME             1 while this contact (door, fence, end switch) is closed
========= =========================== ==============================================================

Functions: 15 (write coils), 1 (read coils), 2 (read inputs), 5 (write one coil), 43/14 (identification).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from hil.config.tables.io import Io

MAX_READ: Final = 2000  # bits of one request
MAX_WRITE: Final = 1968


class Function(IntEnum):
    """Modbus functions of a coupler."""

    READ_COILS = 1
    READ_INPUTS = 2
    WRITE_COIL = 5
    WRITE_COILS = 15
    ENCAPSULATED = 43


class ModbusException(IntEnum):
    """Modbus exception codes."""

    FUNCTION = 1
    ADDRESS = 2
    VALUE = 3


class LineMap:
    """Addresses of coils and inputs. coils: charge pump, enable, thrusters, in this order, then brakes and warning.

    thrusters: addresses of the thrusters' coils. brakes, brakes_closed, warning, local_enable: of brakes and their
    contact, of the warning of motion and of the switch at the bench; None without.
    """

    def __init__(self, config: Io) -> None:
        first = config.coils.thrusters_first
        self.thrusters = range(first, first + config.thruster_lines)
        self.brakes = config.coils.brakes_released
        self.brakes_closed = config.inputs.brakes_closed
        self.local_enable = config.inputs.local_enable
        names = {config.coils.charge_pump: "charge pump", config.coils.enable: "enable"}
        names |= {address: f"thruster {n + 1}" for n, address in enumerate(self.thrusters)}
        if self.brakes is not None:
            names[self.brakes] = "brakes"
        self.warning = config.coils.warning
        if self.warning is not None:
            names[self.warning] = "warning"
        self.coils, self.coil_names = tuple(names), tuple(names.values())
        self.estop = config.inputs.estop_closed
        self.chain = config.inputs.chain_closed
        self.interlocks = dict(config.interlocks)
        inputs = [self.estop, self.chain, *self.interlocks.values()]
        inputs += [address for address in (self.brakes_closed, self.local_enable) if address is not None]
        self.inputs = tuple(sorted(inputs))
        self.coil_runs = runs(self.coils)
        self.input_runs = runs(self.inputs)


def runs(addresses: Iterable[int]) -> tuple[range, ...]:
    """Return the addresses, sorted, as ranges without gaps, one per request."""
    blocks: list[range] = []
    for address in sorted(addresses):
        if blocks and blocks[-1].stop == address and len(blocks[-1]) < MAX_WRITE:
            blocks[-1] = range(blocks[-1].start, address + 1)
        else:
            blocks.append(range(address, address + 1))
    return tuple(blocks)


@dataclass
class Image:
    """Memory of the coupler: coils and inputs by address, and its identification (objects 0, 1, 2)."""

    coils: dict[int, bool]
    inputs: dict[int, bool]
    identity: Sequence[str] = field(default=("", "", ""))


class _RefusedError(Exception):
    def __init__(self, code: ModbusException) -> None:
        super().__init__(code.name)
        self.code = code


def respond(image: Image, request: bytes) -> bytes:
    """Return the coupler's response (PDU) to a request (PDU, at least one byte); writes change ``image.coils``.

    Invalid requests get a Modbus exception; never raises.
    """
    try:
        return request[:1] + _execute(image, request[0], request[1:])
    except _RefusedError as refused:
        return bytes((request[0] | 0x80, refused.code))
    except struct.error:
        return bytes((request[0] | 0x80, ModbusException.VALUE))


def _execute(image: Image, function: int, body: bytes) -> bytes:
    if function in (Function.READ_COILS, Function.READ_INPUTS):
        memory = image.coils if function == Function.READ_COILS else image.inputs
        first, count = struct.unpack(">HH", body)
        bits = [memory[address] for address in _addresses(memory, first, count, MAX_READ)]
        packed = pack_bits(bits)
        return bytes((len(packed),)) + packed
    if function == Function.WRITE_COIL:
        first, value = struct.unpack(">HH", body)
        if value not in (0x0000, 0xFF00):
            raise _RefusedError(ModbusException.VALUE)
        for address in _addresses(image.coils, first, 1, 1):
            image.coils[address] = value != 0
        return body
    if function == Function.WRITE_COILS:
        first, count, size = struct.unpack_from(">HHB", body)
        addresses = _addresses(image.coils, first, count, MAX_WRITE)
        if size != (count + 7) // 8 or len(body) != 5 + size:
            raise _RefusedError(ModbusException.VALUE)
        image.coils.update(zip(addresses, unpack_bits(body[5:], count), strict=True))
        return body[:4]
    if function == Function.ENCAPSULATED:
        return _identification(image, body)
    raise _RefusedError(ModbusException.FUNCTION)


def _addresses(memory: dict[int, bool], first: int, count: int, most: int) -> range:
    if not 1 <= count <= most:
        raise _RefusedError(ModbusException.VALUE)
    addresses = range(first, first + count)
    if any(address not in memory for address in addresses):
        raise _RefusedError(ModbusException.ADDRESS)
    return addresses


def _identification(image: Image, body: bytes) -> bytes:
    """Return the response to function 43/14, basic identification as a stream: vendor, product code, revision."""
    kind, code, first = struct.unpack(">BBB", body)
    if kind != 14:
        raise _RefusedError(ModbusException.FUNCTION)
    if code != 1 or first > 2:
        raise _RefusedError(ModbusException.ADDRESS)
    objects = [(number, text.encode("ascii", "replace")[:80]) for number, text in enumerate(image.identity)][first:]
    head = bytes((14, 1, 1, 0, 0, len(objects)))
    return head + b"".join(bytes((number, len(text))) + text for number, text in objects)


def pack_bits(bits: Sequence[bool]) -> bytes:
    """Return bits as Modbus packs them: the first one is bit 0 of the first byte."""
    packed = bytearray((len(bits) + 7) // 8)
    for index, bit in enumerate(bits):
        packed[index // 8] |= bit << index % 8
    return bytes(packed)


def unpack_bits(data: bytes, count: int) -> list[bool]:
    """Return the first ``count`` bits."""
    return [bool(data[index // 8] >> index % 8 & 1) for index in range(count)]
