"""Stages 4 to 7 of the compiled loop where a shared library flies: as ``ForeignGnc.act`` does it, call for call."""

from __future__ import annotations

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT
from hil.core.jit import kernel
from hil.gnc import approach_monitor, guidance
from hil.gnc_backends import external_records, library_call
from hil.maths.limits import has_held

LIBRARY = np.dtype(
    [
        ("step_address", "i8"),  # of hil_gnc_step; 0: the GNC here flies
        ("instance", "i8"),  # what hil_gnc_open gave
        ("input", GNC_INPUT),
        ("output", GNC_OUTPUT),
        ("abort_began", "i8"),  # in the cycle before
        ("asks_for_hold", "i8"),
        # what was wrong with the output
        ("code", "i8"),  # what the step returned
        ("fault", "i8"),  # of foreign.fault_of
        ("place", "i8"),
    ],
    align=True,
)

_RUNNING, _ABORT = 2, 2  # GncMode, GncOrder


@kernel
def fly_by_library(params, state, sets, poses, arrived, k, t_s):
    """Ask the library and supervise what it says; return whether it can go on.

    params: LOOP_PARAMS. state: LOOP_STATE. sets: int64 (allocation.ROWS, 2, MAX_THRUSTERS). k: number of the cycle.
    """
    now, gnc = state.now, state.library
    found = now.supervision
    go = found.aborted == 0 and has_held(found.ready_since_s, t_s, params.dwell_s)
    guidance.advance(params.guidance, state.flown, t_s, 0, 0 if go else 1)
    guidance.reference(params.guidance, state.flown, t_s, now.reference)
    orders = _ABORT if gnc.abort_began != 0 else 0
    external_records.write_input(k, t_s, _RUNNING, orders, now.imu, now.reference, poses, arrived, gnc.input)
    gnc.code = library_call.step(gnc.step_address, gnc.instance, gnc.input, gnc.output)
    gnc.fault, gnc.place = external_records.fault_of(gnc.output, k, params.n_thrusters)
    if gnc.code != 0 or gnc.fault != external_records.FINE or gnc.output.state == external_records.FAULT:
        return False
    if gnc.output.state == external_records.ASKS_FOR_HOLD:
        gnc.asks_for_hold = 1
    external_records.take_output(gnc.output, sets, params.n_thrusters, now.reference.boost, now.navigation, now.command)
    aborted = found.aborted
    if now.navigation.valid == 0:
        external_records.abort_unseen(params.supervision, params.guidance, state.flown, t_s, now.reference, 0, found)
    approach_monitor.supervise_and_act(
        params.supervision, params.guidance, state.flown, t_s, now.navigation, now.reference, 0, found
    )
    gnc.abort_began = 1 if found.aborted != aborted else 0
    now.nees_position = now.nees_attitude = np.nan
    return True
