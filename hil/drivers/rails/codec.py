"""Register map of a rail drive: numbers in SI on one side, Modbus holding registers on the other.

Registers and formats are those of ``hil.config.tables.rail_map``; a rig file may replace any of them. The default,
also of the emulated drives:

======= ======= ====== ========== ================================================================
address name    form   one count  meaning
======= ======= ====== ========== ================================================================
command block, written in every exchange
0       control u16    bits       0 enable, 1 quick stop, 2 look for the home switch (as long as it
                                  is set), 7 fault reset (with enable clear)
1       number  u16    1          of the exchange; comes back as the echo
2-3     target  i32    1 um       setpoint of the position
4-5     rate    i32    1 um/s     velocity feed-forward
state block, read in every exchange
16      status  u16    bits       0 ready, 1 enabled, 2 moving, 3 fault, 4 quick stop active, 5 limit,
                                  6 homed, 7 homing failed, 8 low limit, 9 high limit
17      fault   u16    1          fault code, 0 without a fault
18      echo    u16    1          number of the exchange that was taken last
19-20   place   i32    1 um       measured position
21-22   rate    i32    1 um/s     measured velocity
identity block, read at ``open``
32-33   vendor  u32    1          0x48494C52
34      version u16    1          of the firmware, major * 256 + minor
======= ======= ====== ========== ================================================================

Of a number in two registers the high word comes first. Quick stop stays active, whatever is written
after it, until a command with enable clear. Functions: 3 (read), 6 and 16 (write), 23 (write, then read);
``functions`` of the map determines which of them an exchange uses.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Final

from hil.config.tables.rail_map import WORDS, AnyRegister, NumberType, RailMap, counts_per_si, span
from hil.drivers.rails.frames import WRITE_ONE
from hil.errors import FaultKind

_STRUCT_CODES: Final[dict[NumberType, str]] = {"u16": "H", "i16": "h", "u32": "I", "i32": "i", "f32": "f", "f64": "d"}
_FLOATS: Final = ("f32", "f64")


class ControlFlags(IntFlag):
    """What the controller asks for. The bits on the wire are the map's."""

    ENABLE = 1 << 0
    QUICK_STOP = 1 << 1
    HOME = 1 << 2
    FAULT_RESET = 1 << 7


class Status(IntFlag):
    """Status bits of the drive. The map gives their positions on the wire."""

    READY = 1 << 0
    ENABLED = 1 << 1
    MOVING = 1 << 2
    FAULT = 1 << 3
    QUICK_STOP = 1 << 4
    LIMIT = 1 << 5
    HOMED = 1 << 6
    HOMING_FAILED = 1 << 7
    LIMIT_LOW = 1 << 8
    LIMIT_HIGH = 1 << 9


@dataclass(frozen=True, slots=True)
class Number:
    """One number of a block: its first register, how it is written, and counts to one SI unit."""

    address: int
    form: NumberType
    counts_per_unit: float = 1.0


class RegisterBlock:
    """Numbers that travel in one transaction; registers between them are spare. little: low word first."""

    def __init__(self, *numbers: Number, little: bool = False) -> None:
        self._numbers = numbers
        self.address = min(number.address for number in numbers)
        self.count = max(number.address + WORDS[number.form] for number in numbers) - self.address
        self._step = -1 if little else 1
        self._words = struct.Struct(f">{self.count}H")
        self._places = [
            (
                slice(number.address - self.address, number.address - self.address + WORDS[number.form]),
                struct.Struct(">" + _STRUCT_CODES[number.form]),
                struct.Struct(f">{WORDS[number.form]}H"),
            )
            for number in numbers
        ]

    def encode(self, values: Sequence[float]) -> list[int]:
        """Return the registers for ``values`` (SI, in the order of the numbers); ValueError where one does not fit."""
        registers = [0] * self.count
        for number, (offset, layout, words), value in zip(self._numbers, self._places, values, strict=True):
            count = value * number.counts_per_unit
            try:
                data = layout.pack(count if number.form in _FLOATS else round(count))
            except (struct.error, OverflowError, ValueError) as error:
                raise ValueError(f"{tuple(values)} does not fit registers from {self.address}: {error}") from error
            registers[offset] = words.unpack(data)[:: self._step]
        return registers

    def decode(self, registers: Sequence[int]) -> tuple[float, ...]:
        """Return the values (SI) in ``count`` registers; words without a unit stay whole numbers.

        Raises ValueError when the registers are too many, too few, or hold a number that is not finite.
        """
        if len(registers) != self.count:
            raise ValueError(f"{len(registers)} registers came, expected {self.count}")
        values = []
        for number, (offset, layout, words) in zip(self._numbers, self._places, strict=True):
            (count,) = layout.unpack(words.pack(*registers[offset][:: self._step]))
            if not math.isfinite(count):
                raise ValueError(f"register {number.address} holds {count}, expected a finite number")
            values.append(count if number.counts_per_unit == 1.0 else count / number.counts_per_unit)
        return tuple(values)


@dataclass(frozen=True, slots=True)
class Command:
    """What the controller writes: control word, exchange number, position (m) and its rate (m/s)."""

    control: ControlFlags
    number: int
    position_m: float
    rate_mps: float


@dataclass(frozen=True, slots=True)
class State:
    """What the drive reports: status word, fault code, echo, position (m) and velocity (m/s)."""

    status: Status
    fault: int
    echo: int
    position_m: float
    rate_mps: float


@dataclass(frozen=True, slots=True)
class DriveIdentity:
    """What the drive is."""

    vendor: int
    firmware: tuple[int, int]


class RegisterMap:
    """Where a drive keeps its numbers, and which drive it is.

    echo_at: place of the echo in the state block, None when the drive echoes no numbers; numbers: how many
    exchange numbers there are. Drives of another vendor, another major firmware version or an older minor
    one are refused.
    """

    def __init__(self, config: RailMap) -> None:
        self.config = config
        self.functions = config.functions
        blocks = config.blocks()
        self.command = self._block(blocks["command"])
        self.state = self._block(blocks["state"])
        self.identity = self._block(blocks["identity"])
        extent = span(blocks["state"].values())
        self.echo_at = config.state.echo.address - extent.start if config.numbered else None
        self.numbers = 1 << 16
        self._control_bits = _bits(ControlFlags, config.control_bits.model_dump())
        self._status_bits = _bits(Status, config.status_bits.model_dump())
        self._faults = {int(code, 0): text for code, text in config.faults.items()}

    def encode_command(self, command: Command) -> list[int]:
        number = (command.number,) if self.config.numbered else ()
        control = _to_wire(command.control, self._control_bits)
        return self.command.encode((control, *number, command.position_m, command.rate_mps))

    def writes(self, command: Command) -> list[tuple[int, list[int]]]:
        """Return the writes of ``command``, address and registers, in their order: with function 6 the control last."""
        registers, first = self.encode_command(command), self.command.address
        if self.functions[0] != WRITE_ONE:
            return [(first, registers)]
        control = self.config.command.control.address - first
        return [(first + at, [registers[at]]) for at in [*range(control), *range(control + 1, len(registers)), control]]

    def decode_command(self, registers: Sequence[int]) -> Command:
        control, *number, position, rate = self.command.decode(registers)
        return Command(
            ControlFlags(_from_wire(int(control), self._control_bits)), int(number[0]) if number else 0, position, rate
        )

    def encode_state(self, state: State) -> list[int]:
        echo = (state.echo,) if self.config.numbered else ()
        status = _to_wire(state.status, self._status_bits)
        return self.state.encode((status, state.fault, *echo, state.position_m, state.rate_mps))

    def decode_state(self, registers: Sequence[int]) -> State:
        status, fault, *echo, position, rate = self.state.decode(registers)
        return State(
            Status(_from_wire(int(status), self._status_bits)),
            int(fault),
            int(echo[0]) if echo else 0,
            position,
            rate,
        )

    def encode_identity(self, identity: DriveIdentity) -> list[int]:
        major, minor = identity.firmware
        return self.identity.encode((identity.vendor, major << 8 | minor))

    def decode_identity(self, registers: Sequence[int]) -> DriveIdentity:
        vendor, version = (int(value) for value in self.identity.decode(registers))
        return DriveIdentity(vendor, (version >> 8, version & 0xFF))

    def identity_problem(self, identity: DriveIdentity) -> str | None:
        """Return what is wrong with the drive's identity, None if nothing."""
        vendor, least = self.config.vendor, self.config.firmware_min
        if identity.vendor != vendor:
            return f"vendor 0x{identity.vendor:08X}, expected 0x{vendor:08X}"
        if identity.firmware[0] != least[0]:
            return f"firmware {identity.firmware[0]}.{identity.firmware[1]}, expected {least[0]}.x"
        if identity.firmware[1] < least[1]:
            return f"firmware {identity.firmware[0]}.{identity.firmware[1]}, expected {least[0]}.{least[1]} or newer"
        return None

    def fault_text(self, code: int) -> str:
        """Return a fault code as people read it: ``fault 3, motor too hot``."""
        return f"fault {code}, {self._faults.get(code, 'not in the list of fault codes')}"

    def fault_kind(self, code: int) -> FaultKind:
        """Return what a fault code means to the bench."""
        declared = code == self.config.torque_off and code in self._faults
        return FaultKind.TORQUE_OFF if declared else FaultKind.OTHER

    def code_of(self, kind: FaultKind) -> int:
        """Return the first code of that kind in the list; of another kind, or 1, where the list has none."""
        return next((code for code in self._faults if self.fault_kind(code) is kind), next(iter(self._faults), 1))

    def _block(self, registers: dict[str, AnyRegister]) -> RegisterBlock:
        numbers = (Number(each.address, each.type, counts_per_si(each)) for each in registers.values())
        return RegisterBlock(*numbers, little=self.config.word_order == "little")


def _bits(flags: type[ControlFlags] | type[Status], table: dict[str, int]) -> list[tuple[int, int]]:
    """Return (flag, bit on the wire) of every flag that the drive has."""
    return [(int(flags[name.upper()]), 1 << bit) for name, bit in table.items() if bit >= 0]


def _to_wire(flags: int, bits: list[tuple[int, int]]) -> int:
    return sum(wire for flag, wire in bits if flags & flag)


def _from_wire(word: int, bits: list[tuple[int, int]]) -> int:
    return sum(flag for flag, wire in bits if word & wire)
