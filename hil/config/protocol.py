"""Protocol files: the command set of a turntable controller on a serial line, as data (docs/protocols.md)."""

from __future__ import annotations

import string
from typing import Annotated, Final, Literal, Self

from pydantic import Field, field_validator, model_validator

from hil.config.model import ConfigModel
from hil.config.rig import GIMBAL_NAMES

OF_AXIS: Final = ("position", "rate", "status", "fault")
OF_DEVICE: Final = ("model", "serial", "firmware", "ignore")
ACTIONS: Final = ("identify", "enable", "set", "hold", "quick_stop", "clear_faults", "status", "home")

Bit = Annotated[int, Field(ge=1, le=0xFFFF_FFFF)]
Digits = Annotated[int, Field(ge=1, le=8)]
Printable = Annotated[str, Field(pattern=r"^[ -~]*$")]
Names = dict[str, str]  # a number, decimal or 0x..., and what it means


def template_places(template: str) -> list[tuple[str, str]]:
    """Return (literal text, field after it) for each part of a template; ValueError where it is none."""
    try:
        parts = [(text, name, spec, conversion) for text, name, spec, conversion in string.Formatter().parse(template)]
    except ValueError as error:
        raise ValueError(f"{template!r}: {error}") from error
    if not template.isascii() or not template.isprintable():
        raise ValueError(f"{template!r}: must be printable ASCII characters")
    if any(spec or conversion or name == "" for _, name, spec, conversion in parts):
        raise ValueError(f"{template!r}: a field is a name in braces and nothing more")
    return [(text, name or "") for text, name, _, _ in parts]


class LineFraming(ConfigModel):
    """What a line begins and ends with. Requests go to the controller, replies come from it."""

    request_start: Printable = ""
    request_end: Annotated[str, Field(min_length=1)] = "\r\n"
    reply_start: Printable = ""
    reply_end: Annotated[str, Field(min_length=1)] = "\r\n"
    longest_bytes: Annotated[int, Field(ge=16, le=4096)] = 256


class SequenceNumber(ConfigModel):
    """Hexadecimal number in front of the body that the reply repeats."""

    digits: Annotated[int, Field(ge=1, le=4)] = 2
    separator: Printable = " "


class Checksum(ConfigModel):
    """Hexadecimal, behind the body; over sequence number and body, and what is said to be covered besides."""

    kind: Literal["none", "sum8", "xor8", "crc16-ccitt"] = "none"
    separator: Printable = "*"
    covers_start: bool = False
    covers_separator: bool = False


class Angle(ConfigModel):
    """How a position is written."""

    unit: Literal["deg", "mdeg", "arcsec", "counts"]
    decimals: Annotated[int, Field(ge=0, le=9)] = 0


class AngularRate(ConfigModel):
    """How a rate is written."""

    unit: Literal["degps", "mdegps", "arcsecps", "countsps"]
    decimals: Annotated[int, Field(ge=0, le=9)] = 0


class NonNegativeInt(ConfigModel):
    """How a whole number is written. digits: exactly so many, with leading zeros; None: as many as it takes."""

    base: Literal[10, 16] = 10
    digits: Digits | None = None


class Fields(ConfigModel):
    position: Angle
    rate: AngularRate
    status: NonNegativeInt = NonNegativeInt()
    fault: NonNegativeInt = NonNegativeInt()
    error: NonNegativeInt = NonNegativeInt()


class Step(ConfigModel):
    """One line out and one line in. each_axis: once for every axis, ``{axis}`` being its name on the wire."""

    send: str
    reply: str
    each_axis: bool = False

    @field_validator("send")
    @classmethod
    def _is_a_template(cls, value: str) -> str:
        template_places(value)
        return value


Steps = tuple[Step, ...]
SomeSteps = Annotated[Steps, Field(min_length=1)]


class RequestSteps(ConfigModel):
    """What each action sends. An action of several lines sends them in this order."""

    identify: Steps = ()
    enable: SomeSteps  # setpoint := where the axes stand
    set: SomeSteps  # positions and rates
    hold: Steps = ()
    quick_stop: SomeSteps
    clear_faults: Steps = ()
    status: SomeSteps
    home: Steps = ()


class ErrorReply(ConfigModel):
    """How the controller refuses; ``{error}`` is the number that ``names`` explain."""

    reply: str
    names: Names = Field(default_factory=dict)


class AxisStatusBits(ConfigModel):
    """Which bit of an axis' status says what. A bit that the controller does not have is left away."""

    enabled: Bit
    fault: Bit
    quick_stopped: Bit | None = None
    moving: Bit | None = None
    homed: Bit | None = None
    not_homed: Bit | None = None
    homing: Bit | None = None
    homing_failed: Bit | None = None
    limit_low: Bit | None = None
    limit_high: Bit | None = None


class FaultNames(ConfigModel):
    """What an axis' fault number means. flags: each bit is a fault; code: the number is one.

    torque_off: the one of ``names`` that says that the safety chain has taken the torque; None: there is none.
    """

    kind: Literal["flags", "code"] = "code"
    torque_off: Annotated[int, Field(ge=1, le=0xFFFF_FFFF)] | None = None
    names: Names = Field(default_factory=dict)


class EmulatorWords(ConfigModel):
    """What the emulated controller says where a real one has its own words."""

    model: str = "EMULATED-3AX"
    serial: str = "0001"
    firmware: str = "1.0"
    command_timeout: int = 1  # fault numbers
    drive_fault: int = 4  # one that is switched on without a number
    unknown: int = 1  # error numbers
    arguments: int = 2
    refused: int = 3


class Protocol(ConfigModel):
    """One command set."""

    name: str
    axes: tuple[str, str, str] = ("1", "2", "3")  # names of roll, pitch, yaw where a line has {axis}
    counts_per_turn: Annotated[int, Field(gt=0, le=1_000_000_000)] | None = None
    line: LineFraming = LineFraming()
    sequence: SequenceNumber | None = None
    checksum: Checksum = Checksum()
    fields: Fields
    requests: RequestSteps
    replies: Names
    errors: ErrorReply | None = None
    status: AxisStatusBits
    faults: FaultNames = FaultNames()
    emulator: EmulatorWords = EmulatorWords()

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Self:
        if len(set(self.axes)) != 3:
            raise ValueError(f"axes: {list(self.axes)}: must be three different names")
        units = (self.fields.position.unit, self.fields.rate.unit)
        if any(unit.startswith("counts") for unit in units) and self.counts_per_turn is None:
            raise ValueError(f"counts_per_turn: is missing: fields are in {' and '.join(units)}")
        for key, names in (("faults.names", self.faults.names), ("errors.names", self.error_names)):
            numbers(key, names)
        torque_off, names = self.faults.torque_off, self.faults.names
        if torque_off is not None and torque_off not in numbers("faults.names", names):
            raise ValueError(
                f"faults.torque_off: {torque_off}: allowed are the numbers in [faults.names]: {_listed(names)}"
            )
        for name, text in self.replies.items():
            _check_template(f"replies.{name}", text, [*_axis_fields(True), *OF_DEVICE])
        if self.errors is not None:
            _check_template("errors.reply", self.errors.reply, ["error", "ignore"])
        for action, step in self.steps():
            self._check_step(action, step)
        self._check_report()
        self._check_homing()
        return self

    @property
    def error_names(self) -> Names:
        return {} if self.errors is None else self.errors.names

    def steps(self) -> list[tuple[str, Step]]:
        """Return every line that can be sent, with the action it belongs to."""
        return [(action, step) for action in ACTIONS for step in getattr(self.requests, action)]

    def gives(self, action: str) -> set[tuple[str, str]]:
        """Return (field, axis name) of everything that the replies to an action tell."""
        found = set()
        for step in getattr(self.requests, action):
            for _, place in template_places(self.replies[step.reply]):
                name, _, axis = place.partition(".")
                found |= {(name, each) for each in ((axis,) if axis else GIMBAL_NAMES)}
        return found

    def warnings(self) -> list[str]:
        """Return a line for each protection that this command set goes without."""
        found = []
        if self.sequence is None:
            found.append(f"protocol {self.name}: no sequence number: a late answer can pass for a new one")
        if self.checksum.kind == "none":
            found.append(f"protocol {self.name}: no checksum: a spoilt line can pass for a good one")
        return found

    def _check_step(self, action: str, step: Step) -> None:
        key = f"requests.{action}"
        setpoints = [name for name in _axis_fields(step.each_axis) if name.split(".")[0] in ("position", "rate")]
        allowed = [*(["axis"] if step.each_axis else []), *(setpoints if action == "set" else [])]
        _check_template(f"{key}: send", step.send, allowed)
        if step.reply not in self.replies:
            raise ValueError(
                f"{key}: reply {step.reply!r}: allowed are the names in [replies]: {_listed(self.replies)}"
            )
        _check_template(f"replies.{step.reply}", self.replies[step.reply], [*_axis_fields(step.each_axis), *OF_DEVICE])

    def _check_report(self) -> None:
        told, sent = self.gives("status"), set()
        for step in self.requests.set:
            for _, place in template_places(step.send):
                name, _, axis = place.partition(".")
                sent |= {(name, each) for each in ((axis,) if axis else GIMBAL_NAMES)}
        for axis in GIMBAL_NAMES:
            if ("position", axis) not in sent:
                raise ValueError(f"requests.set: sends no position of {axis}")
            for name in ("position", "status"):
                if (name, axis) not in told:
                    raise ValueError(f"requests.status: the replies tell no {name} of {axis}")

    def _check_homing(self) -> None:
        bits = self.status
        if bits.homed is not None and bits.not_homed is not None:
            raise ValueError("status: homed and not_homed say the same thing: give one of them")
        if self.requests.home and (bits.homing is None or (bits.homed is None and bits.not_homed is None)):
            raise ValueError("requests.home: needs status.homing, and status.homed or status.not_homed")


def numbers(key: str, names: Names) -> dict[int, str]:
    """Return names by their numbers; ValueError, beginning with ``key``, where one is no number."""
    try:
        return {int(number, 0): name for number, name in names.items()}
    except ValueError as error:
        raise ValueError(f"{key}: {_listed(names)}: must be whole numbers, decimal or 0x...") from error


def _axis_fields(each_axis: bool) -> list[str]:
    """Return the fields of axes that a template may have."""
    named = [f"{name}.{axis}" for name in OF_AXIS for axis in GIMBAL_NAMES]
    return [*named, "axis", *OF_AXIS] if each_axis else named


def _check_template(key: str, text: str, allowed: list[str]) -> None:
    try:
        places = template_places(text)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error
    for _, name in places:
        if name and name not in allowed:
            known = ", ".join(f"{{{field}}}" for field in allowed) or "none"
            raise ValueError(f"{key}: {{{name}}}: unknown field here, allowed: {known}")


def _listed(names: Names) -> str:
    return ", ".join(names)
