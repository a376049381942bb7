"""Closed loop as one compiled function, made of the kernels that the cycle calls (hil/loop/cycle.py).

Stage by stage and in the same order: the mock rig's axes, safety monitor, vision unit, GNC, truth, virtual IMU,
setpoints. Random numbers are those of the cycle's streams, drawn beforehand. Both have the same bits, which a test
checks. A campaign runs whole cases and reads RUN_STATS; no memory grows with their length. A session runs blocks of
cycles and reads rows, frames and state (``cycles.py``).
"""

from __future__ import annotations

import math

import numpy as np

from hil.bench import bench_guard, kinematics
from hil.bench import guard as guards
from hil.bench.bench_guard import BENCH_GUARD_MEMORY, BENCH_GUARD_PARAMS
from hil.bench.guard import BREACH, GUARD
from hil.bench.kinematics import BENCH_PARAMS, MOTION, SPAN
from hil.core.jit import entry, kernel
from hil.core.messages import AXES, CYCLE, MAX_POSES, MAX_THRUSTERS
from hil.dynamics import imu as imu_kernels
from hil.dynamics import truth as truth_kernels
from hil.dynamics.imu import IMU_PARAMS
from hil.dynamics.imu_faults import IMU_MEMORY
from hil.dynamics.isolation import isolate
from hil.dynamics.truth import DSS_PARAMS, TRUTH_MEMORY
from hil.dynamics.vision import VISION_PARAMS, measure_frame
from hil.dynamics.vision_errors import VISION_MEMORY
from hil.dynamics.vision_faults import VMU_MEMORY, disturb_frame, see_through_plume
from hil.gnc import guidance, integrity, navigation
from hil.gnc.approach_monitor import APPROACH_MONITOR_PARAMS
from hil.gnc.integrity_verdict import INTEGRITY_PARAMS
from hil.gnc.ready_phase import READY_PARAMS
from hil.gnc.step import APPROACH_PROGRESS, GNC_PARAMS, GNC_STATE, copy_progress, gnc_step, has_event
from hil.loop.compiled.library_kernel import LIBRARY, has_new_text, library_step
from hil.loop.compiled.run_stats import count_cycle
from hil.loop.monitor_kernel import MONITOR_PARAMS, MONITOR_STATE, compare_received, is_measured, measure_bench
from hil.maths import stack
from hil.maths.arrays import copy_into, copy_matrix, fill
from hil.maths.limits import cut_to_range
from hil.models.axis_faults import NOMINAL_AXES, set_axis_faults
from hil.models.camera import CAMERA
from hil.models.camera_timing import TIME_SLACK_S, TRAVEL, delays, exposure_time, first_exposure
from hil.models.faults import FAULTS
from hil.models.mounting import MOUNTING, chaser_pose
from hil.models.servo import SERVO, servo_step, servo_step_of_two

COMPLETED, FOLLOWING, TRAVEL_LEFT, VISION_SILENT, NOT_FINITE, GNC_FAILED, GNC_HOLDS, EVENT = range(8)
"""Reasons for a return of ``run_loop``; the second and third have their numbers in ``hil.bench.guard``, and those of
``hil.bench.bench_guard`` follow."""

LOOP_PARAMS = np.dtype(
    [
        ("step_s", "f8"),
        ("ticks", "i8"),  # setpoints per cycle
        ("tick_s", "f8"),  # between two setpoints
        ("vmu_rate_hz", "f8"),
        ("vmu_timeout_s", "f8"),
        ("thruster_lines", "i8"),  # thrusters mirrored to digital lines
        ("counts", "i8"),  # 1: RUN_STATS are counted
        ("reports", "i8"),  # 1: returns after a cycle with an event
        ("steady_state_after_s", "f8"),  # navigation errors are counted from here on
        ("dss", DSS_PARAMS),
        ("imu", IMU_PARAMS),
        ("vision", VISION_PARAMS),
        ("travel", TRAVEL),
        ("mounting", MOUNTING),
        ("camera", CAMERA),
        ("bench", BENCH_PARAMS),
        ("guard", GUARD),
        ("bench_guard", BENCH_GUARD_PARAMS),
        ("gnc", GNC_PARAMS),
        ("verdict", APPROACH_MONITOR_PARAMS),  # margins of the verdict, whatever the GNC's own are
        ("ready", READY_PARAMS),
        ("integrity", INTEGRITY_PARAMS),
        ("monitor", MONITOR_PARAMS),
        ("vmu_faults", FAULTS),
        ("axis_faults", FAULTS),
        ("nominal_axes", NOMINAL_AXES),
    ],
    align=True,
)

LOOP_STATE = np.dtype(
    [
        ("opened", "i8"),  # 1: the bench is open; 0: ``run_loop`` opens it
        ("cycle", "i8"),  # number of the next cycle
        ("tick", "i8"),  # of the last cycle, the next one to run; 0: all have run
        ("end", "i8"),  # number of the cycle before which ``run_loop`` returns
        ("zero_s", "f8"),  # bench time of the run's time zero
        ("now", CYCLE),
        ("truth_memory", TRUTH_MEMORY),
        ("imu_memory", IMU_MEMORY),
        ("vmu_memory", VMU_MEMORY),
        ("vision_memory", VISION_MEMORY),
        ("rails", SERVO),
        ("turntable", SERVO),
        ("motion", MOTION),
        ("desired", AXES),
        ("span", SPAN),  # of the last cycle
        ("next", AXES),
        ("before", AXES),  # the setpoint of the cycle before
        ("breach", BREACH),
        ("bench_guard", BENCH_GUARD_MEMORY),
        ("limited_in_row", "i8"),  # setpoints, the last one included
        ("monitor", MONITOR_STATE),
        ("disagreed_before", "i8"),  # the interlock of the cycle before the last one
        ("gnc", GNC_STATE),
        ("progress_before", APPROACH_PROGRESS),  # at the start of the last cycle; copied if ``reports``
        ("library", LIBRARY),
        ("next_exposure", "i8"),
        ("first_exposure", "i8"),
        ("in_transit", "i8"),  # frames exposed and not received yet
        ("delayed", "i8"),  # frames received that faults of the vision unit delay
        ("last_rx_s", "f8"),  # when the last frame was received, bench time
        ("arrived_s", "f8", MAX_POSES),  # when the poses of this cycle were received, bench time
        ("received", "i8"),  # frames with a pose so far
        ("without_pose", "i8"),  # frames without one
        ("dropped", "i8"),  # of them beyond MAX_POSES in one cycle
        ("logged", "i8"),  # rows of ARRIVAL written
        ("axes_logged", "i8"),  # rows of AXES_SAMPLE written
        ("samples_logged", "i8"),  # rows of IMU_SAMPLE written
        ("lines", "i8", MAX_THRUSTERS),  # as mirrored
        ("lines_changed_s", "f8"),  # bench time, nan without lines
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
    for i in range(3):
        axes.setpoint[i] = accepted[i] - axes.encoder_offset[i] + axes.disturbance[i]
        axes.feedforward[i] = feedforward[i] + axes.disturbance_rate[i]
    return True


@entry
def _expose(params, state, until_s, first, vision_noise, travel_draws, leds, frames, stats):
    """Write the frames that the vision unit exposes up to ``until_s`` into ``frames``, in transit.

    first: number of the exposure of the first row of noise and draws.
    """
    late = stack.vector(2)
    r, q = stack.vector(3), stack.vector(4)
    while True:
        t_s = exposure_time(state.next_exposure, params.vmu_rate_hz)
        if t_s > until_s:
            return
        row = state.next_exposure - first
        _move_all(state, t_s)
        kinematics.pose_of_axes(params.bench, state.rails.position, state.turntable.position, r, q)
        frame = frames[state.in_transit]
        measure_frame(
            params.vision, params.camera, leds, params.mounting, r, q, vision_noise[row], t_s, state.vision_memory,
            frame,
        )  # fmt: skip
        if params.counts != 0:
            stats.view_margin = min(stats.view_margin, state.vision_memory.view_margin)
        for copy in range(delays(params.travel, travel_draws[row], late)):
            sent = frames[state.in_transit]
            if copy > 0:
                frames[state.in_transit] = frames[state.in_transit - 1]
            sent.t_s = t_s
            sent.received_s = t_s + late[copy]
            sent.counter = state.next_exposure - state.first_exposure
            state.in_transit += 1
        state.next_exposure += 1


@kernel
def _next_arrival(frames, n):
    """Return the index of the frame of ``n`` that arrives first, of equals the one exposed first, or -1."""
    found = -1
    for i in range(n):
        if (
            found < 0
            or frames[i].received_s < frames[found].received_s
            or (frames[i].received_s == frames[found].received_s and frames[i].counter < frames[found].counter)
        ):
            found = i
    return found


@kernel
def _copy_frame(frame, out):
    """Copy a record of VMU_FRAME, field by field: as a whole it compiles into a copy of single bytes."""
    out.counter, out.t_s, out.received_s = frame.counter, frame.t_s, frame.received_s
    copy_into(out.t_v, frame.t_v)
    copy_into(out.q_vt, frame.q_vt)
    copy_matrix(out.covariance, frame.covariance)
    out.leds_left, out.leds_right, out.status = frame.leds_left, frame.leds_right, frame.status


@kernel
def _copy_pose(pose, out):
    """Copy a record of POSE without ``fresh``."""
    copy_into(out.z_TC_C, pose.z_TC_C)
    copy_into(out.q_CH, pose.q_CH)
    copy_matrix(out.covariance_position, pose.covariance_position)
    copy_matrix(out.covariance_attitude, pose.covariance_attitude)
    copy_matrix(out.covariance_cross, pose.covariance_cross)
    out.status, out.t_s = pose.status, pose.t_s


@kernel
def _take_frame(frames, i, n):
    """Remove frame ``i`` of the first ``n``; return how many are left."""
    if i < n - 1:
        frames[i] = frames[n - 1]
    return n - 1


@kernel
def _count_arrival(state, frame):
    """Count a frame that has arrived; return whether it has a pose."""
    state.last_rx_s = frame.received_s
    if math.isnan(frame.t_v[0]):
        state.without_pose += 1
        return False
    state.received += 1
    return True


@kernel
def _disturb_frames(params, state, now_s, frames, delayed):
    """Move the frames that have arrived by ``now_s`` into ``delayed``, with plumes and faults of the vision unit."""
    plume = params.dss.plume
    while True:
        i = _next_arrival(frames, state.in_transit)
        if i < 0 or frames[i].received_s > now_s + TIME_SLACK_S:
            return
        is_seen = _count_arrival(state, frames[i])
        if is_seen and plume.dimming > 0.0:
            is_seen = see_through_plume(
                plume, state.truth_memory.plume, params.vmu_faults.seed, state.zero_s, frames[i]
            )  # fmt: skip
        if is_seen and disturb_frame(params.vmu_faults, params.mounting, state.zero_s, state.vmu_memory, frames[i]):
            delayed[state.delayed] = frames[i]
            state.delayed += 1
        state.in_transit = _take_frame(frames, i, state.in_transit)


@entry
def _receive_poses(params, state, now_s, frames, delayed, poses, arrivals):
    """Write the poses that have arrived by ``now_s`` into ``poses`` (MAX_POSES,); return their number, -1 on timeout.

    Of more than MAX_POSES the last ones are kept. delayed: as many as ``frames``, received and not yet passed on; used
    if the vision unit has faults or plumes dim its LEDs. arrivals: of ARRIVAL, receives every frame; (0,) for none.
    """
    arrived = 0
    logged = state.logged
    has_faults = params.vmu_faults.n != 0 or params.dss.plume.dimming > 0.0
    if has_faults:
        _disturb_frames(params, state, now_s, frames, delayed)
    queue = delayed if has_faults else frames
    waiting = state.delayed if has_faults else state.in_transit
    while True:
        i = _next_arrival(queue, waiting)
        if i < 0 or queue[i].received_s > now_s + TIME_SLACK_S:
            break
        if not has_faults and not _count_arrival(state, queue[i]):
            waiting = _take_frame(queue, i, waiting)
            continue
        if arrived == MAX_POSES:
            for j in range(MAX_POSES - 1):
                poses[j] = poses[j + 1]
                state.arrived_s[j] = state.arrived_s[j + 1]
            arrived -= 1
            state.dropped += 1
        chaser_pose(params.mounting, queue[i].t_v, queue[i].q_vt, queue[i].covariance, poses[arrived])
        poses[arrived].t_s = queue[i].t_s - state.zero_s
        poses[arrived].status = queue[i].status
        state.arrived_s[arrived] = queue[i].received_s
        arrived += 1
        if state.logged < arrivals.shape[0]:
            arrivals[state.logged].cycle = -1
            _copy_frame(queue[i], arrivals[state.logged].frame)
            state.logged += 1
        waiting = _take_frame(queue, i, waiting)
    if has_faults:
        state.delayed = waiting
    else:
        state.in_transit = waiting
    if now_s - state.last_rx_s > params.vmu_timeout_s:
        state.logged = logged
        return -1
    if state.logged > logged:
        for j in range(arrived):
            used = state.logged - arrived + j
            arrivals[used].cycle = state.cycle
            _copy_pose(poses[j], arrivals[used].pose)
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
    _copy_pose(poses[newest], now.pose)
    now.received_s = state.arrived_s[newest] - state.zero_s


@entry
def _read_axes(state, now_s):
    """Write the encoders' values into the present row."""
    _move_all(state, now_s)
    rails, turntable = state.rails, state.turntable
    feedback = state.now.feedback
    kinematics.write_axes(rails.position, rails.rate, turntable.position, turntable.rate, feedback)
    for i in range(3):
        feedback.rail_m[i] += rails.encoder_offset[i]
        feedback.gimbal_rad[i] += turntable.encoder_offset[i]


@entry
def _check_monitor(params, state, t_s, noise, first):
    """Compare the navigation with the docking monitor's measurements, which are those of the statistical model."""
    if is_measured(params.monitor, state.monitor, t_s):
        r, q = stack.vector(3), stack.vector(4)
        kinematics.pose_of_axes(params.bench, state.rails.position, state.turntable.position, r, q)
        measure_bench(params.monitor, state.monitor, t_s, r, q, noise, first)
    state.disagreed_before = state.gnc.approach.monitor_disagrees
    state.gnc.approach.monitor_disagrees = compare_received(
        params.monitor, state.monitor, t_s, state.now.navigation
    )  # fmt: skip
    bound_m, measured_s = state.monitor.interlock.bound_m, state.monitor.interlock.last_s
    integrity.set_second(state.gnc.navigation.integrity, bound_m, measured_s)
    state.now.monitor_bound_m, state.now.monitor_bound_s = bound_m, measured_s


@kernel
def _mirror_thrusters(params, state, now_s):
    """Write the digital lines if a thruster has changed; the relay stays closed, as its pump is pulsed each cycle."""
    state.now.on_wire_s = state.lines_changed_s - state.zero_s  # as the coupler was read, at the start of the cycle
    changed = False
    for i in range(params.thruster_lines):
        if state.now.command.on[i] != state.lines[i]:
            state.lines[i] = state.now.command.on[i]
            changed = True
    if changed:
        state.lines_changed_s = now_s


@entry
def _check_consistency(params, state):
    """Write the NEES of both filters in cycles in which they took a pose, nan otherwise."""
    now = state.now
    now.nees_position = now.nees_attitude = np.nan
    if state.gnc.navigation.fused != 0:
        nees = stack.vector(2)
        navigation.normalised_errors(
            state.gnc.navigation.fusion.filters, params.gnc.navigation.fusion.orbit, now.truth, now.imu, nees
        )  # fmt: skip
        now.nees_position, now.nees_attitude = nees[0], nees[1]


@kernel
def _aim(params, state):
    """Stage 11: axes for the truth's pose at the end of the cycle."""
    rate = stack.vector(3)
    truth = state.now.truth
    truth_kernels.rate_against_hill(truth, rate)
    kinematics.axes_of_pose(params.bench, truth.r_CT_H, truth.v_CT_H, truth.q_CH, rate, state.desired)
    if params.ticks > 1:
        kinematics.extend_span(state.span, state.desired, params.step_s)


@entry
def _send_setpoints(params, state, stats, now_s):
    """Stage 11: setpoints of the present tick. Return False if one is not finite."""
    now = state.now
    if params.ticks > 1:
        kinematics.within_span(state.span, params.step_s, (state.tick + 1) / params.ticks, state.desired)
    out = state.next
    if kinematics.limit_setpoint(params.bench, state.motion, state.desired, out) != 0:
        stats.limited_cycles += 1
        state.limited_in_row += 1
    else:
        state.limited_in_row = 0
    rails, gimbals = stack.vector(3), stack.vector(3)
    accepted = _send(state.rails, out.rail_m, out.rail_mps, now_s, rails) and _send(
        state.turntable, out.gimbal_rad, out.gimbal_radps, now_s, gimbals
    )
    if not accepted:
        return False
    kinematics.write_axes(rails, out.rail_mps, gimbals, out.gimbal_radps, now.setpoint)
    kinematics.write_axes(rails, out.rail_mps, gimbals, out.gimbal_radps, state.before)
    return True


@kernel
def _log_axes(state, now_s, log):
    """Write the setpoint of the present tick, sent at ``now_s``, and the encoders into ``log``, of AXES_SAMPLE."""
    if state.axes_logged >= log.shape[0]:
        return
    row, setpoint, feedback = log[state.axes_logged], state.now.setpoint, state.now.feedback
    row.t_s = row.sampled_s[0] = row.sampled_s[1] = now_s - state.zero_s
    row.lateness_s = 0.0
    kinematics.write_axes(
        setpoint.rail_m, setpoint.rail_mps, setpoint.gimbal_rad, setpoint.gimbal_radps, row.setpoint
    )  # fmt: skip
    kinematics.write_axes(
        feedback.rail_m, feedback.rail_mps, feedback.gimbal_rad, feedback.gimbal_radps, row.feedback
    )  # fmt: skip
    state.axes_logged += 1


@kernel
def _log_samples(params, state, samples, log):
    """Write the IMU's samples of the present cycle, which the next one uses, into ``log``, of IMU_SAMPLE."""
    n = samples.shape[0]
    for i in range(n):
        if state.samples_logged >= log.shape[0]:
            return
        row = log[state.samples_logged]
        row.cycle = state.cycle + 1
        row.t_s = (state.cycle * n + i + 1) * params.dss.dt_s
        imu_kernels.copy_sample(samples[i], row.imu)
        state.samples_logged += 1


@kernel
def _open(params, state):
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
    state.lines_changed_s = np.nan
    state.opened = 1


@kernel
def _has_event(state):
    """Return whether the last cycle has an event: of approach or interlock, or a new text of the library."""
    if has_event(state.progress_before, state.gnc.approach.progress):
        return True
    if state.disagreed_before != state.gnc.approach.monitor_disagrees or state.gnc.backends.new_text != 0:
        return True
    return state.library.step_address != 0 and has_new_text(state.library)


@kernel
def run_loop(
    params, field, leds, imu_noise, vision_noise, travel_draws, monitor_noise, state, samples, memory, poses, frames,
    delayed, stats, history, arrivals, axes_log, samples_log,
):  # fmt: skip
    """Run the cycles from ``state.cycle`` to ``state.end``; return why it ended.

    A cycle sends the setpoints of its first tick; its other ticks, if it has more, come before the next cycle.
    COMPLETED, GNC_HOLDS and EVENT leave ``state.cycle`` at the next cycle. After any other reason it is the number of
    the cycle that was not completed, unless ``state.tick`` is above 0: then it was that tick of the cycle before.
    The bench guard, FOLLOWING, TRAVEL_LEFT and VISION_SILENT end a cycle before the GNC, GNC_FAILED in it, NOT_FINITE
    when the setpoints are to be sent, after its row was written.

    params: LOOP_PARAMS. field: harmonics, ``central_gravity.field_table``. leds: (n, 3), m, in t. imu_noise: (n,
    IMU_NOISE), one row per sample, vision_noise: (n, VISION_NOISE), one row per exposure, standard normals;
    travel_draws: (n, TRAVEL_DRAWS), uniform, one row per exposure. monitor_noise: (n, MONITOR_NOISE), one row per
    measurement of a modelled docking monitor, (0, MONITOR_NOISE) without one. state: LOOP_STATE; if not ``opened``,
    zeroed but for ``now.truth``, the IMU's true errors in ``now.imu``, both SERVO, ``end``, and the address and
    instance of a library. samples: (n,) of IMU, those of a cycle; (1,) may be ``state.now.imu``. memory: of
    ``fusion.new_memory``. poses: (MAX_POSES,) of POSE. frames: of VMU_FRAME, as many as can be on their way at once and
    two more. delayed: as many again. stats: RUN_STATS. history: (n,) of CYCLE, filled with the first n cycles from
    here. arrivals: of ARRIVAL, filled from ``state.logged`` on. axes_log: of AXES_SAMPLE, samples_log: of IMU_SAMPLE,
    likewise; (0,) for none.
    """
    now = state.now
    if state.opened == 0:
        _open(params, state)
    first_cycle, first, n_samples = state.cycle, state.next_exposure, samples.shape[0]
    first_measured = state.monitor.next
    while state.cycle < state.end:
        k = state.cycle
        begins = state.tick == 0
        tick = k * params.ticks if begins else (k - 1) * params.ticks + state.tick
        now_s = state.zero_s + tick * params.tick_s
        if begins and params.axis_faults.n != 0:
            set_axis_faults(params.axis_faults, params.nominal_axes, k * params.step_s, state.rails, state.turntable)
        _read_axes(state, now_s)
        broken = guards.first_breach(params.guard, state.before, now.feedback, state.breach)
        if broken != guards.NOTHING:
            return broken
        if begins and params.bench_guard.enabled != 0:
            broken = bench_guard.check_bench(
                params.bench_guard, params.bench, state.bench_guard, now_s - state.zero_s, now.truth, state.desired,
                now.feedback, 0.0, 0.0, state.limited_in_row, state.breach,
            )  # fmt: skip
            if broken != guards.NOTHING:
                return broken
        _expose(params, state, now_s + TIME_SLACK_S, first, vision_noise, travel_draws, leds, frames, stats)
        if begins:
            t_s = k * params.step_s
            arrived = _receive_poses(params, state, now_s, frames, delayed, poses, arrivals)
            if arrived < 0:
                return VISION_SILENT
            _record_pose(state, poses, arrived)
            if params.bench_guard.enabled != 0:
                for i in range(arrived):
                    bench_guard.compare_pose(params.bench_guard, params.bench, state.bench_guard, poses[i])
            if params.monitor.acts != 0:
                _check_monitor(params, state, t_s, monitor_noise, first_measured)
            if params.reports != 0:
                copy_progress(state.gnc.approach.progress, state.progress_before)
            if state.library.step_address == 0:
                if not gnc_step(
                    params.gnc, state.gnc, memory, t_s, samples, poses, arrived,
                    now.navigation, now.reference, now.supervision, now.command,
                ):  # fmt: skip
                    return GNC_FAILED
                if state.gnc.isolated_cycles == 1:
                    isolate(state.truth_memory.isolation, params.gnc.isolates[state.gnc.thrusters.thruster])
            elif not library_step(params.gnc, state, poses, arrived, k, t_s):
                return GNC_FAILED
            _mirror_thrusters(params, state, now_s)
            _check_consistency(params, state)
            now.t_s = t_s
            now.commanded_s = now.sampled_s[0] = now.sampled_s[1] = now_s - state.zero_s
            if params.counts != 0:
                count_cycle(params, state, stats)
            row = k - first_cycle
            if row < history.shape[0]:
                history[row] = now
            row *= n_samples
            imu_kernels.propagate(
                params.dss, params.imu, field, state.truth_memory, now.truth, now.command.on,
                imu_noise[row : row + n_samples], state.imu_memory, samples, now.imu,
            )  # fmt: skip
            _log_samples(params, state, samples, samples_log)
            _aim(params, state)
        if not _send_setpoints(params, state, stats, now_s):
            return NOT_FINITE
        _log_axes(state, now_s, axes_log)
        state.tick = state.tick + 1 if state.tick + 1 < params.ticks else 0
        if not begins:
            continue
        state.cycle = k + 1
        if state.library.asks_for_hold != 0 or state.gnc.backends.asks_for_hold != 0:
            return GNC_HOLDS
        if params.reports != 0 and _has_event(state):
            return EVENT
    return COMPLETED
