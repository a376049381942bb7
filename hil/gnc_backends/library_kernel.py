"""Stages 4 to 7 of the cycle with a GNC in a shared library, in the order of ``ExternalGnc.step``."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.core.foreign_call import same_bytes
from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, GncMode, GncOrder
from hil.core.jit import entry, kernel
from hil.core.kernel_record import kernel_record
from hil.gnc.step import APPROACH_PROGRESS, guide, watch_approach
from hil.gnc_backends import external_records
from hil.maths.record_view import copy_record

_TEXT_BYTES = GNC_OUTPUT["text"].itemsize
_OUTPUT = np.dtype(
    [(name, ("u1", _TEXT_BYTES)) if name == "text" else (name, GNC_OUTPUT[name]) for name in GNC_OUTPUT.names or ()],
    align=True,
)
"""GNC_OUTPUT with its text as bytes, which kernels can compare."""
assert _OUTPUT.itemsize == GNC_OUTPUT.itemsize

LIBRARY = np.dtype(
    [
        ("step_address", "i8"),  # of hil_gnc_step; 0: the built-in GNC is used
        ("instance", "i8"),  # what hil_gnc_open gave
        ("input", GNC_INPUT),
        ("output", _OUTPUT),
        ("asks_for_hold", "i8"),
        ("last_text", "u1", _TEXT_BYTES),  # the one logged last
        ("guided", APPROACH_PROGRESS),  # progress of the approach after guidance
        # what was wrong with the output
        ("code", "i8"),  # what the step returned
        ("fault", "i8"),  # of external_records.fault_of
        ("place", "i8"),
    ],
    align=True,
)

_RUNNING, _GO, _ABORT = GncMode.RUNNING.value, GncOrder.GO.value, GncOrder.ABORT.value


@kernel
def has_new_text(library):
    """Return whether the text of the output is another one than ``last_text``."""
    return not same_bytes(library.output.text, library.last_text)


@entry
def library_step(params, library, approach, now, poses, n_poses, cycle, t_s):
    """Call the library between guidance and approach monitor; return False if its output is a fault.

    params: GNC_PARAMS. library: LIBRARY. approach: APPROACH_STATE. now: CYCLE. poses: array of POSE, of which the first
    ``n_poses`` are new.
    """
    progress, orders = approach.progress, _ABORT if approach.abort_began != 0 else 0
    ordered, phase = progress.go, progress.phase
    guide(params.approach, approach, t_s, now.supervision, now.reference)
    if ordered != 0 and progress.phase != phase:
        orders |= _GO
    copy_record(progress, library.guided)
    external_records.write_input(
        cycle, t_s, _RUNNING, orders, now.imu, now.reference, poses, n_poses, library.input
    )  # fmt: skip
    library.code = external_records.call_library(
        library.step_address, library.instance, library.input, library.output
    )  # fmt: skip
    library.fault, library.place = external_records.fault_of(library.output, cycle, params.n_thrusters)
    state, library.asks_for_hold = library.output.state, 0
    if library.code != 0 or library.fault != external_records.FINE or state == external_records.FAULT:
        return False
    if state == external_records.ASKS_FOR_HOLD:
        library.asks_for_hold = 1
    external_records.read_output(library.output, params, now.reference.boost, now.navigation, now.command)
    watch_approach(params.approach, approach, t_s, now.navigation, now.reference, now.supervision, True)
    return True


def output_of(library: np.record) -> np.record:
    """Return the output of ``library`` (LIBRARY) as GNC_OUTPUT, in the same memory."""
    output: Any = np.asarray(library)["output"].view(GNC_OUTPUT)
    return kernel_record(output)
