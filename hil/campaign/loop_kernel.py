"""The whole closed loop as one compiled function, made of the kernels that the cycle calls (hil/loop/cycle.py).

Stage by stage and in the same order: the mock rig's axes, supervision of the bench, vision unit, filters,
guidance, control, truth, virtual IMU, setpoints. Random numbers are those of the cycle's streams, drawn
beforehand. A run here and one of ``hil run`` on the mock rig have the same bits, which a test holds.
What a run leaves is a TALLY; nothing grows with its length.
"""

from __future__ import annotations

import numpy as np

from hil.bench import guard as guards
from hil.bench import kinematics
from hil.bench.guard import BREACH, GUARD
from hil.bench.kinematics import BENCH_PARAMS, MOTION
from hil.campaign.library_kernel import LIBRARY, fly_by_library
from hil.campaign.tally_kernel import count_cycle, count_exposure
from hil.core.jit import kernel
from hil.core.messages import AXES, CYCLE, MAX_POSES
from hil.dynamics import imu as imu_kernels
from hil.dynamics import truth as truth_kernels
from hil.dynamics.held_gravity import CACHED_GRAVITY
from hil.dynamics.imu import IMU_PARAMS
from hil.dynamics.truth import DSS_PARAMS
from hil.dynamics.vision import VISION_PARAMS, see
from hil.gnc import allocation, approach_monitor, control, guidance, navigation
from hil.gnc.approach_monitor import SUPERVISION_PARAMS
from hil.gnc.control import CONTROL_PARAMS
from hil.gnc.guidance import GUIDANCE_PARAMS, GUIDANCE_STATE
from hil.gnc.navigation import NAVIGATION_PARAMS, NAVIGATION_STATE
from hil.gnc.ready_phase import READY_PARAMS
from hil.maths import stack
from hil.maths.arrays import copy_into, copy_matrix, fill
from hil.maths.limits import cut_to_range, has_held
from hil.models.camera import CAMERA
from hil.models.camera_timing import TIME_SLACK_S, TRAVEL, delays, exposure_time, first_exposure
from hil.models.mounting import MOUNTING, chaser_pose
from hil.models.servo import servo_step, servo_step_of_two

COMPLETED, FOLLOWING, TRAVEL_LEFT, VISION_SILENT, NOT_FINITE, GNC_FAILED, GNC_HOLDS = range(7)
"""Why a run ended; the second and third as ``hil.bench.guard`` numbers them."""

SERVO = np.dtype(
    [
        ("t_s", "f8"),  # up to which the axes have moved
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
        ("n_thrusters", "i8"),
        ("step_s", "f8"),
        ("dwell_s", "f8"),
        ("vmu_rate_hz", "f8"),
        ("vmu_timeout_s", "f8"),
        ("settled_s", "f8"),  # navigation counts from here on
        ("dss", DSS_PARAMS),
        ("imu", IMU_PARAMS),
        ("vision", VISION_PARAMS),
        ("travel", TRAVEL),
        ("mounting", MOUNTING),
        ("camera", CAMERA),
        ("bench", BENCH_PARAMS),
        ("guard", GUARD),
        ("navigation", NAVIGATION_PARAMS),
        ("guidance", GUIDANCE_PARAMS),
        ("supervision", SUPERVISION_PARAMS),  # as the GNC has it
        ("judged", SUPERVISION_PARAMS),  # as the verdict has it
        ("control", CONTROL_PARAMS),
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
        ("wanted", AXES),
        ("next", AXES),
        ("before", AXES),  # the setpoint of the cycle before
        ("breach", BREACH),
        ("navigation", NAVIGATION_STATE),
        ("flown", GUIDANCE_STATE),
        ("next_exposure", "i8"),
        ("first_exposure", "i8"),
        ("on_the_way", "i8"),  # frames exposed and not arrived
        ("heard_s", "f8"),  # when the vision unit was heard last
        ("fuses_now", "i8"),
        ("library", LIBRARY),
    ],
    align=True,
)


@kernel
def _move_axes(axes, now_s):
    """Move three mock axes (SERVO) on to ``now_s``; time that runs backwards moves nothing."""
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
    """Move rails and turntable on to ``now_s``."""
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
    """Give three mock axes their setpoint and write what they took into ``accepted`` (3,); False for a bad number."""
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
def _expose(params, state, until_s, vision_noise, travel_draws, leds, frames, tally):
    """Let the vision unit take what it sees up to ``until_s`` and send it on its way into ``frames``."""
    late = stack.vector(2)
    r, q = stack.vector(3), stack.vector(4)
    while True:
        t_s = exposure_time(state.next_exposure, params.vmu_rate_hz)
        if t_s > until_s:
            return
        row = state.next_exposure - state.first_exposure
        _move_all(state, t_s)
        kinematics.pose_of_axes(params.bench, state.rails.position, state.turntable.position, r, q)
        frame = frames[state.on_the_way]
        see(params.vision, params.mounting, r, q, vision_noise[row], frame.t_v, frame.q_vt, frame.covariance)
        count_exposure(params.camera, params.mounting, leds, r, q, tally)
        for copy in range(delays(params.travel, travel_draws[row], late)):
            sent = frames[state.on_the_way]
            if copy > 0:
                frames[state.on_the_way] = frames[state.on_the_way - 1]
            sent.t_s = t_s
            sent.received_s = t_s + late[copy]
            sent.counter = 2 * row + copy
            state.on_the_way += 1
        state.next_exposure += 1


@kernel
def _next_arrival(state, frames):
    """Return the place in ``frames`` of the one that arrives first, of equals the one sent first; -1 without any."""
    found = -1
    for i in range(state.on_the_way):
        if (
            found < 0
            or frames[i].received_s < frames[found].received_s
            or (frames[i].received_s == frames[found].received_s and frames[i].counter < frames[found].counter)
        ):
            found = i
    return found


@kernel
def _take_poses(params, state, now_s, frames, poses):
    """Write the poses that have arrived by ``now_s`` into ``poses`` (MAX_POSES,); return how many, -1 after a silence.

    Of more than MAX_POSES the last ones stay.
    """
    arrived = 0
    while True:
        i = _next_arrival(state, frames)
        if i < 0 or frames[i].received_s > now_s + TIME_SLACK_S:
            break
        state.heard_s = frames[i].received_s
        if arrived == MAX_POSES:
            for j in range(MAX_POSES - 1):
                poses[j] = poses[j + 1]
            arrived -= 1
        chaser_pose(params.mounting, frames[i].t_v, frames[i].q_vt, frames[i].covariance, poses[arrived])
        poses[arrived].t_s = frames[i].t_s
        poses[arrived].status = frames[i].status
        arrived += 1
        state.on_the_way -= 1
        if i < state.on_the_way:
            frames[i] = frames[state.on_the_way]
    if now_s - state.heard_s > params.vmu_timeout_s:
        return -1
    return arrived


@kernel
def _show_pose(state, poses, arrived):
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
def _navigate(params, state, memory, poses, arrived):
    """Stage 4: both filters, or vision alone."""
    now = state.now
    navigation.navigate(
        params.navigation, state.navigation, memory, now.imu, poses, arrived, now.navigation
    )  # fmt: skip
    state.fuses_now = 1 if arrived > 0 and params.navigation.sensors == navigation.VISION_AND_IMU else 0


@kernel
def _decide(params, state, sets, t_s):
    """Stages 5 to 7: guidance, supervision of the approach, control; and how consistent the filters are."""
    now = state.now
    found = now.supervision
    go = found.aborted == 0 and has_held(found.ready_since_s, t_s, params.dwell_s)
    guidance.advance(params.guidance, state.flown, t_s, 0, 0 if go else 1)
    guidance.reference(params.guidance, state.flown, t_s, now.reference)
    approach_monitor.supervise_and_act(
        params.supervision, params.guidance, state.flown, t_s, now.navigation, now.reference, 0, found
    )
    control.control(params.control, now.navigation, now.reference, now.command)
    allocation.select(sets, params.n_thrusters, now.command)
    now.nees_position = now.nees_attitude = np.nan
    if state.fuses_now != 0:
        nees = stack.vector(2)
        navigation.normalised_errors(state.navigation.fusion.filters, now.truth, now.imu, nees)
        now.nees_position, now.nees_attitude = nees[0], nees[1]


@kernel
def _follow(params, state, now_s):
    """Stage 11: setpoints towards the truth's pose. Returns how many were limited, -1 where one is not finite."""
    now = state.now
    rate = stack.vector(3)
    truth_kernels.rate_against_hill(now.truth, rate)
    truth = now.truth
    kinematics.axes_of_pose(params.bench, truth.r_CT_H, truth.v_CT_H, truth.q_CH, rate, state.wanted)
    out = state.next
    limited = kinematics.limit_setpoint(params.bench, state.motion, state.wanted, out)
    rails, gimbals = stack.vector(3), stack.vector(3)
    fine = _send(state.rails, out.rail_m, out.rail_mps, now_s, rails) and _send(
        state.turntable, out.gimbal_rad, out.gimbal_radps, now_s, gimbals
    )
    if not fine:
        return -1
    kinematics.write_axes(rails, out.rail_mps, gimbals, out.gimbal_radps, now.setpoint)
    kinematics.write_axes(rails, out.rail_mps, gimbals, out.gimbal_radps, state.before)
    return limited


@kernel
def _begin(params, state):
    """Bring ``state``, whose truth, IMU errors and axes stand at the start, to the first cycle."""
    guidance.start(params.guidance, state.flown)
    _read_axes(state, 0.0)
    feedback = state.now.feedback
    rest = stack.vector(3)
    fill(rest, 0.0)
    kinematics.write_axes(feedback.rail_m, rest, feedback.gimbal_rad, rest, state.before)
    kinematics.start_motion(feedback.rail_m, feedback.gimbal_rad, state.motion)
    state.next_exposure = state.first_exposure = first_exposure(0.0, params.vmu_rate_hz)
    state.heard_s = params.travel.latency_s + params.travel.jitter_s


@kernel
def run_loop(
    params, sets, field, leds, imu_noise, vision_noise, travel_draws, state, memory, poses, frames, tally, history
):
    """Fly one run; return why it ended. ``tally`` (TALLY) counts what it did, as long as it lasted.

    params: LOOP_PARAMS. sets: int64 (allocation.ROWS, 2, MAX_THRUSTERS). field: harmonics, see
    ``moon_gravity.field_table``. leds: (n, 3), m, in t. imu_noise: (cycles, IMU_NOISE), vision_noise: (exposures,
    VISION_NOISE), standard normals; travel_draws: (exposures, TRAVEL_DRAWS), uniform. state: LOOP_STATE; zeroed but
    for ``now.truth``, the IMU's true errors in ``now.imu``, both SERVO, and whom a library's step is called for.
    memory: (fusion.MEMORY,) of STEP, zeroed.
    poses: (MAX_POSES,) of POSE. frames: of VMU_FRAME, as many as can be on their way at once and two more, zeroed.
    history: (n,) of CYCLE, filled for the first n cycles.
    """
    now = state.now
    _begin(params, state)
    for k in range(params.cycles):
        t_s = k * params.step_s
        _read_axes(state, t_s)
        broken = guards.first_breach(params.guard, state.before, now.feedback, state.breach)
        if broken != guards.NOTHING:
            return broken
        _expose(params, state, t_s + TIME_SLACK_S, vision_noise, travel_draws, leds, frames, tally)
        arrived = _take_poses(params, state, t_s, frames, poses)
        if arrived < 0:
            return VISION_SILENT
        _show_pose(state, poses, arrived)
        if state.library.step_address == 0:
            _navigate(params, state, memory, poses, arrived)
            _decide(params, state, sets, t_s)
        elif not fly_by_library(params, state, sets, poses, arrived, k, t_s):
            return GNC_FAILED
        now.t_s = t_s
        count_cycle(params, state, tally)
        if k < history.shape[0]:
            history[k] = now
        truth_kernels.step(params.dss, field, state.harmonics, now.truth, now.command.on)
        imu_kernels.sample(params.imu, now.truth, imu_noise[k], now.imu)
        limited = _follow(params, state, t_s)
        if limited < 0:
            return NOT_FINITE
        if limited > 0:
            tally.limited_cycles += 1
        if state.library.asks_for_hold != 0:
            return GNC_HOLDS
    return COMPLETED
