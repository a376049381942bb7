"""Reference pages of wires and of modes, made from codecs, frame files, enumerations and tables of the code."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import textwrap
from itertools import pairwise
from types import ModuleType
from typing import Final

from hil.config.load import load_frame
from hil.core.gnc_records import GncHealth
from hil.core.modes import ALLOWED, Mode
from hil.core.operator_commands import OperatorCommand
from hil.frmn.mailboxes import BY_NUMBER
from hil.report.limits import LIMITS, unit_of, words_of
from hil.safety.monitor import CHECKS, Checks

CODECS: Final = {
    "Rails on Modbus": "hil.drivers.rails.codec",
    "Digital lines on Modbus TCP": "hil.drivers.io.codec",
    "Command words of a flight computer": "hil.parts.links.command_word_codec",
    "Datagrams between hosts": "hil.frmn.wire",
    "Tag of a datagram": "hil.parts.links.authentication",
    "Messages of the console": "hil.parts.console.message",
}
"""Title of a section -> module whose docstring describes the format."""
FRAMES: Final = ("hil", "euler-mm")


def wires() -> str:
    """Return the page of the formats on wires."""
    parts = [
        """# Formats on wires

What each codec states of its format, byte by byte, and the frame files of vision units. How links start, repeat and
fail: [wire formats](../wire-formats.md). The keys of frame and protocol files: [files](files.md).
"""
    ]
    for title, name in CODECS.items():
        module = importlib.import_module(name)
        parts.append(f"## {title}\n\n`{name.replace('.', '/')}.py`. {markdown(inspect.getdoc(module) or '')}\n")
        if name == "hil.frmn.wire":
            parts.append(_mailboxes())
    parts += [_frames(name) for name in FRAMES]
    return "\n".join([*parts, _counters()])


def markdown(text: str) -> str:
    """Return a docstring as Markdown: its tables and indented blocks as they are."""
    linked = re.sub(r"docs/([\w/-]+)/([\w-]+)\.md", r"[\2](../../\1/\2.md)", text.replace("``", "`"))
    blocks = [block for block in linked.split("\n\n") if block.strip()]
    return "\n\n".join(
        f"```text\n{textwrap.dedent(block)}\n```" if block.startswith(("    ", "==")) else block for block in blocks
    )


def _mailboxes() -> str:
    rows = [
        f"| {box.number} | `{box.name}` | {box.dtype.itemsize} | {box.writer.name} | `{box.layout:04x}` | "
        f"{', '.join(f'`{field}`' for field in box.dtype.names or ())} |"
        for box in BY_NUMBER.values()
    ]
    head = "| number | mailbox | bytes | written by | layout | fields |\n|---|---|---|---|---|---|\n"
    return "## Mailboxes\n\nA cell of a datagram is one of these records.\n\n" + head + "\n".join(rows) + "\n"


def _frames(name: str) -> str:
    frame = load_frame(name).value
    offset = len(bytes.fromhex(frame.sync))
    rows = [f"| 0 | sync | bytes | `{frame.sync}` |"]
    for field in frame.fields:
        number = f"{field.count} x {field.type}" if field.count > 1 else field.type
        rows.append(
            f"| {offset} | {field.name} | {number} | {'' if field.scale == 1.0 else f'times {field.scale:g}'} |"
        )
        offset += field.count * int(field.type[1:]) // 8
    rows.append(f"| {offset} | checksum | | {frame.checksum.kind} |")
    head = "| offset | field | type | SI value |\n|---|---|---|---|\n"
    return (
        f"## Frame of a vision unit: {name}\n\n`configs/frames/{name}.toml`, {frame.byte_order} endian, on RS-422.\n\n"
        f"{head}" + "\n".join(rows) + "\n"
    )


def _counters() -> str:
    module = importlib.import_module("hil.drivers.vmu")
    return (
        f"## Counters of a vision unit\n\n{described(module, 'COUNTERS')}\n\n"
        f"## Counters of cameras\n\n{described(module, 'CAMERA_COUNTERS')}\n"
    )


def described(module: ModuleType, name: str) -> str:
    """Return the docstring of the constant ``name`` of ``module``, as a list if it has names with colons."""
    body = ast.parse(inspect.getsource(module)).body
    for statement, text in pairwise(body):
        target = statement.target if isinstance(statement, ast.AnnAssign) else None
        if isinstance(target, ast.Name) and target.id == name and isinstance(text, ast.Expr):
            value = text.value
            assert isinstance(value, ast.Constant)
            return _listed(str(value.value))
    raise LookupError(f"{module.__name__}.{name} has no docstring")


def _listed(text: str) -> str:
    """Return text of the form ``name: meaning. name, name: meaning.`` as a list after its other sentences."""
    prose = " ".join(inspect.cleandoc(text).replace("``", "`").split())
    parts = re.split(r"(?<=\.) (?=[A-Za-z_]+(?:, [a-z_]+)*: )", prose)
    return "\n".join(
        re.sub(r"^([A-Za-z_]+(?:, [a-z_]+)*): ", r"- **\1**: ", part) + ("\n" if k == 0 and ": " not in part else "")
        for k, part in enumerate(parts)
    )


def modes() -> str:
    """Return the page of modes, commands, checks, health and limits of a run."""
    allowed = [f"| {mode.value} | {_listed_modes(targets, Mode)} |" for mode, targets in ALLOWED.items()]
    commands = [f"| {command.value} | {_listed_modes(command.modes, Mode)} |" for command in OperatorCommand]
    names = list(Checks.__dataclass_fields__)
    checks = [
        f"| {mode.value} | " + " | ".join("x" if getattr(found, name) else "" for name in names) + " |"
        for mode, found in CHECKS.items()
    ]
    health = [f"| {bit.value} | {(bit.name or '').lower()} | {bit.meaning} |" for bit in GncHealth if bit]
    limits = [f"| `{name}` | {unit_of(name)} | {words_of(name)} |" for name in LIMITS]
    return "\n".join(
        [
            "# Modes, commands, checks and limits of a run\n\nThe tables of the program, which "
            "[modes and alarms](../modes-and-alarms.md) explains.\n",
            f"## Modes\n\n{_listed(inspect.getdoc(Mode) or '')}\n\n| mode | may lead to |\n|---|---|",
            "\n".join(allowed),
            f"\n## Commands\n\n{_listed(inspect.getdoc(OperatorCommand) or '')}\n\n"
            "| command | executed in |\n|---|---|",
            "\n".join(commands),
            f"\n## Checks of each mode\n\n{' '.join((inspect.getdoc(Checks) or '').replace('``', '`').split())}\n",
            f"| mode | {' | '.join(names)} |\n|---|{'---|' * len(names)}",
            "\n".join(checks),
            "\n## Health\n\nBits of the navigation's health.\n\n| bit | name | meaning |\n|---|---|---|",
            "\n".join(health),
            "\n## Limits of a run\n\nLeast margins of each run and case: `limits` in the JSON, `margin_<limit>` in "
            "campaigns.\n\n| limit | unit | value |\n|---|---|---|",
            "\n".join(limits),
            "",
        ]
    )


def _listed_modes(found: frozenset[Mode], order: type[Mode]) -> str:
    missing = [mode for mode in order if mode not in found]
    if len(missing) < 3:
        return f"every mode but {', '.join(mode.value for mode in missing)}" if missing else "every mode"
    return ", ".join(mode.value for mode in order if mode in found)
