"""C headers of external GNCs, ``hil_gnc.h``, and of backends, ``hil_backends.h``, from the tables of their records.

``python -m docs.c_headers`` writes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hil.core.fields import Field, Fields, described, record_dtype
from hil.core.gnc_records import (
    BACKEND_POSE_FIELDS,
    BACKEND_PROTOCOL,
    BACKEND_SAMPLE_FIELDS,
    CONTROL_INPUT_FIELDS,
    GNC_INPUT_FIELDS,
    GNC_POSE_FIELDS,
    GNC_SETUP_FIELDS,
    MEASURED_FIELDS,
    NAVIGATION_INPUT_FIELDS,
    OLDEST_PROTOCOL,
    OUTPUT_FIELDS,
    PROTOCOL,
    REASON_BYTES,
    GncHealth,
    GncMode,
    GncOrder,
    GncState,
)
from hil.core.messages import NAVIGATION_FIELDS, REFERENCE_FIELDS
from hil.core.sensor_records import SENSOR_SAMPLE_FIELDS
from hil.gnc_backends.c_header import BACKENDS_HEADER_FILE, HEADER_FILE

STRUCTS: Final[dict[str, Fields]] = {
    "hil_gnc_setup": GNC_SETUP_FIELDS,
    "hil_gnc_pose": GNC_POSE_FIELDS,
    "hil_backend_sample": BACKEND_SAMPLE_FIELDS,
    "hil_backend_pose": BACKEND_POSE_FIELDS,
    "hil_measurement": SENSOR_SAMPLE_FIELDS,
    "hil_measured": MEASURED_FIELDS,
    "hil_gnc_input": GNC_INPUT_FIELDS,
    "hil_gnc_output": OUTPUT_FIELDS["gnc"],
}
"""Tables by the names of their structs."""
_TYPES: Final = {"f8": "double", "i8": "int64_t", "i4": "int32_t", "u1": "uint8_t"}
_HEAD: Final = """\
/* hil_gnc.h: records exchanged between the bench and an external GNC. Printed by: hil gnc header
 *
 * The same bytes are the structs of a shared library and the mailboxes gnc.setup, gnc.input and gnc.output on the wire
 * (docs/how-to/connect-your-gnc.md), where the last fields of the setup are the mailbox gnc.orbit, and the input ends
 * before `measured`, whose parts are the mailboxes imu.samples, gnc.poses and gnc.measurements. Little-endian; aligned
 * as a compiler for x86-64 or ARM64 does. SI units.
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

/* Return HIL_GNC_PROTOCOL. The bench accepts {oldest} to {present}: fields are appended, never moved. */
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
    functions = _FUNCTIONS.format(oldest=OLDEST_PROTOCOL, present=PROTOCOL)
    parts = [_HEAD, f"#define HIL_GNC_PROTOCOL {PROTOCOL}\n#define HIL_GNC_REASON_BYTES {REASON_BYTES}\n"]
    parts += [_enum("mode", GncMode), _enum("order", GncOrder), _enum("state", GncState), _enum("health", GncHealth)]
    parts += [struct_text(struct, STRUCTS) for struct in STRUCTS]
    return "\n".join([*parts, functions, layout_checks(STRUCTS), TAIL])


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
        return f"{next(name for name, dtype in structs.items() if dtype is field.type)} {field.name}{extents}"
    if field.type.startswith("S"):
        return f"char {field.name}[{field.type[1:]}]"
    return f"{_TYPES[field.type]} {field.name}{extents}"


def layout_checks(structs: Mapping[str, Fields]) -> str:
    """Return assertions that the compiler lays the structs out as the bench does."""
    lines = ["#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L"]
    for struct, fields in structs.items():
        dtype = record_dtype(fields)
        lines.append(f'_Static_assert(sizeof({struct}) == {dtype.itemsize}, "size of {struct}");')
        for field, layout in (dtype.fields or {}).items():
            lines.append(f'_Static_assert(offsetof({struct}, {field}) == {layout[1]}, "place of {struct}.{field}");')
    return "\n".join([*lines, "#endif\n"])


BACKEND_STRUCTS: Final[dict[str, Fields]] = {
    "hil_navigation": NAVIGATION_FIELDS,
    "hil_reference": REFERENCE_FIELDS,
    "hil_navigation_input": NAVIGATION_INPUT_FIELDS,
    "hil_navigation_output": OUTPUT_FIELDS["navigation"],
    "hil_control_input": CONTROL_INPUT_FIELDS,
    "hil_control_output": OUTPUT_FIELDS["control"],
}
"""Tables by the names of their structs."""
_BACKENDS_HEAD: Final = """\
/* hil_backends.h: records of backends of navigation and of control. Printed by: hil gnc header --backends
 *
 * A backend takes the place of the built-in navigation or the built-in control (docs/how-to/fly-a-law.md).
 * Enumerations, setup and what is measured are those of hil_gnc.h. SI units. Frames: H is Hill's (LVLH) frame of the
 * target, c the chaser's body. Quaternions have the scalar last; q_CH takes components in H to components in c.
 */
#ifndef HIL_BACKENDS_H
#define HIL_BACKENDS_H

#include "hil_gnc.h"

#ifdef __cplusplus
extern "C" {
#endif
"""
_BACKENDS_FUNCTIONS: Final = """\
/* A setting that a backend declares: a key of the scenario, gnc.control.settings.NAME. low < high: its range. */
typedef struct {
    const char *name;
    const char *unit;
    const char *meaning;
    double value; /* unless the scenario sets another */
    double low;
    double high;
} hil_backend_setting;

/* A shared library has the first function, and those of navigation or of control, or all. They are called from one
 * thread at a time per instance and must not block. */

/* Return HIL_BACKENDS_PROTOCOL. */
int hil_backends_protocol(void);

/* Optional: the declared settings, at most 32; the last one has the name NULL. */
extern const hil_backend_setting hil_navigation_settings[];
extern const hil_backend_setting hil_control_settings[];

/* Return an instance for *setup, or NULL to reject it with the reason as text of up to HIL_GNC_REASON_BYTES bytes,
 * including its terminating zero. settings: the values in the order of their declaration; they may change between two
 * steps, and stay valid until the instance is closed. Several can exist at a time: keep nothing in global variables. */
void *hil_navigation_open(const hil_gnc_setup *setup, const double *settings, char *reason);
void *hil_control_open(const hil_gnc_setup *setup, const double *settings, char *reason);

/* Answer *input in *output, which is preset: no estimate, numbers that are not reported nan; no demands.
 * Return 0; any other value is a fault that stops the bench. */
int hil_navigation_step(const hil_navigation_input *input, hil_navigation_output *output, void *instance);
int hil_control_step(const hil_control_input *input, hil_control_output *output, void *instance);

/* Free the instance. */
void hil_navigation_close(void *instance);
void hil_control_close(void *instance);
"""


def backends_header() -> str:
    """Return the text of ``hil_backends.h``."""
    structs = [struct_text(struct, {**STRUCTS, **BACKEND_STRUCTS}) for struct in BACKEND_STRUCTS]
    version = f"#define HIL_BACKENDS_PROTOCOL {BACKEND_PROTOCOL}\n"
    return "\n".join([_BACKENDS_HEAD, version, *structs, _BACKENDS_FUNCTIONS, layout_checks(BACKEND_STRUCTS), TAIL])


if __name__ == "__main__":
    HEADER_FILE.write_text(c_header())
    BACKENDS_HEADER_FILE.write_text(backends_header())
