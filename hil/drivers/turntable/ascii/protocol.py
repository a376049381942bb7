"""ASCII protocol of a protocol file: actions <-> lines, for driver and emulator. No I/O, no clock.

Values are keyed by (field, axis): ("position", 0) in rad, ("rate", 2) in rad/s, ("status", 1) and
("fault", 1) as whole numbers; fields of the device, such as "model", have axis -1.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from typing import Final

from hil.config.protocol import OF_AXIS, NonNegativeInt, Protocol, Step, numbers, template_places
from hil.drivers.turntable.ascii.frames import BrokenLine, Framing
from hil.errors import FaultKind

DEVICE: Final = -1
Value = float | int | str
Key = tuple[str, int]
FieldValues = dict[Key, Value]

_DEGREES: Final = {"deg": 1.0, "mdeg": 1e-3, "arcsec": 1.0 / 3600.0}


class CommandRefused(Exception):
    """The controller returned an error reply; ``text`` describes it."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.text = text


class FieldFormat:
    """Format of one field: text <-> value."""

    def __init__(self, protocol: Protocol, name: str) -> None:
        fields = protocol.fields
        self._decimals = 0
        self._whole: NonNegativeInt | None = None
        self._words: dict[str, int] = {}
        self.scale = 1.0
        if name in ("position", "rate"):
            angle = fields.position if name == "position" else fields.rate
            self._decimals = angle.decimals
            unit = angle.unit.removesuffix("ps")
            turn = protocol.counts_per_turn or 1
            self.scale = math.tau / turn if unit == "counts" else math.radians(_DEGREES[unit])
            self.pattern = r" *[+-]?(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})(?:[eE][+-]?\d{1,3})? *"
        elif name == "status" and protocol.status_words:
            self._words = {
                word: sum(getattr(protocol.bits, meaning) for meaning in dict.fromkeys(meanings))
                for word, meanings in protocol.status_words.items()
            }
            self.pattern = " *(?:" + "|".join(map(re.escape, sorted(self._words, key=len, reverse=True))) + ") *"
        elif name in ("status", "fault", "error"):
            self._whole = getattr(fields, name)
            length = f"{{{self._whole.digits}}}" if self._whole.digits else "{1,10}"
            self.pattern = " *" + ("[0-9A-Fa-f]" if self._whole.base == 16 else r"[+-]?\d") + length + " *"
        else:
            self.pattern = r"[ -~]*?" if name == "ignore" else r"[!-~]+?"
        self._is_number = name in ("position", "rate")

    def write(self, value: Value) -> str:
        if self._is_number:
            return f"{float(value) / self.scale:.{self._decimals}f}"
        if self._words:  # the one with most of the bits, and no other
            return max((word for word in self._words if not self._words[word] & ~int(value)), key=self._bits_of)
        if self._whole is not None:
            form = "X" if self._whole.base == 16 else "d"
            return f"{int(value):0{self._whole.digits or 1}{form}}"
        return str(value)

    def _bits_of(self, word: str) -> int:
        return self._words[word].bit_count()

    def read(self, text: str) -> Value:
        """Return the value; a whole number with a sign is the one with the same 32 bits."""
        if self._is_number:
            return float(text) * self.scale
        if self._words:
            return self._words[text.strip()]
        if self._whole is not None:
            return int(text, self._whole.base) & 0xFFFF_FFFF
        return text


class MessageTemplate:
    """One template, as text to write and as pattern to read."""

    def __init__(self, protocol: Protocol, text: str) -> None:
        self.text = text
        self._axes = protocol.axes[: len(protocol.gimbals)]
        self._gimbals = protocol.gimbals
        self._parts = template_places(text)
        self._formats = [
            FieldFormat(protocol, name.partition(".")[0]) for _, name in self._parts if name and name != "axis"
        ]
        pattern = ""
        formats = iter(self._formats)
        for literal, name in self._parts:
            pattern += re.escape(literal)
            if name == "axis":
                pattern += "(" + "|".join(map(re.escape, self._axes)) + ")"
            elif name:
                pattern += f"({next(formats).pattern})"
        self._pattern = re.compile(pattern, re.ASCII)
        self.names = [name for _, name in self._parts if name]

    def write(self, values: Mapping[Key, Value], axis: int) -> str:
        """Return the text; fields without an axis name belong to ``axis``."""
        out, formats = [], iter(self._formats)
        for literal, name in self._parts:
            out.append(literal)
            if name == "axis":
                out.append(self._axes[axis])
            elif name:
                out.append(next(formats).write(values[self._key(name, axis)]))
        return "".join(out)

    def read(self, text: str, axis: int | None) -> tuple[int, FieldValues] | None:
        """Return the axis of the text and its values, None if it does not match the template.

        axis: the expected one; None if the text gives it, DEVICE if it is for no axis.
        """
        match = self._pattern.fullmatch(text)
        if match is None:
            return None
        groups = match.groups()
        axes = {self._axes.index(group) for name, group in zip(self.names, groups, strict=True) if name == "axis"}
        if len(axes) > 1 or (axes and axis is not None and axes != {axis}):
            return None
        of_axis = axis if axis is not None else (axes.pop() if axes else DEVICE)
        fields = [(name, group) for name, group in zip(self.names, groups, strict=True) if name != "axis"]
        pairs = zip(fields, self._formats, strict=True)
        return of_axis, {self._key(name, of_axis): form.read(group) for (name, group), form in pairs}

    def _key(self, name: str, axis: int) -> Key:
        """Return the key of a field of a template."""
        field, _, of = name.partition(".")
        if of:
            return field, self._gimbals.index(of)
        return (field, axis) if field in OF_AXIS else (field, DEVICE)


class AsciiCommand:
    """One request: the step of an action, compiled."""

    def __init__(self, protocol: Protocol, action: str, step: Step) -> None:
        self.action = action
        self.each_axis = step.each_axis
        self._axes = tuple(range(len(protocol.gimbals)))
        self.send = MessageTemplate(protocol, step.send)
        self.reply = MessageTemplate(protocol, protocol.replies[step.reply]) if step.reply else None

    @property
    def axes(self) -> tuple[int, ...]:
        """The axes for which it is sent."""
        return self._axes if self.each_axis else (DEVICE,)


class AsciiProtocol:
    """The command set of ``protocol``."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.has_sequence = protocol.sequence is not None
        self.sequence_range = 16**protocol.sequence.digits if protocol.sequence else 1
        self.requests = Framing(protocol, protocol.line.request_start, protocol.line.request_end)
        self.replies = Framing(protocol, protocol.line.reply_start, protocol.line.reply_end)
        self.lines: dict[str, list[AsciiCommand]] = {}
        for action, step in protocol.steps():
            self.lines.setdefault(action, []).append(AsciiCommand(protocol, action, step))
        self._all_lines = [line for lines in self.lines.values() for line in lines]
        self._error = MessageTemplate(protocol, protocol.errors.reply) if protocol.errors else None
        self._errors = numbers("errors.names", protocol.error_names)
        self._faults = numbers("faults.names", protocol.faults.names)
        self.set_reports_all = {
            (name, axis) for name in ("position", "status") for axis in protocol.gimbals
        } <= protocol.gives("set")

    def request(self, sequence: int, line: AsciiCommand, axis: int, values: Mapping[Key, Value]) -> bytes:
        """Return a request."""
        return self.requests.encode(sequence, line.send.write(values, axis))

    def decode_request(self, text: bytes) -> tuple[int, AsciiCommand, int, FieldValues]:
        """Return sequence number, command, axis and values of a request.

        Raises BrokenLine for an invalid line, CommandRefused for a valid line with an unknown command.
        """
        sequence, body = self.requests.decode(text)
        for line in self._all_lines:
            decoded = line.send.read(body, None if line.each_axis else DEVICE)
            if decoded is not None:
                return sequence, line, *decoded
        raise CommandRefused(f"{sequence:X}")

    def reply(self, sequence: int, line: AsciiCommand, axis: int, values: Mapping[Key, Value]) -> bytes:
        """Return the reply to a request, b"" if the command set has none."""
        return b"" if line.reply is None else self.replies.encode(sequence, line.reply.write(values, axis))

    def exchange_size(self) -> tuple[int, int]:
        """Return bytes, both directions, and number of replies of an exchange, with all numbers zero."""
        zero: FieldValues = defaultdict(float)
        actions = ("set",) if self.set_reports_all else ("set", "status")
        lines = [(line, axis) for action in actions for line in self.lines[action] for axis in line.axes]
        replies = [self.reply(0, line, axis, zero) for line, axis in lines]
        size = sum(len(self.request(0, line, axis, zero)) for line, axis in lines) + sum(map(len, replies))
        return size, sum(map(bool, replies))

    def refusal(self, sequence: int, number: int) -> bytes:
        """Return the error reply, b"" if the command set has none."""
        if self._error is None:
            return b""
        return self.replies.encode(
            sequence, self._error.write({("error", DEVICE): number, ("ignore", DEVICE): ""}, DEVICE)
        )

    def decode_reply(self, body: str, line: AsciiCommand, axis: int) -> FieldValues:
        """Return the values in a reply's body. Raises BrokenLine, or CommandRefused for an error reply."""
        decoded = line.reply.read(body, axis) if line.reply is not None else None
        if decoded is not None:
            return decoded[1]
        refusal = self._error.read(body, DEVICE) if self._error else None
        if refusal is None:
            raise BrokenLine(f"{body!r} is no reply to {line.send.text!r}")
        number = int(refusal[1]["error", DEVICE]) if ("error", DEVICE) in refusal[1] else 0
        raise CommandRefused(f"error {number} ({self._errors.get(number, 'not in the protocol file')})")

    def fault_text(self, number: int) -> str:
        """Return the name of a fault number, or the names of fault flags."""
        if self.protocol.faults.kind == "code":
            return self._faults.get(number, f"unknown fault {number}") if number else "no fault number"
        names = [name for bit, name in self._faults.items() if number & bit]
        unknown = number & ~sum(self._faults)
        if unknown:
            names.append(f"unknown flags 0x{unknown:04X}")
        return ", ".join(names) or "no fault flag"

    def fault_kind(self, number: int) -> FaultKind:
        """Return the kind of a fault number."""
        faults = self.protocol.faults
        if faults.torque_off is None:
            return FaultKind.OTHER
        is_off = bool(number & faults.torque_off) if faults.kind == "flags" else number == faults.torque_off
        return FaultKind.TORQUE_OFF if is_off else FaultKind.OTHER
