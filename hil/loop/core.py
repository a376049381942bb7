"""The cycle as compiled calls on one state record: what is computed, without input, output, clock or random numbers.

``hil.loop.cycle`` makes these calls around devices of any kind, ``hil.loop.compiled.run_cycles`` around the bench in
memory, both in the same order: read, ``guard_bench``, ``receive_poses``, ``compare_witnesses``, the GNC
(``hil.gnc.step``), ``command``, ``check_consistency``, record, ``advance``, ``next_setpoint``, send. The cycle of
devices asks its GNC for the consistency, whose filters may be elsewhere. Axes that are faster than the cycle have
``next_setpoint`` alone between two cycles.
"""

from __future__ import annotations

import numpy as np

from hil.bench import bench_guard, guard, kinematics
from hil.bench.bench_guard import BENCH_GUARD_MEMORY, BENCH_GUARD_PARAMS
from hil.bench.guard import BREACH, GUARD
from hil.bench.kinematics import BENCH_PARAMS, MOTION, SPAN
from hil.core.jit import entry, kernel
from hil.core.messages import AXES, CYCLE
from hil.dynamics import imu, truth
from hil.dynamics.imu import IMU_PARAMS
from hil.dynamics.imu_faults import IMU_MEMORY
from hil.dynamics.thrusters import isolate
from hil.dynamics.truth import DSS_PARAMS, TRUTH_MEMORY
from hil.gnc.estimation import integrity, navigation, sensor_witness
from hil.gnc.step import APPROACH_PROGRESS, GNC_PARAMS, GNC_STATE
from hil.loop.compiled.run_stats import RUN_STATS_PARAMS
from hil.loop.mock_bench import MOCK_PARAMS, MOCK_STATE
from hil.maths import stack
from hil.maths.arrays import copy_into, fill
from hil.maths.record_view import copy_record
from hil.models.faults import FAULTS
from hil.sensors.measurement import SENSOR_PARAMS, SENSOR_STATE
from hil.sensors.mounting import MOUNTING
from hil.sensors.vision_unit.reception import VMU_RECEPTION, receive

_COMPARED_S = 2.0  # for which estimate and encoders are compared before a go relies on it

LOOP_PARAMS = np.dtype(
    [
        ("step_s", "f8"),
        ("ticks", "i8"),  # setpoints per cycle
        ("tick_s", "f8"),  # between two setpoints
        ("counts", "i8"),  # 1: RUN_STATS are counted
        ("reports", "i8"),  # 1: returns after a cycle with an event
        ("dss", DSS_PARAMS),
        ("imu", IMU_PARAMS),
        ("mounting", MOUNTING),
        ("bench", BENCH_PARAMS),
        ("guard", GUARD),
        ("bench_guard", BENCH_GUARD_PARAMS),
        ("gnc", GNC_PARAMS),
        ("stats", RUN_STATS_PARAMS),
        ("sensors", SENSOR_PARAMS),
        ("vmu_faults", FAULTS),
        ("mock", MOCK_PARAMS),  # used by the bench in memory alone
    ],
    align=True,
)

LOOP_STATE = np.dtype(
    [
        ("opened", "i8"),  # 1: the bench is open; 0: ``run_cycles`` opens it
        ("cycle", "i8"),  # number of the present or the next cycle
        ("tick", "i8"),  # of the last cycle, the next one to run; 0: all have run
        ("end", "i8"),  # number of the cycle before which ``run_cycles`` returns
        ("zero_s", "f8"),  # bench time of the run's time zero
        ("now", CYCLE),  # the row that is recorded
        ("truth_memory", TRUTH_MEMORY),
        ("imu_memory", IMU_MEMORY),
        ("vmu", VMU_RECEPTION),
        ("motion", MOTION),  # positions and rates of the last setpoints
        ("wanted", AXES),  # of the last demanded pose, without limits
        ("span", SPAN),  # course of the axes over the last cycle, if they are faster than it
        ("next", AXES),  # setpoint to be sent
        ("accepted", AXES),  # last setpoint that the devices have accepted
        ("breach", BREACH),
        ("bench_guard", BENCH_GUARD_MEMORY),
        ("limited", "i8"),  # setpoints that were limited
        ("limited_in_row", "i8"),  # setpoints in a row, the last one included
        ("sensors", SENSOR_STATE),
        ("sensors_logged", "i8"),  # rows of SENSOR_ARRIVAL written
        ("gnc", GNC_STATE),
        ("progress_before", APPROACH_PROGRESS),  # at the start of the last cycle; copied if ``reports``
        ("disagreed_before", "i8"),  # the interlock of the cycle before the last one
        ("axes_logged", "i8"),  # rows of AXES_SAMPLE written
        ("samples_logged", "i8"),  # rows of IMU_SAMPLE written
        ("mock", MOCK_STATE),  # used by the bench in memory alone
    ],
    align=True,
)


@kernel
def check_axes(params, state):
    """Return what is wrong with the axes (``guard.first_breach``), at each reading of the encoders."""
    return guard.first_breach(params.guard, state.accepted, state.now.feedback, state.breach)


@kernel
def _compare_estimate(params, state):
    """Compare the navigation of the cycle before with the encoders of its time, for GNC and row."""
    now, approach, memory = state.now, state.gnc.approach, state.bench_guard
    disagrees = bench_guard.compare_estimate(
        params.bench_guard, params.bench, memory, now.t_s, now.navigation, approach.bench_disagrees != 0
    )
    approach.bench_disagrees = 1 if disagrees else 0
    approach.go.known = 1 if memory.compared_s >= _COMPARED_S else 0
    copy_into(approach.go.off, memory.off)
    copy_into(now.bench_off, memory.off)
    breach = memory.estimate
    now.bench_breach[0], now.bench_breach[1], now.bench_breach[2] = breach.axis, breach.value, breach.high
    copy_into(approach.bench_breach, now.bench_breach)
    if approach.go.known == 0:
        fill(now.bench_off, np.nan)


@entry
def guard_bench(params, state, t_s):
    """Return what the bench guard finds at ``t_s`` of the run, at the start of a cycle; NOTHING if it is off."""
    now = state.now
    if params.bench_guard.enabled == 0:
        return guard.NOTHING
    cause = bench_guard.check_bench(
        params.bench_guard, params.bench, state.bench_guard, t_s, now.truth, state.wanted, now.feedback,
        t_s - now.sampled_s[0], t_s - now.sampled_s[1], state.limited_in_row, state.breach,
    )  # fmt: skip
    if cause == guard.NOTHING:
        _compare_estimate(params, state)
    return cause


@kernel
def _shows_target(params, state):
    """Return whether the bench is at full scale, so that the vision unit sees the target where it is."""
    square = 0.0
    for i in range(3):
        square += state.now.truth.r_CT_H[i] ** 2
    return not kinematics.is_scaled(params.bench, square)


@entry
def receive_poses(params, state, now_s, frames, n, delayed, poses, arrivals):
    """Write the poses of the first ``n`` frames into ``poses``; return how many there are: ``reception.receive``.

    All are compared with the encoders by the bench guard.
    """
    shows = _shows_target(params, state)
    arrived = receive(params, state, now_s, frames, n, shows, delayed, poses, arrivals)
    if params.bench_guard.enabled != 0:
        for i in range(arrived):
            bench_guard.compare_pose(params.bench_guard, params.bench, state.bench_guard, poses[i])
    return arrived


@entry
def compare_witnesses(params, state, t_s):
    """Compare the navigation with what witnesses have measured and delivered by ``t_s``, for GNC and row."""
    approach, now, sensors = state.gnc.approach, state.now, state.gnc.navigation.fusion.sensors
    state.disagreed_before = approach.monitor_disagrees
    approach.monitor_disagrees = sensor_witness.compare_witnesses(
        params.gnc.navigation.fusion.sensors, sensors, t_s, now.navigation
    )
    integrity.set_second(state.gnc.navigation.integrity, sensors.bound_m, sensors.bound_s)
    now.monitor_bound_m, now.monitor_bound_s = sensors.bound_m, sensors.bound_s


@kernel
def isolate_thrusters(params, state):
    """Close the isolation valves of the thrusters that the GNC has just given up."""
    gnc = state.gnc
    if gnc.isolated_cycles == 1:
        isolate(state.truth_memory.isolation, params.gnc.isolates[gnc.thrusters.thruster])


@entry
def check_consistency(params, state):
    """Write the NEES of both filters in cycles in which they took a pose, nan otherwise."""
    now, gnc = state.now, state.gnc
    now.nees_position = now.nees_attitude = np.nan
    if gnc.navigation.fused != 0:
        nees = stack.vector(2)
        navigation.normalised_errors(
            gnc.navigation.fusion.filters, params.gnc.navigation.fusion.orbit, now.truth, now.imu, nees
        )  # fmt: skip
        now.nees_position = nees[0]
        if gnc.navigation.fusion.thrust.without_imu == 0:  # otherwise the drift is the error of a rate by commands
            now.nees_attitude = nees[1]


@kernel
def aim(params, state):
    """Write the axes for the truth's pose at the end of the cycle."""
    rate, true = stack.vector(3), state.now.truth
    truth.rate_against_hill(true, rate)
    kinematics.axes_of_pose(params.bench, true.r_CT_H, true.v_CT_H, true.q_CH, rate, state.wanted)
    if params.ticks > 1:
        kinematics.extend_span(state.span, state.wanted, params.step_s)


@entry
def advance(params, state, field, noise, samples):
    """Propagate the truth over the cycle, with the thrusters of COMMAND; write the IMU's samples, and ``aim``.

    field: harmonics, ``central_gravity.field_table``. noise: (n, IMU_NOISE), standard normals. samples: (n,) of IMU,
    which the next cycle uses; (1,) may be ``state.now.imu``.
    """
    now = state.now
    imu.propagate(
        params.dss, params.imu, field, state.truth_memory, now.truth, now.command.on, noise, state.imu_memory, samples,
        now.imu,
    )  # fmt: skip
    aim(params, state)


@kernel
def limit_setpoint(limits, state, target):
    """Write the setpoint on the way to ``target`` (AXES), within ``limits`` (BENCH_PARAMS); count it if limited."""
    if kinematics.limit_setpoint(limits, state.motion, target, state.next) != 0:
        state.limited += 1
        state.limited_in_row += 1
    else:
        state.limited_in_row = 0


@entry
def next_setpoint(params, state):
    """Write the setpoint of the present tick: within the limits, and ahead of its time by each axis' lead."""
    if params.ticks > 1:
        kinematics.within_span(state.span, params.step_s, (state.tick + 1) / params.ticks, state.wanted)
    limit_setpoint(params.bench, state, state.wanted)


@kernel
def accept(state, rail_m, gimbal_rad):
    """Write the positions (3,) that the devices have accepted, with the rates sent, into the row and ``accepted``."""
    sent = state.next
    kinematics.write_axes(rail_m, sent.rail_mps, gimbal_rad, sent.gimbal_radps, state.accepted)
    copy_record(state.accepted, state.now.setpoint)


@kernel
def next_tick(params, state):
    """Count the tick whose setpoint was sent."""
    state.tick = state.tick + 1 if state.tick + 1 < params.ticks else 0
