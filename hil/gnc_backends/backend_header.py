"""C header ``hil_backends.h`` of backends of navigation and of control, from the tables of their records."""

from __future__ import annotations

from typing import Final

from hil.core.backend_records import (
    BACKEND_POSE_FIELDS,
    BACKEND_PROTOCOL,
    BACKEND_SAMPLE_FIELDS,
    CONTROL_INPUT_FIELDS,
    CONTROL_OUTPUT_FIELDS,
    NAVIGATION_INPUT_FIELDS,
    NAVIGATION_OUTPUT_FIELDS,
)
from hil.core.fields import Fields
from hil.core.gnc_records import GNC_SETUP_FIELDS
from hil.core.messages import NAVIGATION_FIELDS, REFERENCE_FIELDS
from hil.core.sensor_records import SENSOR_SAMPLE_FIELDS
from hil.gnc_backends.c_header import HEADER_FILE, TAIL, layout_checks, struct_text

BACKENDS_HEADER_FILE: Final = HEADER_FILE.with_name("hil_backends.h")
BACKEND_STRUCTS: Final[dict[str, Fields]] = {
    "hil_backend_sample": BACKEND_SAMPLE_FIELDS,
    "hil_backend_pose": BACKEND_POSE_FIELDS,
    "hil_measurement": SENSOR_SAMPLE_FIELDS,
    "hil_navigation": NAVIGATION_FIELDS,
    "hil_reference": REFERENCE_FIELDS,
    "hil_navigation_input": NAVIGATION_INPUT_FIELDS,
    "hil_navigation_output": NAVIGATION_OUTPUT_FIELDS,
    "hil_control_input": CONTROL_INPUT_FIELDS,
    "hil_control_output": CONTROL_OUTPUT_FIELDS,
}
"""Tables by the names of their structs."""
_HEAD: Final = """\
/* hil_backends.h: records of backends of navigation and of control. Printed by: hil gnc header --backends
 *
 * A backend takes the place of the built-in navigation or the built-in control (docs/how-to/fly-a-law.md). Enumerations
 * and the setup are those of hil_gnc.h. SI units. Frames: H is Hill's (LVLH) frame of the target, c the chaser's body.
 * Quaternions have the scalar last; q_CH takes components in H to components in c.
 */
#ifndef HIL_BACKENDS_H
#define HIL_BACKENDS_H

#include "hil_gnc.h"

#ifdef __cplusplus
extern "C" {
#endif
"""
_FUNCTIONS: Final = """\
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
    known = {**BACKEND_STRUCTS, "hil_gnc_setup": GNC_SETUP_FIELDS}
    structs = [struct_text(struct, known) for struct in BACKEND_STRUCTS]
    version = f"#define HIL_BACKENDS_PROTOCOL {BACKEND_PROTOCOL}\n"
    return "\n".join([_HEAD, version, *structs, _FUNCTIONS, layout_checks(BACKEND_STRUCTS), TAIL])
