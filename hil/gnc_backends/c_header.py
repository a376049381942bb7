"""The C header and the table of docs, both from the records of ``hil/core/gnc_records.py``: one definition."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import Final

import numpy as np

from hil.core import gnc_records
from hil.core.gnc_records import (
    GNC_INPUT,
    GNC_OUTPUT,
    GNC_POSE,
    GNC_SETUP,
    PROTOCOL,
    REASON_BYTES,
    GncMode,
    GncOrder,
    GncState,
)

HEADER_FILE: Final = Path(__file__).resolve().parent / "include" / "hil_gnc.h"
RECORDS: Final = {"setup": GNC_SETUP, "pose": GNC_POSE, "input": GNC_INPUT, "output": GNC_OUTPUT}
_TYPES: Final = {"f8": "double", "i8": "int64_t", "i4": "int32_t", "u1": "uint8_t"}
_NAMED: Final = re.compile(r'^\s*(?:\("(?P<field>\w+)", .*\)|(?P<name>[A-Z_]+) = \d+),?\s*# (?P<words>.*)$')
_HEAD: Final = """\
/* hil_gnc.h: what passes between the bench and a GNC of the user's own. Printed by: hil gnc-header
 *
 * The same bytes are the structs of a shared library and the cells gnc.setup, gnc.input and gnc.output on the wire
 * (docs/your-own-gnc.md). Little-endian; aligned as a compiler for x86-64 or ARM64 does. SI units.
 * Frames: H is Hill's (LVLH) frame of the target, c the chaser's body. Quaternions have the scalar last;
 * q_CH turns components in H into components in c.
 */
#ifndef HIL_GNC_H
#define HIL_GNC_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif
"""
_FUNCTIONS: Final = """\
/* A shared library has these four functions. All are called from one thread at a time and must not block. */

/* Return HIL_GNC_PROTOCOL. */
int hil_gnc_protocol(void);

/* Return a GNC that knows *setup, or NULL to refuse it, with the reason as a text of up to HIL_GNC_REASON_BYTES
 * bytes, its closing zero included. There may be several at a time: keep nothing in global variables. */
void *hil_gnc_open(const hil_gnc_setup *setup, char *reason);

/* Answer *input in *output, which comes with the input's cycle, as HIL_GNC_WORKING, and with zeros in all else.
 * The bench calls it in each cycle in which the run's time runs (HIL_GNC_RUNNING) or is held (HIL_GNC_HOLD).
 * Return 0; anything else is a fault that stops the bench. */
int hil_gnc_step(void *gnc, const hil_gnc_input *input, hil_gnc_output *output);

/* Free what hil_gnc_open returned. */
void hil_gnc_close(void *gnc);
"""
_TAIL: Final = """\
#ifdef __cplusplus
}
#endif
#endif
"""


def c_header() -> str:
    """Return the text of ``hil_gnc.h``."""
    parts = [_HEAD, f"#define HIL_GNC_PROTOCOL {PROTOCOL}\n#define HIL_GNC_REASON_BYTES {REASON_BYTES}\n"]
    parts += [_enum(kind) for kind in (GncMode, GncOrder, GncState)]
    parts += [_struct(name, dtype) for name, dtype in RECORDS.items()]
    return "\n".join([*parts, _FUNCTIONS, _checks(), _TAIL])


def layout_table(dtype: np.dtype) -> str:
    """Return the fields of a record as a table of Markdown: offset, type, name, meaning."""
    rows = ["| offset | type | field | meaning |", "|---:|---|---|---|"]
    for name, field, offset, words in _fields(dtype):
        rows.append(f"| {offset} | {_shown_type(field)} | `{name}` | {words} |")
    return "\n".join([*rows, f"| {dtype.itemsize} | | | *size* |"])


def _fields(dtype: np.dtype) -> Iterator[tuple[str, np.dtype, int, str]]:
    words = _words()
    for name, place in (dtype.fields or {}).items():
        yield name, place[0], place[1], words.get(_key(dtype, name), "")


def _key(dtype: np.dtype, name: str) -> str:
    record = next(name for name, known in RECORDS.items() if known is dtype)
    return f"GNC_{record.upper()}.{name}"


def _words() -> dict[str, str]:
    """Return what the comments of the interface say of each field and each name of an enumeration."""
    found, owner = {}, ""
    for line in inspect.getsource(gnc_records).splitlines():
        if match := re.match(r"(?:class )?(\w+)(?:\(Int|: Final = np.dtype)", line):
            owner = match.group(1)
        elif match := _NAMED.match(line):
            found[f"{owner}.{match.group('field') or match.group('name')}"] = match.group("words")
    return found


def _enum(kind: type[IntEnum] | type[IntFlag]) -> str:
    words = _words()
    lines = []
    for member in kind:
        said = words.get(f"{kind.__name__}.{member.name}", "")
        lines.append(f"    HIL_GNC_{member.name} = {member.value}," + (f" /* {said} */" if said else ""))
    return "\n".join([f"enum hil_gnc_{kind.__name__.removeprefix('Gnc').lower()} {{", *lines, "};\n"])


def _struct(name: str, dtype: np.dtype) -> str:
    lines = []
    for field, inner, _, words in _fields(dtype):
        said = f" /* {words} */" if words else ""
        lines.append(f"    {_declared(field, inner)};{said}")
    return "\n".join(["typedef struct {", *lines, f"}} hil_gnc_{name};\n"])


def _declared(name: str, dtype: np.dtype) -> str:
    extents = "".join(f"[{extent}]" for extent in dtype.shape)
    base = dtype.base
    if base.kind == "S":
        return f"char {name}[{base.itemsize}]"
    if base.names:
        return f"hil_gnc_{next(known for known, record in RECORDS.items() if record == base)} {name}{extents}"
    return f"{_TYPES[base.str[1:]]} {name}{extents}"


def _shown_type(dtype: np.dtype) -> str:
    base = dtype.base
    text = "pose" if base.names else (f"S{base.itemsize}" if base.kind == "S" else base.str[1:])
    return text + (f"[{']['.join(map(str, dtype.shape))}]" if dtype.shape else "")


def _checks() -> str:
    """Return assertions that the compiler lays the structs out as the bench does."""
    lines = ["#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L"]
    for name, dtype in RECORDS.items():
        struct = f"hil_gnc_{name}"
        lines.append(f'_Static_assert(sizeof({struct}) == {dtype.itemsize}, "size of {struct}");')
        for field, place in (dtype.fields or {}).items():
            lines.append(f'_Static_assert(offsetof({struct}, {field}) == {place[1]}, "place of {struct}.{field}");')
    return "\n".join([*lines, "#endif\n"])
