"""Input and output of an external GNC: written from, checked and read into the records of the cycle.

The loop and a campaign's compiled loop call the same kernels, also to call a shared library. See
``hil/core/gnc_records.py`` for the records.
"""

from __future__ import annotations

import numpy as np
from numba import typeof, types

from hil.core.foreign_call import call_address
from hil.core.gnc_records import GncHealth, GncState
from hil.core.jit import kernel
from hil.core.messages import POSITION_ONLY
from hil.gnc import allocation
from hil.gnc.backend_step import first_not_finite
from hil.gnc.backend_step import mark_invalid as mark_invalid
from hil.maths.arrays import copy_into, fill
from hil.sensors.vision_unit.pose import write_sent

FINE, CYCLE, STATE, DIRECT, FORCE, TORQUE, THRUSTER, ESTIMATE, POSITION, VELOCITY, ATTITUDE, RATE = range(12)
PROTECTION_LEVEL, HEALTH = 12, 13
"""Faults of an output; FINE: none."""

STARTING, WORKING, ASKS_FOR_HOLD, FAULT = (state.value for state in GncState)
"""GncState, as numbers for the kernels."""

HEALTH_MAX = sum(bit.value for bit in GncHealth)
_NORM_TOLERANCE = 1e-3  # of an estimated quaternion


@kernel
def write_input(cycle, t_s, mode, orders, imu, reference, poses, n_poses, out):
    """Write ``out`` (GNC_INPUT). poses: array of POSE, of which the first ``n_poses`` came since the last input.

    Those whose attitude is a guess are left out: GNC_INPUT has no status of a pose.
    """
    out.cycle = cycle
    out.t_s = t_s
    out.mode = mode
    out.orders = orders
    copy_into(out.rate_radps, imu.rate_C)
    copy_into(out.force_mps2, imu.force_C)
    copy_into(out.reference_r_CT_H_m, reference.r_CT_H)
    copy_into(out.reference_v_CT_H_mps, reference.v_CT_H)
    copy_into(out.reference_a_CT_H_mps2, reference.a_CT_H)
    copy_into(out.reference_q_CH, reference.q_CH)
    out.boost = reference.boost
    out.n_poses = 0
    for i in range(n_poses):
        if poses[i].status != POSITION_ONLY:
            write_sent(poses[i], out.poses[out.n_poses])
            out.n_poses += 1


@kernel
def clear_output(out, cycle):
    """Make ``out`` (GNC_OUTPUT) the answer to the input ``cycle`` with state WORKING and without demands."""
    out.cycle = cycle
    out.state = WORKING
    out.direct = 0
    out.estimate = 0
    fill(out.force, 0)
    fill(out.torque, 0)
    fill(out.on, 0)
    fill(out.r_CT_H_m, 0.0)
    fill(out.v_CT_H_mps, 0.0)
    fill(out.q_CH, 0.0)
    fill(out.w_CH_C_radps, 0.0)
    fill(out.protection_level_m, 0.0)
    out.protection_level_rad = 0.0
    out.health = 0


@kernel
def _bad_demand(values):
    """Return the index of the first of ``values`` that is not -1, 0 or 1, -1 if there is none."""
    for i in range(values.shape[0]):
        if not -1 <= values[i] <= 1:
            return i
    return -1


@kernel
def _bad_estimate(out):
    """Return (fault, index) of an estimate; (FINE, 0) if there is none."""
    place = first_not_finite(out.r_CT_H_m)
    if place >= 0:
        return POSITION, place
    place = first_not_finite(out.v_CT_H_mps)
    if place >= 0:
        return VELOCITY, place
    place = first_not_finite(out.w_CH_C_radps)
    if place >= 0:
        return RATE, place
    square = 0.0
    for i in range(4):
        square += out.q_CH[i] * out.q_CH[i]
    if not abs(square - 1.0) <= 2.0 * _NORM_TOLERANCE:
        return ATTITUDE, 0
    for i in range(3):
        if out.protection_level_m[i] < 0.0:
            return PROTECTION_LEVEL, i
    if out.protection_level_rad < 0.0:
        return PROTECTION_LEVEL, 3
    if not 0 <= out.health <= HEALTH_MAX:
        return HEALTH, 0
    return FINE, 0


@kernel
def fault_of(out, cycle, n_thrusters):
    """Return (fault, index) of ``out`` (GNC_OUTPUT), an answer to the input ``cycle``; (FINE, 0) if there is none.

    Demands are not checked while the GNC is starting or reports a fault.
    """
    if out.cycle != cycle:
        return CYCLE, 0
    if not STARTING <= out.state <= FAULT:
        return STATE, 0
    if out.state == STARTING or out.state == FAULT:
        return FINE, 0
    if out.direct != 0 and out.direct != 1:
        return DIRECT, 0
    if out.direct == 0:
        place = _bad_demand(out.force)
        if place >= 0:
            return FORCE, place
        place = _bad_demand(out.torque)
        if place >= 0:
            return TORQUE, place
    else:
        for i in range(out.on.shape[0]):
            if out.on[i] > 1 or (out.on[i] != 0 and i >= n_thrusters):
                return THRUSTER, i
    if out.estimate != 0 and out.estimate != 1:
        return ESTIMATE, 0
    if out.estimate == 1:
        return _bad_estimate(out)
    return FINE, 0


@kernel
def _level(reported):
    """Return a reported protection level, nan if there is none: a GNC that reports none leaves it zero."""
    return reported if reported > 0.0 else np.nan


@kernel
def read_output(out, params, boost, navigation, command):
    """Write NAVIGATION and COMMAND from ``out`` (GNC_OUTPUT), which has no fault.

    params: GNC_PARAMS, for the allocation of demands. boost: as in the reference.
    """
    mark_invalid(navigation)
    if out.state == STARTING or out.state == FAULT:
        close_thrusters(command)
        return
    if out.estimate != 0:
        navigation.valid = 1
        copy_into(navigation.r_CT_H, out.r_CT_H_m)
        copy_into(navigation.v_CT_H, out.v_CT_H_mps)
        copy_into(navigation.q_CH, out.q_CH)
        copy_into(navigation.w_CH_C, out.w_CH_C_radps)
        for i in range(3):
            navigation.protection_level_m[i] = _level(out.protection_level_m[i])
        navigation.protection_level_rad = _level(out.protection_level_rad)
        navigation.health = out.health
    command.boost = boost
    if out.direct != 0:
        fill(command.force, 0)
        fill(command.torque, 0)
        for i in range(params.n_thrusters):
            command.on[i] = out.on[i]
        return
    for i in range(3):
        command.force[i] = out.force[i]
        command.torque[i] = out.torque[i]
    allocation.select(params.sets, params.n_thrusters, command)


@kernel
def close_thrusters(command):
    """Write COMMAND without demands and with all thrusters closed."""
    fill(command.force, 0)
    fill(command.torque, 0)
    fill(command.on, 0)


@kernel
def call_library(address, instance, gnc_input, output):
    """Call the step of a GNC in a shared library; return its return value.

    address: of ``hil_gnc_step``. instance: as returned by ``hil_gnc_open``. gnc_input: GNC_INPUT. output: GNC_OUTPUT,
    zeroed but for the fields that a library may leave as they are: its cycle and its state, WORKING.
    """
    clear_output(output, gnc_input.cycle)
    return call_address(address, instance, gnc_input, output)


def compile_call(gnc_input, output):
    """Compile ``call_library`` for these records without calling a library."""
    call_library.compile((types.int64, types.int64, typeof(gnc_input), typeof(output)))
