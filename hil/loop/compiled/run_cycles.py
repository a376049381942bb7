"""Compiled shell: the calls of the core (``hil/loop/core.py``) around the bench in memory, as one function.

The order of the calls is that of ``hil/loop/cycle.py``, and so are the bits, which tests check. Random numbers are
those of the cycle's streams, drawn beforehand. A campaign runs whole cases and reads RUN_STATS; no memory grows with
their length. A session runs blocks of cycles and reads rows and frames (``cycles.py``).
"""

from __future__ import annotations

import numpy as np

from hil.bench import guard as guards
from hil.bench.kinematics import start_motion, write_axes
from hil.core.jit import entry, kernel
from hil.gnc import guidance
from hil.gnc.step import gnc_step, has_event
from hil.gnc.whole_step import whole_step
from hil.loop import core, mock_bench
from hil.loop.compiled.run_stats import count_cycle
from hil.maths import stack
from hil.maths.arrays import fill
from hil.maths.record_view import copy_record
from hil.models.axis_faults import set_axis_faults
from hil.models.camera_timing import TIME_SLACK_S, first_exposure
from hil.sensors.measurement import log_arrivals
from hil.sensors.vision_unit.transit import forget_frames

COMPLETED, FOLLOWING, TRAVEL_LEFT, VISION_SILENT, NOT_FINITE, GNC_FAILED, GNC_HOLDS, EVENT = range(8)
"""Reasons for a return of ``run_cycles``; the second and third have their numbers in ``hil.bench.guard``, and those of
``hil.bench.bench_guard`` follow."""


@kernel
def _open(params, state):
    """Initialise ``state``, whose truth, IMU errors and axes are those at the start, for the first cycle."""
    guidance.start(params.gnc.approach.guidance, state.gnc.approach.guidance)
    mock_bench.read_axes(state, 0.0)
    feedback, transit, rest = state.now.feedback, state.mock.transit, stack.vector(3)
    fill(rest, 0.0)
    write_axes(feedback.rail_m, rest, feedback.gimbal_rad, rest, state.accepted)
    start_motion(feedback.rail_m, feedback.gimbal_rad, state.motion)
    transit.next_exposure = transit.first_exposure = first_exposure(0.0, params.mock.vmu_rate_hz)
    transit.last_rx_s = params.mock.travel.latency_s + params.mock.travel.jitter_s
    state.mock.lines_changed_s = np.nan
    state.vmu.not_before_s = -np.inf
    state.opened = 1


@kernel
def _run_gnc(params, state, memory, samples, poses, arrived, t_s):
    """Run the GNC, built in or elsewhere; return whether it worked."""
    now, gnc = state.now, state.gnc
    if params.reports != 0:
        copy_record(gnc.approach.progress, state.progress_before)
    if gnc.backends.gnc.step == 0:
        return gnc_step(
            params.gnc, gnc, memory, t_s, samples, poses, arrived,
            now.navigation, now.reference, now.supervision, now.command,
        )  # fmt: skip
    return whole_step(params.gnc, gnc, now, samples, poses, arrived, state.cycle, t_s)


@entry
def _send_setpoint(params, state, now_s):
    """Send the setpoint of the present tick to the mock axes. Return False if it is not finite."""
    rails, gimbals = stack.vector(3), stack.vector(3)
    core.next_setpoint(params, state)
    if not mock_bench.send_setpoint(state.mock, state.next, now_s, rails, gimbals):
        return False
    core.accept(state, rails, gimbals)
    return True


@kernel
def _log_axes(state, now_s, log):
    """Write the setpoint of the present tick, sent at ``now_s``, and the encoders into ``log``, of AXES_SAMPLE."""
    if state.axes_logged >= log.shape[0]:
        return
    row, now = log[state.axes_logged], state.now
    row.t_s, row.lateness_s = now_s - state.zero_s, 0.0
    row.sampled_s[0], row.sampled_s[1] = now.sampled_s[0], now.sampled_s[1]
    copy_record(now.setpoint, row.setpoint)
    copy_record(now.feedback, row.feedback)
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
        copy_record(samples[i], row.imu)
        state.samples_logged += 1


@kernel
def _has_event(state):
    """Return whether the last cycle has an event: of approach or interlock, or a new text of a backend."""
    if has_event(state.progress_before, state.gnc.approach.progress):
        return True
    return state.disagreed_before != state.gnc.approach.monitor_disagrees or state.gnc.backends.new_text != 0


@kernel
def run_cycles(
    params, field, leds, imu_noise, vision_noise, travel_draws, state, samples, memory, poses, frames, delayed,
    stats, history, arrivals, axes_log, samples_log, sensor_log,
):  # fmt: skip
    """Run the cycles from ``state.cycle`` to ``state.end``; return why it ended.

    A cycle sends the setpoints of its first tick; its other ticks, if it has more, come before the next cycle.
    COMPLETED, GNC_HOLDS and EVENT leave ``state.cycle`` at the next cycle. After any other reason it is the number of
    the cycle that was not completed, unless ``state.tick`` is above 0: then it was that tick of the cycle before.
    The bench guard, FOLLOWING, TRAVEL_LEFT and VISION_SILENT end a cycle before the GNC, GNC_FAILED in it, NOT_FINITE
    when the setpoints are to be sent, after its row was written.

    params: LOOP_PARAMS. field: harmonics, ``central_gravity.field_table``. leds: (n, 3), m, in t. imu_noise: (n,
    IMU_NOISE), one row per sample, vision_noise: (n, VISION_NOISE), one row per exposure, standard normals;
    travel_draws: (n, TRAVEL_DRAWS), uniform, one row per exposure. state: LOOP_STATE; if not ``opened``,
    zeroed but for ``now.truth``, the IMU's true errors in ``now.imu``, both SERVO, ``end``, and the addresses and
    instances of backends. samples: (n,) of IMU, those of a cycle; (1,) may be ``state.now.imu``. memory: of
    ``new_memory`` (step_memory). poses: (MAX_POSES,) of POSE. frames: of VMU_FRAME, as many as can be on their way and
    SPARE_FRAMES more. delayed: as many again. stats: RUN_STATS. history: (n,) of CYCLE, filled with the first n cycles
    from here. arrivals: of ARRIVAL, filled from ``state.vmu.logged`` on. axes_log: of AXES_SAMPLE, samples_log: of
    IMU_SAMPLE, sensor_log: of SENSOR_ARRIVAL, likewise; (0,) for none.
    """
    now, mock, transit = state.now, state.mock, state.mock.transit
    if state.opened == 0:
        _open(params, state)
    first_cycle, first, n_samples = state.cycle, transit.next_exposure, samples.shape[0]
    while state.cycle < state.end:
        k = state.cycle
        begins = state.tick == 0
        tick = k * params.ticks if begins else (k - 1) * params.ticks + state.tick
        now_s, t_s = state.zero_s + tick * params.tick_s, k * params.step_s
        if begins and params.mock.axis_faults.n != 0:
            set_axis_faults(params.mock.axis_faults, params.mock.nominal_axes, t_s, mock.rails, mock.turntable)
        mock_bench.read_axes(state, now_s)
        broken = core.check_axes(params, state)
        if begins and broken == guards.NOTHING:
            broken = core.guard_bench(params, state, now_s - state.zero_s)
        if broken != guards.NOTHING:
            return broken
        mock_bench.expose(
            params, state, now_s + TIME_SLACK_S, first, vision_noise, travel_draws, leds, frames, stats
        )  # fmt: skip
        if begins:
            n = mock_bench.receive_frames(params, state, now_s, frames)
            if n < 0:
                return VISION_SILENT
            arrived = now.pose.fresh = 0
            if n > 0 or state.vmu.delayed > 0:
                arrived = core.receive_poses(params, state, now_s, frames, n, delayed, poses, arrivals)
                forget_frames(transit, n, frames)
            if params.sensors.n != 0:
                mock_bench.measure_sensors(params, state, t_s)
                core.compare_witnesses(params, state, t_s)
            if not _run_gnc(params, state, memory, samples, poses, arrived, t_s):
                return GNC_FAILED
            if params.sensors.n != 0:
                of_sensors = state.gnc.navigation.fusion.sensors
                state.sensors_logged = log_arrivals(of_sensors, k, sensor_log, state.sensors_logged)
            mock_bench.mirror_thrusters(params, state, now_s)
            core.isolate_thrusters(params, state)
            core.check_consistency(params, state)
            now.t_s, now.commanded_s = t_s, now_s - state.zero_s
            if params.counts != 0:
                count_cycle(params.stats, stats, now)
            row = k - first_cycle
            if row < history.shape[0]:
                history[row] = now
            row *= n_samples
            core.advance(params, state, field, imu_noise[row : row + n_samples], samples)
            _log_samples(params, state, samples, samples_log)
        if not _send_setpoint(params, state, now_s):
            return NOT_FINITE
        stats.limited_cycles = state.limited
        _log_axes(state, now_s, axes_log)
        core.next_tick(params, state)
        if not begins:
            continue
        state.cycle = k + 1
        if state.gnc.backends.asks_for_hold != 0:
            return GNC_HOLDS
        if params.reports != 0 and _has_event(state):
            return EVENT
    return COMPLETED
