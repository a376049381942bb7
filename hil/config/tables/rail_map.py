"""Register map of the rail drives as a rig file may give it: ``[rails.map]``.

Each number has its holding register, the way it is written, and what one count means. The defaults are the
map of the emulated drives; a rig file names what is different in its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Final, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from hil.config.tables.model import ConfigModel, Positive

NumberType = Literal["u16", "i16", "u32", "i32", "f32", "f64"]
Unit = Literal["m", "mm", "um", "m/s", "mm/s", "um/s"]

WORDS: Final[dict[NumberType, int]] = {"u16": 1, "i16": 1, "u32": 2, "i32": 2, "f32": 2, "f64": 4}
READ_MAX: Final = 125  # registers that function 23 reads at most
WRITE_MAX: Final = 121  # registers that it writes at most
FUNCTIONS: Final = ((23,), (16, 3), (6, 3))
"""Functions that may carry an exchange: of writing, of reading; 23 does both."""
_PER_SI: Final[dict[str, float]] = {"m": 1.0, "mm": 1e3, "um": 1e6}

Address = Annotated[int, Field(ge=0, le=65535)]
Bit = Annotated[int, Field(ge=-1, le=31)]  # -1: the drive has no such bit
FaultCode = Annotated[str, StringConstraints(pattern=r"^(0x[0-9a-fA-F]{1,8}|[0-9]{1,10})$")]


class WordRegister(ConfigModel):
    """A word of bits, a code or a counter."""

    address: Address
    """Holding register, counted from 0 (40001 in many manuals is 0)."""
    type: Literal["u16", "u32"] = "u16"
    """Type of the number."""


class CounterRegister(WordRegister):
    """One register that counts to 65535 and starts again at 0."""

    type: Literal["u16"] = "u16"
    """Type of the number."""


class PositionRegister(ConfigModel):
    """A length: ``scale`` units to one count."""

    address: Address
    """Holding register, counted from 0."""
    type: NumberType = "i32"
    """Type of the number; the high word first unless `word_order` is "little"."""
    unit: Literal["m", "mm", "um"] = "um"
    """Unit of a position."""
    scale: Positive = 1.0
    """Units per count."""


class RateRegister(ConfigModel):
    """A speed: ``scale`` units to one count."""

    address: Address
    """Holding register, counted from 0."""
    type: NumberType = "i32"
    """Type of the number."""
    unit: Literal["m/s", "mm/s", "um/s"] = "um/s"
    """Unit of a speed."""
    scale: Positive = 1.0
    """Units per count."""


AnyRegister = WordRegister | PositionRegister | RateRegister


def counts_per_si(register: AnyRegister) -> float:
    """Return the counts to one m or m/s; 1 for a word."""
    if isinstance(register, WordRegister):
        return 1.0
    return _PER_SI[register.unit.removesuffix("/s")] / register.scale


class _Block(ConfigModel):
    """Registers that travel in one transaction."""

    def registers(self) -> dict[str, AnyRegister]:
        """Return the numbers of the block by name."""
        return {name: getattr(self, name) for name in type(self).model_fields}


class CommandBlock(_Block):
    """What is written in every exchange; its registers follow one another without a gap."""

    control: WordRegister = WordRegister(address=0)
    """Word of the control bits."""
    number: CounterRegister = CounterRegister(address=1)
    """Number of the exchange, which the drive echoes."""
    position: PositionRegister = PositionRegister(address=2)
    """Setpoint."""
    rate: RateRegister = RateRegister(address=4)
    """Velocity feed-forward."""


class StateBlock(_Block):
    """What is read in every exchange; registers between its numbers are read and ignored."""

    status: WordRegister = WordRegister(address=16)
    """Word of the status bits."""
    fault: WordRegister = WordRegister(address=17)
    """Fault code."""
    echo: CounterRegister = CounterRegister(address=18)
    """Number of the last accepted exchange."""
    position: PositionRegister = PositionRegister(address=19)
    """Measured position."""
    rate: RateRegister = RateRegister(address=21)
    """Measured rate."""


class IdentityBlock(_Block):
    """What is read when the drive is opened; version: major * 256 + minor."""

    vendor: WordRegister = WordRegister(address=32, type="u32")
    """Identity of the vendor."""
    version: WordRegister = WordRegister(address=34)
    """Firmware, major * 256 + minor."""


class ControlBits(ConfigModel):
    """Bits of the control word."""

    enable: Bit = 0
    """Bit that enables the drive."""
    quick_stop: Bit = 1
    """Bit that stops it."""
    home: Bit = 2
    """Bit that starts homing; -1 if the drive has none."""
    fault_reset: Bit = 7
    """Bit that clears faults; -1 if the drive has none."""


class RailStatusBits(ConfigModel):
    """Bits of the status word."""

    ready: Bit = 0
    """Ready."""
    enabled: Bit = 1
    """Enabled."""
    moving: Bit = 2
    """In motion; while homing: searching."""
    fault: Bit = 3
    """Fault."""
    quick_stop: Bit = 4
    """Quick stop active."""
    limit: Bit = 5
    """Limit switch, the nearer one if the drive does not report which."""
    homed: Bit = 6
    """Position reference valid."""
    homing_failed: Bit = 7
    """Homing failed."""
    limit_low: Bit = 8
    """Lower limit switch."""
    limit_high: Bit = 9
    """Upper limit switch."""


TORQUE_OFF_CODE: Final = 7  # these unless set; a list of faults without them has no such fault
FOLLOWING_ERROR_CODE: Final = 1

FAULT_TEXTS: Final = {
    "1": "following error too large",
    "2": "over-current",
    "3": "motor too hot",
    "4": "encoder signal lost",
    "5": "supply voltage out of range",
    "6": "brake does not open",
    "7": "safe torque off",
}


class RailMap(ConfigModel):
    """Where a rail drive keeps its numbers, and which drive it is."""

    word_order: Literal["big", "little"] = "big"
    """Order of the words of a number in several registers: high or low word first."""
    functions: tuple[int, ...] = (23,)
    """Modbus functions of an exchange: `[23]` writes and reads in one transaction, `[16, 3]` writes the command block
    and reads the state in two, `[6, 3]` writes register by register, the control word last."""
    numbered: bool = True
    """Whether the drive echoes the number of each exchange. If not, a serial line has no retry after a time-out."""
    vendor: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = 0x48494C52
    """Expected vendor."""
    firmware_min: tuple[Annotated[int, Field(ge=0, le=255)], Annotated[int, Field(ge=0, le=255)]] = (1, 0)
    """Oldest accepted firmware, major and minor; another major number is rejected."""
    command: CommandBlock = CommandBlock.model_construct()
    """Numbers written in each exchange."""
    state: StateBlock = StateBlock.model_construct()
    """Numbers read in each exchange."""
    identity: IdentityBlock = IdentityBlock.model_construct()
    """Numbers read when the bench is opened."""
    control_bits: ControlBits = ControlBits.model_construct()
    """Bits of the control word."""
    status_bits: RailStatusBits = RailStatusBits.model_construct()
    """Bits of the status word."""
    faults: Mapping[FaultCode, str] = FAULT_TEXTS
    """Fault codes, decimal or 0x hexadecimal, and their names (free text)."""
    torque_off: Annotated[int, Field(ge=-1, le=0xFFFF_FFFF)] = TORQUE_OFF_CODE
    """Code of safe torque off; -1 if the drive has none. After it the bench waits for the cause, such as the emergency
    stop, and reports that first."""
    following_error: Annotated[int, Field(ge=-1, le=0xFFFF_FFFF)] = FOLLOWING_ERROR_CODE
    """Code of a following error, after which the drive has no torque; -1 if the drive has none."""

    @property
    def homes(self) -> bool:
        """Whether the drives have a homing command and report its result."""
        return self.control_bits.home >= 0 and self.status_bits.homed >= 0

    def blocks(self) -> dict[str, dict[str, AnyRegister]]:
        """Return the numbers of each block by name, without unnumbered exchanges."""
        unused = () if self.numbered else ("number", "echo")
        return {
            name: {key: register for key, register in block.registers().items() if key not in unused}
            for name, block in (("command", self.command), ("state", self.state), ("identity", self.identity))
        }

    @model_validator(mode="after")
    def _modbus_can_carry_it(self) -> Self:
        taken: dict[int, str] = {}
        for name, registers in self.blocks().items():
            for key, register in registers.items():
                _take(taken, register, f"{name}.{key}")
        for name, registers in self.blocks().items():
            extent = span(registers.values())
            most = WRITE_MAX if name == "command" else READ_MAX
            if len(extent) > most:
                raise ValueError(f"{name}: {len(extent)} registers in one transaction, allowed 1 to {most}")
            for word in extent:
                owner = taken.get(word)
                if owner is None and name == "command":
                    raise ValueError(f"{name}: register {word} would be written and is no number, allowed: no gap")
                if owner is not None and not owner.startswith(f"{name}."):
                    raise ValueError(f"{name}: register {word} in its midst is {owner}, allowed: its own numbers")
        return self

    @model_validator(mode="after")
    def _functions_carry_the_command(self) -> Self:
        if self.functions not in FUNCTIONS:
            allowed = ", ".join(str(list(each)) for each in FUNCTIONS)
            raise ValueError(f"functions {list(self.functions)}: allowed {allowed}")
        if self.functions[0] == 6:
            for key, register in self.blocks()["command"].items():
                if WORDS[register.type] > 1:
                    raise ValueError(
                        f"command.{key}.type {register.type}: function 6 writes one register at a time, a number in "
                        "several would be torn; allowed u16, i16"
                    )
        return self

    @model_validator(mode="after")
    def _bits_fit_their_words(self) -> Self:
        _check_bits("control_bits", self.control_bits, self.command.control, ("enable", "quick_stop"))
        _check_bits("status_bits", self.status_bits, self.state.status, ("enabled", "fault"))
        return self

    @model_validator(mode="after")
    def _codes_of_a_kind_are_faults(self) -> Self:
        codes = {int(code, 0) for code in self.faults}
        for key, code, default in (
            ("torque_off", self.torque_off, TORQUE_OFF_CODE),
            ("following_error", self.following_error, FOLLOWING_ERROR_CODE),
        ):
            if code not in {-1, default, *codes}:
                allowed = ", ".join([*self.faults, "-1"])
                raise ValueError(f"{key} {code}: no such code in faults, allowed: {allowed}")
        return self


def span(registers: Iterable[AnyRegister]) -> range:
    """Return the registers from the first to the last one of a block."""
    words = [_words(register) for register in registers]
    return range(min(each.start for each in words), max(each.stop for each in words))


def _words(register: AnyRegister) -> range:
    return range(register.address, register.address + WORDS[register.type])


def _take(taken: dict[int, str], register: AnyRegister, key: str) -> None:
    """Note whose the words of ``register`` are; refuse what is taken."""
    words = _words(register)
    if words.stop > 65536:
        raise ValueError(f"{key}.address {register.address}: {register.type} ends beyond 65535, the last register")
    for word in words:
        if word in taken:
            raise ValueError(
                f"{key}.address {register.address}: register {word} is {taken[word]}, allowed: registers of its own"
            )
        taken[word] = key


def _check_bits(table: str, bits: ConfigModel, word: WordRegister, needed: tuple[str, ...]) -> None:
    taken: dict[int, str] = {}
    highest = 16 * WORDS[word.type] - 1
    for name in type(bits).model_fields:
        bit: int = getattr(bits, name)
        if bit < 0 and name in needed:
            raise ValueError(f"{table}.{name} {bit}: the drive must have it, allowed 0 to {highest}")
        if bit > highest:
            raise ValueError(f"{table}.{name} {bit}: the word is {word.type}, allowed 0 to {highest}")
        if bit >= 0 and bit in taken:
            raise ValueError(f"{table}.{name} {bit}: this bit is {taken[bit]}, allowed: a bit of its own, or -1")
        taken[bit] = name


_LIMITS: Final[dict[str, tuple[float, float]]] = {
    "u16": (0.0, float(2**16 - 1)),
    "i16": (-float(2**15), float(2**15 - 1)),
    "u32": (0.0, float(2**32 - 1)),
    "i32": (-float(2**31), float(2**31 - 1)),
}


def range_of(register: AnyRegister) -> tuple[float, float]:
    """Return the least and the greatest value, m or m/s, that the register holds."""
    low, high = _LIMITS.get(register.type, (-1e9, 1e9))
    return low / counts_per_si(register), high / counts_per_si(register)
