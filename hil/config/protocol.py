"""Protocol files: command set of a turntable controller on a serial line (docs/reference/wire-formats.md)."""

from __future__ import annotations

import string
from typing import Annotated, Final, Literal, Self

from pydantic import Field, field_validator, model_validator

from hil.config.rig import GIMBAL_NAMES
from hil.config.tables.model import ConfigModel

OF_AXIS: Final = ("position", "rate", "status", "fault")
OF_DEVICE: Final = ("model", "serial", "firmware", "ignore")
ACTIONS: Final = ("identify", "enable", "set", "hold", "quick_stop", "clear_faults", "status", "home")

Bit = Annotated[int, Field(ge=1, le=0xFFFF_FFFF)]
Digits = Annotated[int, Field(ge=1, le=8)]
Printable = Annotated[str, Field(pattern=r"^[ -~]*$")]
StatusName = Literal[
    "enabled", "fault", "quick_stopped", "moving", "homed", "not_homed", "homing", "homing_failed", "limit_low",
    "limit_high",
]  # fmt: skip
Names = dict[str, str]  # number, decimal or 0x..., and its meaning


def template_places(template: str) -> list[tuple[str, str]]:
    """Return (literal text, following field) for each part of a template; ValueError if it is invalid."""
    try:
        parts = [(text, name, spec, conversion) for text, name, spec, conversion in string.Formatter().parse(template)]
    except ValueError as error:
        raise ValueError(f"{template!r}: {error}") from error
    if not template.isascii() or not template.isprintable():
        raise ValueError(f"{template!r}: must be printable ASCII characters")
    if any(spec or conversion or name == "" for _, name, spec, conversion in parts):
        raise ValueError(f"{template!r}: a field is a name in braces without format")
    return [(text, name or "") for text, name, _, _ in parts]


class LineFraming(ConfigModel):
    """Start and end of a line. Requests go to the controller, replies come from it."""

    request_start: Printable = ""
    """Characters before a request."""
    request_end: Annotated[str, Field(min_length=1)] = "\r\n"
    """Characters after it."""
    reply_start: Printable = ""
    """Characters before a reply."""
    reply_end: Annotated[str, Field(min_length=1)] = "\r\n"
    """Characters after it."""
    echo: bool = False
    """The controller repeats each request before its reply."""
    longest_bytes: Annotated[int, Field(ge=16, le=4096)] = 256
    """Longest line."""


class SequenceNumber(ConfigModel):
    """Hexadecimal number before the body, repeated in the reply."""

    digits: Annotated[int, Field(ge=1, le=4)] = 2
    """Hexadecimal digits."""
    separator: Printable = " "
    """Characters between number and body."""


class Checksum(ConfigModel):
    """Hexadecimal, after the body; covers sequence number and body, and start and separator if set."""

    kind: Literal["none", "sum8", "xor8", "crc16-ccitt"] = "none"
    """Algorithm."""
    separator: Printable = "*"
    """Characters before its hexadecimal digits."""
    covers_start: bool = False
    """Also covers the start characters."""
    covers_separator: bool = False
    """Also covers the separator."""


class Angle(ConfigModel):
    """Format of a position."""

    unit: Literal["deg", "mdeg", "arcsec", "counts"]
    """Unit."""
    decimals: Annotated[int, Field(ge=0, le=9)] = 0
    """Decimals in requests."""


class AngularRate(ConfigModel):
    """Format of a rate."""

    unit: Literal["degps", "mdegps", "arcsecps", "countsps"]
    """Unit."""
    decimals: Annotated[int, Field(ge=0, le=9)] = 0
    """Decimals in requests."""


class NonNegativeInt(ConfigModel):
    """Format of an integer. digits: fixed number with leading zeros; None: as many as needed."""

    base: Literal[10, 16] = 10
    """Decimal or hexadecimal."""
    digits: Digits | None = None
    """Fixed number of digits; unless set, as many as needed."""


class Fields(ConfigModel):
    """Formats of the numbers in a line."""

    position: Angle
    rate: AngularRate
    status: NonNegativeInt = NonNegativeInt()
    fault: NonNegativeInt = NonNegativeInt()
    error: NonNegativeInt = NonNegativeInt()


class Step(ConfigModel):
    """One request and its reply. each_axis: once per axis, ``{axis}`` is its name on the wire."""

    send: str
    """Template of the request."""
    reply: str = ""
    """Name of the reply in `[replies]`; unless set, the controller does not reply."""
    each_axis: bool = False
    """Send once per axis."""

    @field_validator("send")
    @classmethod
    def _is_a_template(cls, value: str) -> str:
        template_places(value)
        return value


Steps = tuple[Step, ...]
SomeSteps = Annotated[Steps, Field(min_length=1)]


class RequestSteps(ConfigModel):
    """Requests of each action, sent in this order."""

    identify: Steps = ()
    """Read the identity."""
    enable: SomeSteps
    """Enable at the present position."""
    set: SomeSteps
    """Send positions and rates."""
    hold: Steps = ()
    """Hold the position."""
    quick_stop: SomeSteps
    """Stop the axes."""
    clear_faults: Steps = ()
    """Clear faults."""
    status: SomeSteps
    """Read positions and status."""
    home: Steps = ()
    """Start homing."""


class ErrorReply(ConfigModel):
    """Error reply of the controller; ``{error}`` is the number that ``names`` explain."""

    reply: str
    """Template of an error reply, with `{error}`."""
    names: Names = Field(default_factory=dict)
    """Names of error numbers."""


class AxisStatusBits(ConfigModel):
    """Meaning of the status bits of an axis. Bits that the controller does not have are omitted."""

    enabled: Bit
    """Enabled."""
    fault: Bit | None = None
    """Fault; omitted if `status` reads the fault number."""
    quick_stopped: Bit | None = None
    """Quick stop active."""
    moving: Bit | None = None
    """In motion."""
    homed: Bit | None = None
    """Position reference valid."""
    not_homed: Bit | None = None
    """Position reference missing."""
    homing: Bit | None = None
    """Homing in progress."""
    homing_failed: Bit | None = None
    """Homing failed."""
    limit_low: Bit | None = None
    """Lower limit switch."""
    limit_high: Bit | None = None
    """Upper limit switch."""


class FaultNames(ConfigModel):
    """Meaning of the fault number of an axis."""

    kind: Literal["flags", "code"] = "code"
    """Each bit is a fault, or the number is one."""
    torque_off: Annotated[int, Field(ge=1, le=0xFFFF_FFFF)] | None = None
    """Number of safe torque off: the bench then waits for the cause, such as the emergency stop. Unless set, the
    controller has no such fault."""
    following_error: Annotated[int, Field(ge=1, le=0xFFFF_FFFF)] | None = None
    """Number of a following error, after which the axis has no torque. Unless set, the controller has no such fault."""
    names: Names = Field(default_factory=dict)
    """Names of the numbers, free text."""


class EmulatorWords(ConfigModel):
    """Texts and numbers of the emulated controller."""

    model: str = "EMULATED-3AX"
    """Reported model."""
    serial: str = "0001"
    """Reported serial number."""
    firmware: str = "1.0"
    """Reported firmware."""
    command_timeout: int = 1
    """Fault number of a command time-out."""
    drive_fault: int = 4
    """Fault number of an injected fault without a number."""
    unknown: int = 1
    """Error number of an unknown command."""
    arguments: int = 2
    """Error number of wrong arguments."""
    refused: int = 3
    """Error number of a rejected command."""


class Protocol(ConfigModel):
    """One command set."""

    name: str
    """Name of the command set."""
    gimbals: Annotated[tuple[Literal["roll", "pitch", "yaw"], ...], Field(min_length=1)] = ("roll", "pitch", "yaw")
    """Axes of the controller, in this order."""
    axes: Annotated[tuple[str, ...], Field(min_length=1, max_length=3)] = ("1", "2", "3")
    """Their names for `{axis}`."""
    counts_per_turn: Annotated[int, Field(gt=0, le=1_000_000_000)] | None = None
    """Counts per revolution, if a unit is counts."""
    line: LineFraming = LineFraming()
    sequence: SequenceNumber | None = None
    checksum: Checksum = Checksum()
    fields: Fields
    requests: RequestSteps
    replies: Names
    """Template of each reply by name. Those to `status` must contain position and status of each axis; a missing rate
    is computed from positions. If those to `set` contain the same, `status` is not requested in each cycle."""
    errors: ErrorReply | None = None
    status: AxisStatusBits | None = None
    """Bits of the status; omitted with `status_words`."""
    status_words: dict[str, tuple[StatusName, ...]] = Field(default_factory=dict)
    """Meaning of each text, of a controller that reports its status as text: names of keys of `[status]`."""
    faults: FaultNames = FaultNames()
    emulator: EmulatorWords = EmulatorWords()

    @property
    def bits(self) -> AxisStatusBits:
        """Status bits, of the file or of its words."""
        meanings = dict.fromkeys(name for each in self.status_words.values() for name in each)
        return self.status or AxisStatusBits.model_validate({name: 1 << k for k, name in enumerate(meanings)})

    @model_validator(mode="after")
    def _parts_fit_together(self) -> Self:
        if (self.status is None) != bool(self.status_words):
            raise ValueError("status: give either [status] or [status_words]")
        if self.status is None and not {"enabled", "fault"} <= {
            name for each in self.status_words.values() for name in each
        }:
            raise ValueError("status_words: no word means enabled, or none fault, allowed: both")
        if self.gimbals != tuple(name for name in GIMBAL_NAMES if name in self.gimbals):
            raise ValueError(f"gimbals: {list(self.gimbals)}: must be some of {', '.join(GIMBAL_NAMES)}, in this order")
        if len(set(self.axes)) != len(self.axes) or len(self.axes) < len(self.gimbals):
            raise ValueError(f"axes: {list(self.axes)}: must be different names, one for each of gimbals")
        units = (self.fields.position.unit, self.fields.rate.unit)
        if any(unit.startswith("counts") for unit in units) and self.counts_per_turn is None:
            raise ValueError(f"counts_per_turn: is missing: fields are in {' and '.join(units)}")
        for key, names in (("faults.names", self.faults.names), ("errors.names", self.error_names)):
            numbers(key, names)
        names = self.faults.names
        for key in ("torque_off", "following_error"):
            number = getattr(self.faults, key)
            if number is not None and number not in numbers("faults.names", names):
                raise ValueError(f"faults.{key}: {number}: allowed are the numbers in [faults.names]: {_listed(names)}")
        for name, text in self.replies.items():
            _check_template(f"replies.{name}", text, [*self._axis_fields(True), *OF_DEVICE])
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
        """Return all requests, each with its action."""
        return [(action, step) for action in ACTIONS for step in getattr(self.requests, action)]

    def gives(self, action: str) -> set[tuple[str, str]]:
        """Return (field, axis name) of all values in the replies to an action."""
        given = set()
        for step in getattr(self.requests, action):
            for _, field in template_places(self.replies.get(step.reply, "")):
                name, _, axis = field.partition(".")
                given |= {(name, each) for each in ((axis,) if axis else self.gimbals)}
        return given

    def warnings(self) -> list[str]:
        """Return one line per protection that this command set lacks."""
        warnings = []
        if self.sequence is None:
            warnings.append(f"protocol {self.name}: no sequence number: a late reply can be mistaken for a new one")
        if self.checksum.kind == "none":
            warnings.append(f"protocol {self.name}: no checksum: a corrupted line can be accepted")
        silent = [action for action, step in self.steps() if not step.reply]
        if silent:
            actions = ", ".join(dict.fromkeys(silent))
            warnings.append(f"protocol {self.name}: no reply to {actions}: a lost request is found by the status alone")
        return warnings

    def _check_step(self, action: str, step: Step) -> None:
        key = f"requests.{action}"
        setpoints = [name for name in self._axis_fields(step.each_axis) if name.split(".")[0] in ("position", "rate")]
        allowed = [*(["axis"] if step.each_axis else []), *(setpoints if action == "set" else [])]
        _check_template(f"{key}: send", step.send, allowed)
        if not step.reply and action in ("set", "enable", "quick_stop", "clear_faults", "hold", "home"):
            return
        if step.reply not in self.replies:
            raise ValueError(
                f"{key}: reply {step.reply!r}: allowed are the names in [replies]: {_listed(self.replies)}"
            )
        allowed = [*self._axis_fields(step.each_axis), *OF_DEVICE]
        _check_template(f"replies.{step.reply}", self.replies[step.reply], allowed)

    def _axis_fields(self, each_axis: bool) -> list[str]:
        """Return the allowed axis fields of a template."""
        named = [f"{name}.{axis}" for name in OF_AXIS for axis in self.gimbals]
        return [*named, "axis", *OF_AXIS] if each_axis else named

    def _check_report(self) -> None:
        reported, sent = self.gives("status"), set()
        for step in self.requests.set:
            for _, field in template_places(step.send):
                name, _, axis = field.partition(".")
                sent |= {(name, each) for each in ((axis,) if axis else self.gimbals)}
        for axis in self.gimbals:
            if ("position", axis) not in sent:
                raise ValueError(f"requests.set: sends no position of {axis}")
            for name in ("position", "status"):
                if (name, axis) not in reported:
                    raise ValueError(f"requests.status: no reply has the {name} of {axis}")
            if self.bits.fault is None and ("fault", axis) not in reported:
                raise ValueError(f"status.fault: is missing, and no reply to requests.status has the fault of {axis}")

    def _check_homing(self) -> None:
        bits = self.bits
        if bits.homed is not None and bits.not_homed is not None:
            raise ValueError("status: homed and not_homed are redundant: give one of them")
        if self.requests.home and (bits.homing is None or (bits.homed is None and bits.not_homed is None)):
            raise ValueError("requests.home: needs status.homing, and status.homed or status.not_homed")


def numbers(key: str, names: Names) -> dict[int, str]:
    """Return names by their numbers; ValueError, starting with ``key``, if a number is invalid."""
    try:
        return {int(number, 0): name for number, name in names.items()}
    except ValueError as error:
        raise ValueError(f"{key}: {_listed(names)}: must be whole numbers, decimal or 0x...") from error


def _check_template(key: str, text: str, allowed: list[str]) -> None:
    try:
        places = template_places(text)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error
    for _, name in places:
        if name and name not in allowed:
            names = ", ".join(f"{{{field}}}" for field in allowed) or "none"
            raise ValueError(f"{key}: {{{name}}}: unknown field here, allowed: {names}")


def _listed(names: Names) -> str:
    return ", ".join(names)
