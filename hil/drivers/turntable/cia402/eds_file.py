"""Electronic data sheets and device configuration files (CiA 306), read as makers write them.

The description of an object is read from the sections of that object alone. Lists of objects, counts of sub-indices
and all other sections are not used, so that a slip in them refuses no file. A value that cannot be read is unknown, and
a note; the user of the variable decides whether it matters.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from hil.core.files import MIB, read_bytes
from hil.errors import BadInput

_BYTES_MAX: Final = 4 * MIB
_SECTION: Final = re.compile(r"\[\s*(?:0x)?([0-9a-f]{4})\s*(?:(sub|value)\s*(?:0x)?([0-9a-f]{0,2}))?\s*\]", re.I)
_DEVICE: Final = (0, "device", 0)
_NODE_ID: Final = re.compile(r"\+?\s*\$\s*node_?id\s*\+?", re.I)
_DEVICE_SECTION: Final = re.compile(r"\[\s*deviceinfo\s*\]", re.I)
_COMMENTS: Final = (";", "#", "//")
_SUBINDEX_MAX: Final = 0xFE

TYPES: Final = {
    0x01: ("BOOLEAN", 8), 0x02: ("INTEGER8", 8), 0x03: ("INTEGER16", 16), 0x04: ("INTEGER32", 32),
    0x05: ("UNSIGNED8", 8), 0x06: ("UNSIGNED16", 16), 0x07: ("UNSIGNED32", 32), 0x08: ("REAL32", 32),
    0x10: ("INTEGER24", 24), 0x11: ("REAL64", 64), 0x15: ("INTEGER64", 64), 0x16: ("UNSIGNED24", 24),
    0x1B: ("UNSIGNED64", 64),
}  # fmt: skip
"""Name and bits of the data types that have a size."""
_UNSIGNED8: Final = 0x05
_UNSIGNED16: Final = 0x06
_UNSIGNED32: Final = 0x07
_PDO_TYPES: Final = {1: _UNSIGNED32, 2: _UNSIGNED8, 3: _UNSIGNED16, 5: _UNSIGNED16}
_PDOS_MAX: Final = 512
MAPPED_MAX: Final = 8
_COMPOSED: Final = (0x8, 0x9)  # object types: array, record
_TEXTS: Final = (0x09, 0x0A, 0x0B)
_SIGNED: Final = (0x02, 0x03, 0x04, 0x10, 0x15)
_WRITABLE: Final = ("rw", "wo", "rww", "rwr")

_Options = dict[str, str]


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of a data sheet; what is None, the file does not give, or not legibly.

    section: its name in the file. access: in lower case. default: a number, of a COB-ID that depends on the node id the
    one for node 0 (``is_relative``), or a text. low, high: range of the value.
    """

    index: int
    subindex: int
    section: str
    data_type: int | None = None
    access: str | None = None
    is_mappable: bool = False
    default: int | str | None = None
    is_relative: bool = False
    low: int | None = None
    high: int | None = None

    @property
    def is_writable(self) -> bool:
        """Whether the file does not exclude that it can be written."""
        return self.access is None or self.access in _WRITABLE

    @property
    def bits(self) -> int | None:
        """Size in bits."""
        return TYPES[self.data_type][1] if self.data_type in TYPES else None

    @property
    def type_name(self) -> str:
        """Name of the data type, its code for one that has no size."""
        return TYPES[self.data_type][0] if self.data_type in TYPES else f"0x{self.data_type or 0:04X}"

    @property
    def number(self) -> int | None:
        """The default, if it is a number."""
        return self.default if isinstance(self.default, int) else None


@dataclass
class DataSheet:
    """Variables of a file by index and sub-index. notes: ``[section] key: problem`` of values that cannot be read."""

    variables: dict[tuple[int, int], Variable] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def read_data_sheet(path: Path) -> DataSheet:
    """Return the variables of an EDS or DCF file. Raises BadInput for a file that describes no object."""
    sheet = DataSheet()
    sections = _sections(_text_of(read_bytes(path, _BYTES_MAX)), sheet.notes)
    described = {index for index, *_ in sections}
    compact = _compact_pdos(*sections.pop(_DEVICE, ("", _Options())), sheet.notes)
    sheet.variables = {key: each for key, each in compact.items() if key[0] not in described}
    for (index, kind, subindex), (name, options) in sections.items():
        entries = _number(name, options, "compactsubobj", sheet.notes)
        if kind == "sub":
            sheet.variables[index, subindex] = _variable(index, subindex, name, options, sheet.notes)
        elif kind == "" and entries:
            _, values = sections.get((index, "value", 0), ("", {}))
            sheet.variables[index, 0] = Variable(index, 0, name, _UNSIGNED8, "ro", default=entries)
            for sub in range(1, min(entries, _SUBINDEX_MAX) + 1):
                own = {"defaultvalue": values[str(sub)]} if str(sub) in values else {}
                sheet.variables[index, sub] = _variable(index, sub, name, options | own, sheet.notes)
        elif kind == "" and _number(name, options, "objecttype", sheet.notes) not in _COMPOSED:
            sheet.variables.setdefault((index, 0), _variable(index, 0, name, options, sheet.notes))
    if not sheet.variables:
        raise BadInput.single(str(path), "", "not an EDS file: it has no section of an object, such as [6041]")
    return sheet


def _text_of(data: bytes) -> str:
    """Return the text of a file, in any encoding that makers use."""
    for mark, encoding in ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if data.startswith(mark):
            return data.decode(encoding, "replace").lstrip("\ufeff")
    return data.decode("latin-1")


def _sections(text: str, notes: list[str]) -> dict[tuple[int, str, int], tuple[str, _Options]]:
    """Return name and options of the sections of objects by index, kind ("", "sub", "value") and sub-index."""
    sections: dict[tuple[int, str, int], tuple[str, _Options]] = {}
    name, options = "", _Options()
    for line in map(str.strip, text.splitlines()):
        if line.startswith("["):
            match = _SECTION.match(line)
            key = (int(match[1], 16), (match[2] or "").lower(), int(match[3] or "0", 16)) if match else None
            key = _DEVICE if _DEVICE_SECTION.match(line) else key
            name, options = (
                (line[: line.find("]") + 1], {})
                if key is None
                else sections.setdefault(key, (line[: line.find("]") + 1], {}))
            )
        elif line and not line.startswith(_COMMENTS):
            option, separator, value = line.partition("=")
            option = option.strip().lower()
            if not separator:
                notes.append(f"{name} {line[:40]}: is no option, expected KEY=VALUE: ignored")
            elif option in options and options[option] != value.strip():
                notes.append(f"{name} {option}: is given twice, the last one counts: {value.strip()[:40]}")
            options[option] = value.strip()
    return sections


def _compact_pdos(name: str, options: _Options, notes: list[str]) -> dict[tuple[int, int], Variable]:
    """Return the entries of PDOs that have no section of their own: bit n - 1 of CompactPDO is sub-index n."""
    bits = _number(name, options, "compactpdo", notes) or 0
    access = "rw" if _number(name, options, "granularity", notes) else "ro"
    variables = {}
    for key, parameters, mappings in (("nrofrxpdo", 0x1400, 0x1600), ("nroftxpdo", 0x1800, 0x1A00)):
        for number in range(min((_number(name, options, key, notes) or 0) * bool(bits), _PDOS_MAX)):
            index = parameters + number
            for sub in (sub for sub in _PDO_TYPES if bits >> sub - 1 & 1):
                variables[index, sub] = Variable(index, sub, f"{name} CompactPDO", _PDO_TYPES[sub], "rw")
            for sub in range(MAPPED_MAX + 1):
                kind = _UNSIGNED32 if sub else _UNSIGNED8
                variables[mappings + number, sub] = Variable(mappings + number, sub, f"{name} CompactPDO", kind, access)
    return variables


def _variable(index: int, subindex: int, name: str, options: _Options, notes: list[str]) -> Variable:
    data_type = _number(name, options, "datatype", notes)
    text = options.get("parametervalue") or options.get("defaultvalue") or ""
    default: int | str | None = text
    if data_type not in _TEXTS:
        key = "parametervalue" if options.get("parametervalue") else "defaultvalue"
        default = _number(name, options, key, notes)
    low, high = (_number(name, options, key, notes) for key in ("lowlimit", "highlimit"))
    if low is not None and high is not None and data_type in _SIGNED:
        low, high = (_signed(value, TYPES[data_type][1]) for value in (low, high))
    if low is not None and high is not None and low > high:
        notes.append(f"{name} lowlimit: {low} is above highlimit, {high}: both are ignored")
        low = high = None
    return Variable(
        index,
        subindex,
        name,
        data_type,
        options["accesstype"].lower() if options.get("accesstype") else None,
        bool(_number(name, options, "pdomapping", notes)),
        default,
        _NODE_ID.search(text) is not None,
        low,
        high,
    )


def _number(name: str, options: _Options, key: str, notes: list[str]) -> int | None:
    """Return a whole number, hexadecimal after 0x; the node id counts as 0."""
    text = _NODE_ID.sub("", options.get(key, "")).split(";")[0].strip()
    if not text:
        return 0 if options.get(key) else None
    try:
        return int(text, 0) if text[:3].lower().lstrip("+-").startswith("0x") else int(text, 10)
    except ValueError:
        if key == "pdomapping" and text.lower() in ("true", "yes"):
            return 1
        notes.append(f"{name} {key}: {text[:40]!r} is no number: unknown")
        return None


def _signed(value: int, bits: int) -> int:
    """Return a number that a file gives as unsigned, though its type has a sign."""
    return value - (1 << bits) if value >= 1 << (bits - 1) else value
