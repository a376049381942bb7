"""Reception of the vision unit's frames: plumes and faults on their way, and the poses of a cycle.

params and state: LOOP_PARAMS and LOOP_STATE of the loop (``hil.loop.core``), with VMU_RECEPTION in ``state.vmu``.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_POSES
from hil.maths.record_view import copy_record
from hil.models.camera_timing import TIME_SLACK_S
from hil.sensors.mounting import chaser_pose
from hil.sensors.vision_unit.faults import VMU_MEMORY, disturb_frame, see_through_plume
from hil.sensors.vision_unit.transit import next_arrival

VMU_RECEPTION = np.dtype(
    [
        ("faults", VMU_MEMORY),
        ("not_before_s", "f8"),  # frames exposed before this bench time are stale and not used
        ("delayed", "i8"),  # frames received that faults of the unit delay
        ("arrived_s", "f8", MAX_POSES),  # when the poses of this cycle were received, bench time
        ("dropped", "i8"),  # frames beyond MAX_POSES in one cycle
        ("logged", "i8"),  # rows of ARRIVAL written
    ],
    align=True,
)


@kernel
def _delay_frames(params, state, frames, n, delayed):
    """Pass the frames that were received through plumes and the faults of the vision unit, into ``delayed``."""
    plume = params.dss.plume
    for i in range(n):
        frame = frames[i]
        if plume.dimming > 0.0 and not see_through_plume(
            plume, state.truth_memory.plume, params.vmu_faults.seed, state.zero_s, frame
        ):
            continue
        if disturb_frame(params.vmu_faults, params.mounting, state.zero_s, state.vmu.faults, frame):
            copy_record(frame, delayed[state.vmu.delayed])
            state.vmu.delayed += 1


@kernel
def _write_pose(params, state, frame, arrived, poses):
    """Write ``frame`` as one more of ``poses``, of which the last MAX_POSES are kept; return how many there are."""
    if arrived == MAX_POSES:
        for j in range(MAX_POSES - 1):
            copy_record(poses[j + 1], poses[j])
            state.vmu.arrived_s[j] = state.vmu.arrived_s[j + 1]
        arrived -= 1
        state.vmu.dropped += 1
    pose = poses[arrived]
    chaser_pose(params.mounting, frame.t_v, frame.q_vt, frame.covariance, pose)
    pose.t_s = frame.t_s - state.zero_s
    pose.status = frame.status
    state.vmu.arrived_s[arrived] = frame.received_s
    return arrived + 1


@kernel
def _record_newest(state, poses, arrived):
    """Write the newest of the poses into the present row."""
    now = state.now
    if arrived > 0:
        newest = 0
        for i in range(1, arrived):
            if poses[i].t_s > poses[newest].t_s:
                newest = i
        copy_record(poses[newest], now.pose)
        now.received_s = state.vmu.arrived_s[newest] - state.zero_s
    now.pose.fresh = arrived


@kernel
def _log_poses(state, poses, arrived, logged, arrivals):
    """Add the poses to the rows of their frames, from ``logged`` on; a frame that was dropped was used by no cycle."""
    newest = arrived
    for row in range(state.vmu.logged - 1, logged - 1, -1):
        if arrivals[row].cycle < 0:
            continue
        newest -= 1
        if newest >= 0:
            copy_record(poses[newest], arrivals[row].pose)
        else:
            arrivals[row].cycle = -1


@kernel
def receive(params, state, now_s, frames, n, shows, delayed, poses, arrivals):
    """Write the poses of the first ``n`` frames, in the order of arrival, into ``poses`` (MAX_POSES,); return how many.

    The newest one goes into the present row. Of more than MAX_POSES the last ones are kept. shows: whether the bench
    shows the target where it is. delayed: of VMU_FRAME, received and not yet passed on; used if the unit has faults or
    plumes dim its LEDs. arrivals: of ARRIVAL, receives every frame; (0,) for none.
    """
    arrived, taken, logged = 0, 0, state.vmu.logged
    has_faults = params.vmu_faults.n != 0 or params.dss.plume.dimming > 0.0
    if has_faults:
        _delay_frames(params, state, frames, n, delayed)
    while True:
        i = taken
        if has_faults:
            i = next_arrival(delayed, 0, state.vmu.delayed)
            if i < 0 or delayed[i].received_s > now_s + TIME_SLACK_S:
                break
        elif taken == n:
            break
        frame = delayed[i] if has_faults else frames[i]
        used = shows and frame.t_s >= state.vmu.not_before_s
        if used:
            arrived = _write_pose(params, state, frame, arrived, poses)
        if state.vmu.logged < arrivals.shape[0]:
            row = arrivals[state.vmu.logged]
            copy_record(frame, row.frame)
            row.cycle = state.cycle if used else -1
            state.vmu.logged += 1
        if has_faults:
            state.vmu.delayed -= 1
            if i < state.vmu.delayed:
                copy_record(delayed[state.vmu.delayed], delayed[i])
        taken += 1
    _record_newest(state, poses, arrived)
    _log_poses(state, poses, arrived, logged, arrivals)
    return arrived
