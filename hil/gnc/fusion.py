"""Both filters with a memory, so that a pose is fused at its own time however late it arrives.

The last steps are kept, as many as ``new_memory`` holds: the IMU's sample of each, the predicted filters, and the
poses of that moment. A pose is assigned to the step nearest to its exposure; the filters return to that step and are
propagated forward again over the same samples and poses. The result is that of a filter that had waited for
the pose.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import POSE
from hil.gnc import akf, akf_additive, pkf
from hil.gnc.akf import AKF_PARAMS, AKF_STATE
from hil.gnc.akf_additive import AKF_ADDITIVE_STATE
from hil.gnc.pkf import PKF_PARAMS, PKF_STATE
from hil.gnc.target_orbit import HILL_STEP, TARGET_ORBIT, move_hill_frame
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, copy_matrix

POSES_PER_STEP = 2

NOT_GATED, REJECTED, ATTITUDE_ONLY, ACCEPTED = range(4)

MULTIPLICATIVE = 0
AS_PRINTED = 1

FUSION_PARAMS = np.dtype(
    [
        ("attitude_form", "i8"),
        ("memory", "i8"),  # steps that are kept
        ("ahead", "i8"),  # steps that an exposure may be in the future: stamps and cycles are rounded
        ("orbit", TARGET_ORBIT),
        ("akf", AKF_PARAMS),
        ("pkf", PKF_PARAMS),
    ],
    align=True,
)

FILTERS = np.dtype([("akf", AKF_STATE), ("additive", AKF_ADDITIVE_STATE), ("pkf", PKF_STATE)], align=True)

STEP = np.dtype(
    [
        ("rate_C", "f8", 3),  # the IMU's sample of the step that ended here
        ("force_C", "f8", 3),
        ("hill", HILL_STEP),
        ("predicted", FILTERS),  # before the poses of this moment
        ("n_poses", "i8"),
        ("is_start", "i8"),  # the filters were started here
        ("first", POSE),
        ("second", POSE),
        ("first_gated", "i8"),  # result of the gate: NOT_GATED, or the part that was accepted
        ("second_gated", "i8"),
    ],
    align=True,
)

FUSION_STATE = np.dtype(
    [
        ("started", "i8"),
        ("cycle", "i8"),  # number of the present step
        ("start_cycle", "i8"),
        ("filters", FILTERS),
        ("accepted", "i8"),
        ("rejected_position", "i8"),  # by the gate on the innovation
        ("rejected_attitude", "i8"),
        ("duplicates", "i8"),
        ("too_late", "i8"),
        ("rejected_in_a_row", "i8"),  # consecutive rejections
        ("nis_position", "f8"),
        ("nis_attitude", "f8"),
    ],
    align=True,
)

_REOPEN_AFTER = 8  # consecutive rejections, after which the filter counts as wrong and the next pose is accepted


def new_memory(params: np.record) -> np.ndarray:
    """Return the zeroed memory of filters with FUSION_PARAMS ``params``, (n,) of STEP."""
    return np.zeros(int(params.memory), STEP)


@kernel
def _copy_attitude(source, target):
    """Copy either attitude filter; the two differ in the size of ``p`` alone."""
    copy_into(target.x, source.x)
    copy_into(target.w_CH_C, source.w_CH_C)
    copy_matrix(target.p, source.p)


@kernel
def _copy_filters(params, source, target):
    _copy_attitude(source.akf, target.akf)
    if params.attitude_form == AS_PRINTED:
        _copy_attitude(source.additive, target.additive)
    copy_into(target.pkf.x, source.pkf.x)
    copy_matrix(target.pkf.p, source.pkf.p)
    copy_matrix(target.pkf.c, source.pkf.c)


@kernel
def _copy_pose(source, target):
    copy_into(target.z_TC_C, source.z_TC_C)
    copy_into(target.q_CH, source.q_CH)
    target.t_s = source.t_s
    copy_matrix(target.covariance_position, source.covariance_position)
    copy_matrix(target.covariance_attitude, source.covariance_attitude)


@kernel
def _start(params, pose, filters):
    akf.start(params.akf, pose, filters.akf)
    pkf.start(params.pkf, pose, filters.akf.p, filters.pkf)
    if params.attitude_form == AS_PRINTED:
        akf_additive.from_multiplicative(filters.akf.x, filters.akf.p, filters.additive)


@kernel
def _predict(params, filters, step):
    """Carry both filters over ``step`` (STEP)."""
    middle = stack.vector(4)
    copy_into(middle, filters.akf.x[0:4])
    akf.predict_state(params.akf, filters.akf, step.rate_C, step.hill)
    additive = params.attitude_form == AS_PRINTED
    if additive:
        akf_additive.predict(params.akf, filters.additive, step.rate_C, step.hill)
        copy_into(filters.akf.x, filters.additive.x)
    for i in range(4):
        middle[i] += filters.akf.x[i]
    quat.normalise(middle)
    # with the attitude's covariance as it was before the step
    pkf.predict(params.pkf, filters.pkf, step.force_C, middle, filters.akf.p, filters.akf.phi, step.hill)
    if additive:
        _publish_additive(filters)
    else:
        akf.predict_covariance(params.akf, filters.akf)


@kernel
def _publish_additive(filters):
    """Write state and covariance (in c) of the additive filter into the multiplicative one's records."""
    copy_into(filters.akf.x, filters.additive.x)
    copy_into(filters.akf.w_CH_C, filters.additive.w_CH_C)
    akf_additive.error_covariance(filters.additive, filters.akf.p)


@kernel
def _fuse_pose(params, state, pose, moment_s, gated):
    """Fuse one pose whose step is at ``moment_s``; return the part that was accepted.

    gated: NOT_GATED for a new pose, which is then gated and counted; otherwise the earlier result of the gate.
    """
    filters = state.filters
    delta_s = pose.t_s - moment_s
    rotation, z, back, q_measured = stack.vector(3), stack.vector(3), stack.vector(4), stack.vector(4)
    for i in range(3):
        rotation[i] = -delta_s * filters.akf.w_CH_C[i]
    # c at the filter's moment, from c at the exposure
    quat.from_rotation_vector_into(rotation, back)
    quat.multiply_into(back, pose.q_CH, q_measured)
    quat.transform_into(back, pose.z_TC_C, z)
    gain_a, innovation_a = stack.matrix(6, 3), stack.vector(3)
    gain_p, innovation_p = stack.matrix(9, 3), stack.vector(3)
    h, h_attitude = stack.matrix(3, 9), stack.matrix(3, 3)
    open_gate = state.rejected_in_a_row >= _REOPEN_AFTER
    nis_a = akf.innovate(filters.akf, q_measured, pose.covariance_attitude, gain_a, innovation_a)
    nis_p = np.nan
    found = gated
    if gated == NOT_GATED:
        found = ATTITUDE_ONLY if open_gate or nis_a <= params.akf.gate else REJECTED
    if found >= ATTITUDE_ONLY:
        if params.attitude_form == AS_PRINTED:
            akf_additive.update(filters.additive, q_measured, pose.covariance_attitude)
        akf.update(filters.akf, pose.covariance_attitude, gain_a, innovation_a)
        if params.attitude_form == AS_PRINTED:
            _publish_additive(filters)
        pkf.follow_attitude_update(filters.pkf, filters.akf.keep)
        nis_p = pkf.innovate(
            filters.pkf, z, pose.covariance_position, delta_s, filters.akf.x[0:4], filters.akf.p,
            h, h_attitude, gain_p, innovation_p,
        )  # fmt: skip
        if gated == NOT_GATED and (open_gate or nis_p <= params.pkf.gate):
            found = ACCEPTED
        if found == ACCEPTED:
            pkf.update(filters.pkf, pose.covariance_position, filters.akf.p, h, h_attitude, gain_p, innovation_p)
    if gated == NOT_GATED:
        _count(state, found, nis_a, nis_p)
    return found


@kernel
def _count(state, found, nis_attitude, nis_position):
    """Count a pose that has just been gated."""
    state.nis_attitude = nis_attitude
    state.nis_position = nis_position
    if found == REJECTED:
        state.rejected_attitude += 1
    elif found == ATTITUDE_ONLY:
        state.rejected_position += 1
    else:
        state.accepted += 1
    state.rejected_in_a_row = 0 if found == ACCEPTED else state.rejected_in_a_row + 1


@kernel
def _place(params, state, memory, pose):
    """Put a pose into the step nearest to its exposure; return that step's number, or -1 if there is none."""
    cycle = math.floor(pose.t_s / params.pkf.dt_s + 0.5)
    if cycle > state.cycle + params.ahead:  # the unit's clock runs ahead: the moment of exposure is unknown
        state.too_late += 1
        return -1
    cycle = min(cycle, state.cycle)
    oldest = max(0, state.cycle - memory.shape[0] + 1)
    if state.started != 0:
        oldest = max(oldest, state.start_cycle)
    if cycle < oldest:
        state.too_late += 1
        return -1
    step = memory[cycle % memory.shape[0]]
    # the pose that started the filters is ``first`` but not counted as one to fuse
    held = step.n_poses + step.is_start
    if (held > 0 and abs(step.first.t_s - pose.t_s) < 1e-6) or (held > 1 and abs(step.second.t_s - pose.t_s) < 1e-6):
        state.duplicates += 1
        return -1
    if held >= POSES_PER_STEP:
        state.too_late += 1
        return -1
    if held == 0:
        _copy_pose(pose, step.first)
        step.first_gated = NOT_GATED
    else:
        _copy_pose(pose, step.second)
        step.second_gated = NOT_GATED
    if state.started == 0:
        step.is_start = 1
        state.started = 1
        state.start_cycle = cycle
        _start(params, pose, step.predicted)
    else:
        step.n_poses += 1
    return cycle


@kernel
def _fuse_step(params, state, step, moment_s):
    """Fuse all poses of ``step``."""
    if step.is_start == 0 and step.n_poses > 0:
        step.first_gated = _fuse_pose(params, state, step.first, moment_s, step.first_gated)
    if step.n_poses + step.is_start > 1:
        step.second_gated = _fuse_pose(params, state, step.second, moment_s, step.second_gated)


@kernel
def advance(params, state, memory, imu):
    """Begin the next step: keep its IMU sample and carry the filters over it.

    memory: of ``new_memory``. The very first step has no sample before it.
    """
    step = memory[state.cycle % memory.shape[0]]
    copy_into(step.rate_C, imu.rate_C)
    copy_into(step.force_C, imu.force_C)
    move_hill_frame(params.orbit, (state.cycle - 1) * params.pkf.dt_s, params.pkf.dt_s, step.hill)
    step.n_poses = 0
    step.is_start = 0
    state.nis_position = np.nan
    state.nis_attitude = np.nan
    if state.started != 0:
        _predict(params, state.filters, step)
        _copy_filters(params, state.filters, step.predicted)


@kernel
def fuse(params, state, memory, pose):
    """Fuse a pose (POSE) at its own time: back to its step, and forward again."""
    first = _place(params, state, memory, pose)
    if first < 0:
        return
    dt, n = params.pkf.dt_s, memory.shape[0]
    _copy_filters(params, memory[first % n].predicted, state.filters)
    _fuse_step(params, state, memory[first % n], first * dt)
    for cycle in range(first + 1, state.cycle + 1):
        step = memory[cycle % n]
        _predict(params, state.filters, step)
        _copy_filters(params, state.filters, step.predicted)
        _fuse_step(params, state, step, cycle * dt)
