"""Register map of a rail drive: numbers in SI on one side, Modbus holding registers on the other.

======= ======= ====== ========== ================================================================
address name    form   one count  meaning
======= ======= ====== ========== ================================================================
command block, written in every exchange
0       control u16    bits       0 enable, 1 quick stop, 7 fault reset (with enable clear)
1       number  u16    1          of the exchange; comes back as the echo
2-3     target  i32    1 um       setpoint of the position
4-5     rate    i32    1 um/s     velocity feed-forward
state block, read in every exchange
16      status  u16    bits       0 ready, 1 enabled, 2 moving, 3 fault, 4 quick stop active, 5 limit
17      fault   u16    1          fault code, 0 without a fault
18      echo    u16    1          number of the exchange that was taken last
19-20   place   i32    1 um       measured position
21-22   rate    i32    1 um/s     measured velocity
identity block, read at ``open``
32-33   vendor  u32    1          0x48494C52
34      version u16    1          of the firmware, major * 256 + minor
======= ======= ====== ========== ================================================================

Of a number in two registers the high word comes first. Quick stop stays active, whatever is written
after it, until a command with enable clear. Functions: 3 (read), 6 and 16 (write), 23 (write, then read).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Final, Literal

Form = Literal["u16", "i16", "u32", "i32", "f32", "f64"]

_STRUCT_CODES: Final[dict[Form, str]] = {"u16": "H", "i16": "h", "u32": "I", "i32": "i", "f32": "f", "f64": "d"}
_FLOATS: Final = ("f32", "f64")


class Control(IntFlag):
    """Bits of the control word."""

    ENABLE = 1 << 0
    QUICK_STOP = 1 << 1
    FAULT_RESET = 1 << 7


class Status(IntFlag):
    """Bits of the status word."""

    READY = 1 << 0
    ENABLED = 1 << 1
    MOVING = 1 << 2
    FAULT = 1 << 3
    QUICK_STOP = 1 << 4
    LIMIT = 1 << 5


FAULTS: Final = {
    1: "following error too large",
    2: "over-current",
    3: "motor too hot",
    4: "encoder signal lost",
    5: "supply voltage out of range",
    6: "brake does not open",
}


def fault_text(code: int) -> str:
    """Return a fault code as people read it: ``fault 3, motor too hot``."""
    return f"fault {code}, {FAULTS.get(code, 'not in the list of fault codes')}"


@dataclass(frozen=True, slots=True)
class Number:
    """One number of a block: its first register, how it is written, and counts to one SI unit."""

    address: int
    form: Form
    counts_per_unit: float = 1.0


class Block:
    """Numbers that lie one after the other and travel in one transaction."""

    def __init__(self, *numbers: Number) -> None:
        self.address = numbers[0].address
        self._numbers = numbers
        self._layout = struct.Struct(">" + "".join(_STRUCT_CODES[number.form] for number in numbers))
        self.count = self._layout.size // 2
        self._words = struct.Struct(f">{self.count}H")
        expected = self.address
        for number in numbers:
            if number.address != expected:
                raise ValueError(f"register {number.address} does not follow its neighbour, which ends at {expected}")
            expected += struct.calcsize(_STRUCT_CODES[number.form]) // 2

    def encode(self, values: Sequence[float]) -> list[int]:
        """Return the registers for ``values`` (SI, in the order of the numbers)."""
        counts = [
            value * number.counts_per_unit if number.form in _FLOATS else round(value * number.counts_per_unit)
            for number, value in zip(self._numbers, values, strict=True)
        ]
        try:
            return list(self._words.unpack(self._layout.pack(*counts)))
        except struct.error as error:
            raise ValueError(f"{tuple(values)} does not fit registers from {self.address}: {error}") from error

    def decode(self, registers: Sequence[int]) -> tuple[float, ...]:
        """Return the values (SI) in ``count`` registers; words without a unit stay whole numbers."""
        counts = self._layout.unpack(self._words.pack(*registers))
        return tuple(
            count if number.counts_per_unit == 1.0 else count / number.counts_per_unit
            for number, count in zip(self._numbers, counts, strict=True)
        )


@dataclass(frozen=True, slots=True)
class Command:
    """What the controller writes: control word, exchange number, position (m) and its rate (m/s)."""

    control: Control
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
class Identity:
    """What the drive is."""

    vendor: int
    firmware: tuple[int, int]


@dataclass(frozen=True, slots=True)
class RegisterMap:
    """Where a drive keeps its numbers, and which drive it is.

    command: control, number, position, rate. state: status, fault, echo, position, rate. identity:
    vendor, firmware version. Drives of another vendor or another major firmware version are refused.
    """

    command: Block
    state: Block
    identity: Block
    vendor: int
    firmware_major: int

    def encode_command(self, command: Command) -> list[int]:
        return self.command.encode((command.control, command.number, command.position_m, command.rate_mps))

    def decode_command(self, registers: Sequence[int]) -> Command:
        control, number, position, rate = self.command.decode(registers)
        return Command(Control(int(control)), int(number), position, rate)

    def encode_state(self, state: State) -> list[int]:
        return self.state.encode((state.status, state.fault, state.echo, state.position_m, state.rate_mps))

    def decode_state(self, registers: Sequence[int]) -> State:
        status, fault, echo, position, rate = self.state.decode(registers)
        return State(Status(int(status)), int(fault), int(echo), position, rate)

    def encode_identity(self, identity: Identity) -> list[int]:
        major, minor = identity.firmware
        return self.identity.encode((identity.vendor, major << 8 | minor))

    def decode_identity(self, registers: Sequence[int]) -> Identity:
        vendor, version = (int(value) for value in self.identity.decode(registers))
        return Identity(vendor, (version >> 8, version & 0xFF))

    def identity_problem(self, identity: Identity) -> str | None:
        """Return what is wrong with the drive's identity, None if nothing."""
        if identity.vendor != self.vendor:
            return f"vendor 0x{identity.vendor:08X}, expected 0x{self.vendor:08X}"
        if identity.firmware[0] != self.firmware_major:
            return f"firmware {identity.firmware[0]}.{identity.firmware[1]}, expected {self.firmware_major}.x"
        return None


_UM: Final = 1e6  # counts to one metre

DRIVE_MAP: Final = RegisterMap(
    command=Block(Number(0, "u16"), Number(1, "u16"), Number(2, "i32", _UM), Number(4, "i32", _UM)),
    state=Block(
        Number(16, "u16"), Number(17, "u16"), Number(18, "u16"), Number(19, "i32", _UM), Number(21, "i32", _UM)
    ),
    identity=Block(Number(32, "u32"), Number(34, "u16")),
    vendor=0x48494C52,
    firmware_major=1,
)
