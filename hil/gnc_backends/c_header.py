"""C header ``hil_gnc.h`` of the records that are exchanged with an external GNC, from their field tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from hil.core.fields import Field, Fields, described, record_dtype
from hil.core.gnc_records import (
    GNC_INPUT_FIELDS,
    GNC_OUTPUT_FIELDS,
    GNC_POSE_FIELDS,
    GNC_SETUP_FIELDS,
    PROTOCOL,
    REASON_BYTES,
    GncHealth,
    GncMode,
    GncOrder,
    GncState,
)

HEADER_FILE: Final = Path(__file__).resolve().parent / "include" / "hil_gnc.h"
RECORDS: Final[dict[str, Fields]] = {
    "setup": GNC_SETUP_FIELDS,
    "pose": GNC_POSE_FIELDS,
    "input": GNC_INPUT_FIELDS,
    "output": GNC_OUTPUT_FIELDS,
}
STRUCTS: Final = {f"hil_gnc_{name}": fields for name, fields in RECORDS.items()}
"""Tables by the names of their structs."""
_TYPES: Final = {"f8": "double", "i8": "int64_t", "i4": "int32_t", "u1": "uint8_t"}
_HEAD: Final = """\
/* hil_gnc.h: records exchanged between the bench and an external GNC. Printed by: hil gnc header
 *
 * The same bytes are the structs of a shared library and the mailboxes gnc.setup, gnc.input and gnc.output on the wire,
 * where the last fields of the setup are the mailbox gnc.orbit (docs/how-to/connect-your-gnc.md). Little-endian;
 * aligned as a compiler for x86-64 or ARM64 does. SI units.
 * Frames: H is Hill's (LVLH) frame of the target, c the chaser's body. Quaternions have the scalar last;
 * q_CH takes components in H to components in c.
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
/* A shared library has these four functions. They are called from one thread at a time and must not block. */

/* Return HIL_GNC_PROTOCOL. */
int hil_gnc_protocol(void);

/* Return a GNC for *setup, or NULL to reject it with the reason as text of up to HIL_GNC_REASON_BYTES bytes,
 * including its terminating zero. Several can exist at a time: keep nothing in global variables. */
void *hil_gnc_open(const hil_gnc_setup *setup, char *reason);

/* Answer *input in *output, which is preset to the input's cycle, HIL_GNC_WORKING and zeros.
 * The bench calls it in each cycle while the run's time advances (HIL_GNC_RUNNING) or is held (HIL_GNC_HOLD).
 * Return 0; any other value is a fault that stops the bench. */
int hil_gnc_step(void *gnc, const hil_gnc_input *input, hil_gnc_output *output);

/* Free the GNC that hil_gnc_open returned. */
void hil_gnc_close(void *gnc);
"""
TAIL: Final = """\
#ifdef __cplusplus
}
#endif
#endif
"""


def c_header() -> str:
    """Return the text of ``hil_gnc.h``."""
    parts = [_HEAD, f"#define HIL_GNC_PROTOCOL {PROTOCOL}\n#define HIL_GNC_REASON_BYTES {REASON_BYTES}\n"]
    parts += [_enum("mode", GncMode), _enum("order", GncOrder), _enum("state", GncState), _enum("health", GncHealth)]
    parts += [struct_text(struct, STRUCTS) for struct in STRUCTS]
    return "\n".join([*parts, _FUNCTIONS, layout_checks(STRUCTS), TAIL])


def _enum(name: str, kind: type[GncMode | GncOrder | GncState | GncHealth]) -> str:
    lines = [f"    HIL_GNC_{member.name} = {int(member)},{_comment(member.meaning)}" for member in kind]
    return "\n".join([f"enum hil_gnc_{name} {{", *lines, "};\n"])


def struct_text(struct: str, structs: Mapping[str, Fields]) -> str:
    """Return the definition of ``struct``; structs: names of the tables of it and of those nested in it."""
    lines = [f"    {_declared(field, structs)};{_comment(described(field))}" for field in structs[struct]]
    return "\n".join(["typedef struct {", *lines, f"}} {struct};\n"])


def _comment(text: str) -> str:
    return f" /* {text} */" if text else ""


def _declared(field: Field, structs: Mapping[str, Fields]) -> str:
    shape = field.shape if isinstance(field.shape, tuple) else (field.shape,)
    extents = "".join(f"[{extent}]" for extent in shape)
    if not isinstance(field.type, str):
        return f"{next(name for name, known in structs.items() if known is field.type)} {field.name}{extents}"
    if field.type.startswith("S"):
        return f"char {field.name}[{field.type[1:]}]"
    return f"{_TYPES[field.type]} {field.name}{extents}"


def layout_checks(structs: Mapping[str, Fields]) -> str:
    """Return assertions that the compiler lays the structs out as the bench does."""
    lines = ["#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L"]
    for struct, fields in structs.items():
        dtype = record_dtype(fields)
        lines.append(f'_Static_assert(sizeof({struct}) == {dtype.itemsize}, "size of {struct}");')
        for field, place in (dtype.fields or {}).items():
            lines.append(f'_Static_assert(offsetof({struct}, {field}) == {place[1]}, "place of {struct}.{field}");')
    return "\n".join([*lines, "#endif\n"])
