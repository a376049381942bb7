"""Closed loop as one compiled function, made of the kernels that the cycle calls (hil/loop/cycle.py).

Stage by stage and in the same order: the mock rig's axes, safety monitor, vision unit, GNC, truth, virtual IMU,
setpoints. Random numbers are those of the cycle's streams, drawn beforehand. A run here and one of ``hil run`` on the
mock rig are bit-equal, which a test checks. The result of a run is RUN_STATS; no memory grows with its length.
"""

from __future__ import annotations

import numpy as np

from hil.bench import guard as guards
from hil.bench import kinematics
from hil.bench.guard import BREACH, GUARD
from hil.bench.kinematics import BENCH_PARAMS, MOTION
from hil.core.jit import kernel
from hil.core.messages import AXES, CYCLE, MAX_POSES
from hil.dynamics import imu as imu_kernels
from hil.dynamics import truth as truth_kernels
from hil.dynamics.cached_gravity import CACHED_GRAVITY
from hil.dynamics.imu import IMU_PARAMS
from hil.dynamics.truth import DSS_PARAMS
from hil.dynamics.vision import VISION_PARAMS, measure
from hil.gnc import guidance, navigation
from hil.gnc.approach_monitor import APPROACH_MONITOR_PARAMS
from hil.gnc.ready_phase import READY_PARAMS
from hil.gnc.step import GNC_PARAMS, GNC_STATE, gnc_step
from hil.maths import stack
from hil.maths.arrays import copy_into, copy_matrix, fill
from hil.maths.limits import cut_to_range
from hil.models.camera import CAMERA
from hil.models.camera_timing import TIME_SLACK_S, TRAVEL, delays, exposure_time, first_exposure
from hil.models.mounting import MOUNTING, chaser_pose
from hil.models.servo import servo_step, servo_step_of_two
from hil.monte_carlo.library_kernel import LIBRARY, library_step
from hil.monte_carlo.run_stats import count_cycle, count_exposure

COMPLETED, FOLLOWING, TRAVEL_LEFT, VISION_SILENT, NOT_FINITE, GNC_FAILED, GNC_HOLDS = range(7)
"""Reasons for the end of a run; the second and third have their numbers in ``hil.bench.guard``."""

SERVO = np.dtype(
    [
        ("t_s", "f8"),  # time of position and rate
        ("position", "f8", 3),
        ("rate", "f8", 3),
        ("setpoint", "f8", 3),
        ("feedforward", "f8", 3),
        ("kp", "f8", 3),
        ("tau", "f8", 3),
        ("rate_max", "f8", 3),
        ("rate_min", "f8", 3),
        ("acceleration_max", "f8", 3),
        ("low", "f8", 3),
        ("high", "f8", 3),
    ],
    align=True,
)

LOOP_PARAMS = np.dtype(
    [
        ("cycles", "i8"),
        ("step_s", "f8"),
        ("vmu_rate_hz", "f8"),
        ("vmu_timeout_s", "f8"),
        ("steady_state_after_s", "f8"),  # navigation errors are counted from here on
        ("dss", DSS_PARAMS),
        ("imu", IMU_PARAMS),
        ("vision", VISION_PARAMS),
        ("travel", TRAVEL),
        ("mounting", MOUNTING),
        ("camera", CAMERA),
        ("bench", BENCH_PARAMS),
        ("guard", GUARD),
        ("gnc", GNC_PARAMS),
        ("verdict", APPROACH_MONITOR_PARAMS),  # margins of the verdict, whatever the GNC's own are
        ("ready", READY_PARAMS),
    ],
    align=True,
)

LOOP_STATE = np.dtype(
    [
        ("now", CYCLE),
        ("harmonics", CACHED_GRAVITY),
        ("rails", SERVO),
        ("turntable", SERVO),
        ("motion", MOTION),
        ("desired", AXES),
        ("next", AXES),
        ("before", AXES),  # the setpoint of the cycle before
        ("breach", BREACH),
        ("gnc", GNC_STATE),
        ("next_exposure", "i8"),
        ("first_exposure", "i8"),
        ("in_transit", "i8"),  # frames exposed and not received yet
        ("last_rx_s", "f8"),  # when the last frame was received
        ("library", LIBRARY),
    ],
    align=True,
)


@kernel
def _move_axes(axes, now_s):
    """Move three mock axes (SERVO) to ``now_s``, unless that is in the past."""
    left_s = now_s - axes.t_s
    if left_s <= 0.0:
        return
    axes.t_s = now_s
    servo_step(
        axes.position, axes.rate, axes.setpoint, axes.feedforward, axes.kp, axes.tau,
        axes.rate_max, axes.acceleration_max, axes.low, axes.high, left_s,
    )  # fmt: skip


@kernel
def _move_all(state, now_s):
    """Move rails and turntable to ``now_s``."""
    rails, turntable = state.rails, state.turntable
    left_s = now_s - rails.t_s
    if rails.t_s != turntable.t_s:
        _move_axes(rails, now_s)
        _move_axes(turntable, now_s)
    elif left_s > 0.0:
        rails.t_s = turntable.t_s = now_s
        servo_step_of_two(rails, turntable, left_s)


@kernel
def _send(axes, position, rate, now_s, accepted):
    """Set the setpoint of three mock axes; write the accepted one into ``accepted`` (3,). False if it is not finite."""
    feedforward = stack.vector(3)
    if cut_to_range(position, axes.low, axes.high, accepted) >= 0:
        return False
    if cut_to_range(rate, axes.rate_min, axes.rate_max, feedforward) >= 0:
        return False
    _move_axes(axes, now_s)
    copy_into(axes.setpoint, accepted)
    copy_into(axes.feedforward, feedforward)
    return True


@kernel
def _expose(params, state, until_s, vision_noise, travel_draws, leds, frames, stats):
    """Write the frames that the vision unit exposes up to ``until_s`` into ``frames``, in transit."""
    late = stack.vector(2)
    r, q = stack.vector(3), stack.vector(4)
    while True:
        t_s = exposure_time(state.next_exposure, params.vmu_rate_hz)
        if t_s > until_s:
            return
        row = state.next_exposure - state.first_exposure
        _move_all(state, t_s)
        kinematics.pose_of_axes(params.bench, state.rails.position, state.turntable.position, r, q)
        frame = frames[state.in_transit]
        measure(params.vision, params.mounting, r, q, vision_noise[row], frame.t_v, frame.q_vt, frame.covariance)
        count_exposure(params.camera, params.mounting, leds, r, q, stats)
        for copy in range(delays(params.travel, travel_draws[row], late)):
            sent = frames[state.in_transit]
            if copy > 0:
                frames[state.in_transit] = frames[state.in_transit - 1]
            sent.t_s = t_s
            sent.received_s = t_s + late[copy]
            sent.counter = 2 * row + copy
            state.in_transit += 1
        state.next_exposure += 1


@kernel
def _next_arrival(state, frames):
    """Return the index of the frame that arrives first, of equals the one sent first; -1 if there is none."""
    found = -1
    for i in range(state.in_transit):
        if (
            found < 0
            or frames[i].received_s < frames[found].received_s
            or (frames[i].received_s == frames[found].received_s and frames[i].counter < frames[found].counter)
        ):
            found = i
    return found


@kernel
def _receive_poses(params, state, now_s, frames, poses):
    """Write the poses that have arrived by ``now_s`` into ``poses`` (MAX_POSES,); return their number, -1 on timeout.

    Of more than MAX_POSES the last ones are kept.
    """
    arrived = 0
    while True:
        i = _next_arrival(state, frames)
        if i < 0 or frames[i].received_s > now_s + TIME_SLACK_S:
            break
        state.last_rx_s = frames[i].received_s
        if arrived == MAX_POSES:
            for j in range(MAX_POSES - 1):
                poses[j] = poses[j + 1]
            arrived -= 1
        chaser_pose(params.mounting, frames[i].t_v, frames[i].q_vt, frames[i].covariance, poses[arrived])
        poses[arrived].t_s = frames[i].t_s
        poses[arrived].status = frames[i].status
        arrived += 1
        state.in_transit -= 1
        if i < state.in_transit:
            frames[i] = frames[state.in_transit]
    if now_s - state.last_rx_s > params.vmu_timeout_s:
        return -1
    return arrived


@kernel
def _record_pose(state, poses, arrived):
    """Write the newest of the poses into the present row."""
    now = state.now
    now.pose.fresh = arrived
    if arrived == 0:
        return
    newest = 0
    for i in range(1, arrived):
        if poses[i].t_s > poses[newest].t_s:
            newest = i
    pose = poses[newest]
    copy_into(now.pose.z_TC_C, pose.z_TC_C)
    copy_into(now.pose.q_CH, pose.q_CH)
    copy_matrix(now.pose.covariance_position, pose.covariance_position)
    copy_matrix(now.pose.covariance_attitude, pose.covariance_attitude)
    copy_matrix(now.pose.covariance_cross, pose.covariance_cross)
    now.pose.status = pose.status
    now.pose.t_s = pose.t_s


@kernel
def _read_axes(state, now_s):
    """Write the encoders' values into the present row."""
    _move_all(state, now_s)
    rails, turntable = state.rails, state.turntable
    kinematics.write_axes(rails.position, rails.rate, turntable.position, turntable.rate, state.now.feedback)


@kernel
def _check_consistency(state):
    """Write the NEES of both filters in cycles in which they took a pose, nan otherwise."""
    now = state.now
    now.nees_position = now.nees_attitude = np.nan
    if state.gnc.fused != 0:
        nees = stack.vector(2)
        navigation.normalised_errors(state.gnc.navigation.fusion.filters, now.truth, now.imu, nees)
        now.nees_position, now.nees_attitude = nees[0], nees[1]


@kernel
def _send_setpoints(params, state, now_s):
    """Stage 11: setpoints for the truth's pose. Return how many were limited, -1 if one is not finite."""
    now = state.now
    rate = stack.vector(3)
    truth_kernels.rate_against_hill(now.truth, rate)
    truth = now.truth
    kinematics.axes_of_pose(params.bench, truth.r_CT_H, truth.v_CT_H, truth.q_CH, rate, state.desired)
    out = state.next
    limited = kinematics.limit_setpoint(params.bench, state.motion, state.desired, out)
    rails, gimbals = stack.vector(3), stack.vector(3)
    accepted = _send(state.rails, out.rail_m, out.rail_mps, now_s, rails) and _send(
        state.turntable, out.gimbal_rad, out.gimbal_radps, now_s, gimbals
    )
    if not accepted:
        return -1
    kinematics.write_axes(rails, out.rail_mps, gimbals, out.gimbal_radps, now.setpoint)
    kinematics.write_axes(rails, out.rail_mps, gimbals, out.gimbal_radps, state.before)
    return limited


@kernel
def _start(params, state):
    """Initialise ``state``, whose truth, IMU errors and axes are those at the start, for the first cycle."""
    guidance.start(params.gnc.approach.guidance, state.gnc.approach.guidance)
    _read_axes(state, 0.0)
    feedback = state.now.feedback
    rest = stack.vector(3)
    fill(rest, 0.0)
    kinematics.write_axes(feedback.rail_m, rest, feedback.gimbal_rad, rest, state.before)
    kinematics.start_motion(feedback.rail_m, feedback.gimbal_rad, state.motion)
    state.next_exposure = state.first_exposure = first_exposure(0.0, params.vmu_rate_hz)
    state.last_rx_s = params.travel.latency_s + params.travel.jitter_s


@kernel
def run_loop(params, field, leds, imu_noise, vision_noise, travel_draws, state, memory, poses, frames, stats, history):
    """Run the loop; return why it ended. ``stats`` (RUN_STATS) accumulates its statistics.

    params: LOOP_PARAMS. field: harmonics, measure
    ``moon_gravity.field_table``. leds: (n, 3), m, in t. imu_noise: (cycles, IMU_NOISE), vision_noise: (exposures,
    VISION_NOISE), standard normals; travel_draws: (exposures, TRAVEL_DRAWS), uniform. state: LOOP_STATE; zeroed but
    for ``now.truth``, the IMU's true errors in ``now.imu``, both SERVO, and the address and instance of a library.
    memory: (fusion.MEMORY,) of STEP, zeroed.
    poses: (MAX_POSES,) of POSE. frames: of VMU_FRAME, as many as can be on their way at once and two more, zeroed.
    history: (n,) of CYCLE, filled for the first n cycles.
    """
    now = state.now
    _start(params, state)
    for k in range(params.cycles):
        t_s = k * params.step_s
        _read_axes(state, t_s)
        broken = guards.first_breach(params.guard, state.before, now.feedback, state.breach)
        if broken != guards.NOTHING:
            return broken
        _expose(params, state, t_s + TIME_SLACK_S, vision_noise, travel_draws, leds, frames, stats)
        arrived = _receive_poses(params, state, t_s, frames, poses)
        if arrived < 0:
            return VISION_SILENT
        _record_pose(state, poses, arrived)
        if state.library.step_address == 0:
            gnc_step(
                params.gnc, state.gnc, memory, t_s, now.imu, poses, arrived,
                now.navigation, now.reference, now.supervision, now.command,
            )  # fmt: skip
        elif not library_step(params.gnc, state, poses, arrived, k, t_s):
            return GNC_FAILED
        _check_consistency(state)
        now.t_s = t_s
        count_cycle(params, state, stats)
        if k < history.shape[0]:
            history[k] = now
        truth_kernels.step(params.dss, field, state.harmonics, now.truth, now.command.on)
        imu_kernels.sample(params.imu, now.truth, imu_noise[k], now.imu)
        limited = _send_setpoints(params, state, t_s)
        if limited < 0:
            return NOT_FINITE
        if limited > 0:
            stats.limited_cycles += 1
        if state.library.asks_for_hold != 0:
            return GNC_HOLDS
    return COMPLETED
