"""Between the records of the cycle and those of a GNC that is not ours: what it is told, and what it answers.

The loop and a campaign's compiled loop call the same kernels. See ``hil/core/gnc_records.py`` for the records.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.gnc import allocation, guidance
from hil.gnc.approach_monitor import ORDERED
from hil.maths.arrays import copy_into, copy_matrix, fill

FINE, CYCLE, STATE, DIRECT, FORCE, TORQUE, THRUSTER, CLAIM, POSITION, VELOCITY, ATTITUDE, RATE = range(12)
"""What is wrong with an output; FINE: nothing."""

STARTING, WORKING, ASKS_FOR_HOLD, FAULT = range(4)
"""GncState, as numbers for the kernels."""

_NORM_TOLERANCE = 1e-3  # of an estimated quaternion


@kernel
def write_input(cycle, t_s, mode, orders, imu, reference, poses, n_poses, out):
    """Write ``out`` (GNC_INPUT). poses: array of POSE, of which the first ``n_poses`` came since the last input."""
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
    out.n_poses = n_poses
    for i in range(n_poses):
        told, pose = out.poses[i], poses[i]
        told.t_s = pose.t_s
        copy_into(told.r_TC_C_m, pose.z_TC_C)
        copy_into(told.q_CH, pose.q_CH)
        copy_matrix(told.covariance_position_m2, pose.covariance_position)
        copy_matrix(told.covariance_attitude_rad2, pose.covariance_attitude)


@kernel
def clear_output(out, cycle):
    """Make ``out`` (GNC_OUTPUT) the answer to the input ``cycle`` of a GNC that works and demands nothing."""
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


@kernel
def _bad(values):
    """Return the place of the first of ``values`` that is not finite, -1 where all are."""
    for i in range(values.shape[0]):
        if not np.isfinite(values[i]):
            return i
    return -1


@kernel
def _bad_demand(values):
    for i in range(values.shape[0]):
        if not -1 <= values[i] <= 1:
            return i
    return -1


@kernel
def _bad_claim(out):
    """Return (what, place) of the first fault of an estimate."""
    place = _bad(out.r_CT_H_m)
    if place >= 0:
        return POSITION, place
    place = _bad(out.v_CT_H_mps)
    if place >= 0:
        return VELOCITY, place
    place = _bad(out.w_CH_C_radps)
    if place >= 0:
        return RATE, place
    square = 0.0
    for i in range(4):
        square += out.q_CH[i] * out.q_CH[i]
    if not abs(square - 1.0) <= 2.0 * _NORM_TOLERANCE:
        return ATTITUDE, 0
    return FINE, 0


@kernel
def fault_of(out, cycle, n_thrusters):
    """Return (what, where) is wrong with ``out`` (GNC_OUTPUT), an answer to the input ``cycle``; (FINE, 0) for nothing.

    Of a GNC that is starting or reports a fault the demands are not looked at.
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
        return CLAIM, 0
    if out.estimate == 1:
        return _bad_claim(out)
    return FINE, 0


@kernel
def take_output(out, sets, n_thrusters, boost, navigation, command):
    """Write NAVIGATION and COMMAND from ``out`` (GNC_OUTPUT), which has no fault.

    sets: int64 (allocation.ROWS, 2, MAX_THRUSTERS). boost: as the reference has it.
    """
    if out.state == STARTING or out.state == FAULT:
        mark_invalid(navigation)
        rest(command)
        return
    take_estimate(out, navigation)
    command.boost = boost
    if out.direct != 0:
        fill(command.force, 0)
        fill(command.torque, 0)
        for i in range(n_thrusters):
            command.on[i] = out.on[i]
        return
    for i in range(3):
        command.force[i] = out.force[i]
        command.torque[i] = out.torque[i]
    allocation.select(sets, n_thrusters, command)


@kernel
def take_estimate(out, navigation):
    """Write NAVIGATION from the estimate of ``out`` (GNC_OUTPUT): without covariance; not valid where there is none."""
    mark_invalid(navigation)
    if out.estimate == 0:
        return
    navigation.valid = 1
    copy_into(navigation.r_CT_H, out.r_CT_H_m)
    copy_into(navigation.v_CT_H, out.v_CT_H_mps)
    copy_into(navigation.q_CH, out.q_CH)
    copy_into(navigation.w_CH_C, out.w_CH_C_radps)


@kernel
def mark_invalid(navigation):
    """Write NAVIGATION of somebody who does not say where the chaser is."""
    navigation.valid = 0
    fill(navigation.r_CT_H, np.nan)
    fill(navigation.v_CT_H, np.nan)
    fill(navigation.q_CH, np.nan)
    fill(navigation.w_CH_C, np.nan)
    fill(navigation.sigma_r_m, np.nan)
    fill(navigation.sigma_v_mps, np.nan)
    fill(navigation.sigma_attitude_rad, np.nan)
    navigation.nis_position = np.nan
    navigation.nis_attitude = np.nan


@kernel
def rest(command):
    """Close all thrusters of COMMAND."""
    fill(command.force, 0)
    fill(command.torque, 0)
    fill(command.on, 0)


@kernel
def abort_unseen(params, guidance_params, flown, t_s, reference, ordered, found):
    """Begin the abort that is ordered where nobody says where the chaser is; return whether one begins now.

    It starts from where the plan has the chaser. params: SUPERVISION_PARAMS. reference: REFERENCE, written anew.
    """
    found.corridor_margin_m = found.closing_margin_mps = np.nan
    if found.aborted != 0 or not (ordered != 0 or t_s >= params.abort_at_s):
        return False
    found.aborted = ORDERED
    found.aborted_at_s = t_s
    from_H, speed_H = reference.r_CT_H.copy(), reference.v_CT_H.copy()
    guidance.start_abort(guidance_params, flown, t_s, from_H, speed_H)
    guidance.reference(guidance_params, flown, t_s, reference)
    return True
