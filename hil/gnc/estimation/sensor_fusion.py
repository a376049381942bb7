"""Fusion of the samples of sensor modules, each at its own time, with the gate and the monitor of each sensor.

A module's ``innovate`` is called by its address and gives the innovation, its sensitivity to the errors of the estimate
and of the sensor itself, and its noise; gate, update and monitors are the same for all. Components are fused in groups
of three. A sensor whose innovations have a mean, by the CUSUM of each (Page 1954), or are rejected too often in a row,
is suspect and excluded: what it may have done to the position until then is added to the covariance. It is compared
further, and used again once the sums of its CUSUM have fallen to half their limit. docs/explanation/sensors.md
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.gnc_records import MAX_SETTINGS
from hil.core.jit import entry, kernel
from hil.core.sensor_records import (
    ACCEPTED,
    EXCLUDED,
    LATE,
    MAX_SENSORS,
    NOT_USED,
    REJECTED,
    SAMPLES_PER_CYCLE,
    SENSOR_ARRIVAL,
    SENSOR_ERRORS_MAX,
    SENSOR_ESTIMATE,
    SENSOR_INNOVATION,
)
from hil.gnc.estimation import joint_filter
from hil.gnc.estimation.error_state import FILTER_ERRORS, ROTATION, R, V
from hil.gnc.estimation.sensor_innovation import innovate
from hil.gnc.estimation.sensor_monitor import SENSOR_MONITOR, bound_missed, count, watch
from hil.gnc.estimation.sensor_witness import WITNESS, WITNESS_PARAMS
from hil.gnc.estimation.step_memory import SAMPLES_PER_STEP, sensor_step_at
from hil.gnc.estimation.target_orbit import TARGET_ORBIT
from hil.maths.arrays import fill, fill_matrix
from hil.maths.kalman import is_covariance_3
from hil.maths.limits import to_integer
from hil.maths.record_view import copy_record

NEW = -1
"""Result in the memory of a sample that was not gated yet."""
_MISSED_EACH = 8  # accepted samples: gains change slowly

SENSOR_SLOT = np.dtype(
    [
        ("settings", "f8", MAX_SETTINGS),  # nominal, as the module declares them; first: the argument of ``innovate``
        ("innovate", "i8"),  # address
        ("enabled", "i8"),
        ("witness", "i8"),  # 1: it is compared, not fused
        ("sigmas", "f8"),  # allowed standard deviations between a witness and the estimate
        ("samples", "i8"),  # consecutive samples of a witness that set its interlock or release it
        ("n", "i8"),  # components
        ("gate", "f8", 2),  # largest NIS of the first three components, and of the others
        ("errors", "i8"),
        ("component", "i8", SENSOR_ERRORS_MAX),  # component of each error
        ("sigma", "f8", SENSOR_ERRORS_MAX),  # its standard deviation
        ("state", "i8", SENSOR_ERRORS_MAX),  # its index in the error state, 0: it is left out
    ],
    align=True,
)
SENSOR_FUSION_PARAMS = np.dtype(
    [
        ("n", "i8"),
        ("fused", "i8"),  # fused sensors: without witnesses
        ("slot", SENSOR_SLOT, MAX_SENSORS),
        ("witness", WITNESS_PARAMS),
        ("mean_shift", "f8"),  # standard deviations, reference value of the CUSUM
        ("cusum_limit", "f8"),
        ("nis_weight", "f8"),  # weight of a sample in the mean NIS
        ("nis_limit", "f8"),  # largest mean of a component
        ("suspect_after", "i8"),  # consecutive rejections
        ("gate", "f8"),  # standard deviations of one component that the gate passes
        ("orbit", TARGET_ORBIT),
        ("q_HI", "f8", 4),  # at the start of the run
        ("sun_I", "f8", 3),
    ],
    align=True,
)

SENSOR_FUSION_STATE = np.dtype(
    [
        ("arrived", "i8"),  # samples of this cycle
        ("arrival", SENSOR_ARRIVAL, SAMPLES_PER_CYCLE),
        ("monitor", SENSOR_MONITOR, MAX_SENSORS),
        ("witness", WITNESS, MAX_SENSORS),
        ("bound_m", "f8"),  # on the position error by the newest samples of witnesses, 0 for none
        ("bound_s", "f8"),  # when they were measured
        ("estimate", SENSOR_ESTIMATE),
        ("innovation", SENSOR_INNOVATION),
    ],
    align=True,
)


@entry
def place_samples(params, state, memory):
    """Put the samples of this cycle into the steps nearest to their times; return the first of these, -1 for none.

    params, state: FUSION_PARAMS, FUSION_STATE.
    """
    sensors, first = state.sensors, -1
    for k in range(sensors.arrived):
        arrival = sensors.arrival[k]
        sample = arrival.sample
        if params.sensors.slot[sample.sensor].witness != 0:
            continue
        arrival.result, arrival.nis = NOT_USED, np.nan
        fill(arrival.innovation, np.nan)
        if params.sensors.slot[sample.sensor].enabled == 0 or state.started == 0:
            continue
        cycle = to_integer(math.floor(sample.t_s / params.pkf.dt_s + 0.5))
        oldest = max(state.start_cycle, state.cycle - params.memory + 1)
        arrival.result = LATE
        if cycle > state.cycle + params.ahead or cycle < oldest or not math.isfinite(sample.t_s):
            sensors.monitor[sample.sensor].late += 1
            continue
        cycle = min(cycle, state.cycle)
        step = sensor_step_at(params, memory, cycle)
        if step.n == SAMPLES_PER_STEP:
            sensors.monitor[sample.sensor].late += 1
            continue
        copy_record(sample, step.sample[step.n])
        step.result[step.n], step.arrival[step.n] = NEW, k
        step.n += 1
        arrival.result = NOT_USED
        first = cycle if first < 0 else min(first, cycle)
    return first


@entry
def fuse_samples(params, state, memory, cycle):
    """Fuse the samples of step number ``cycle``. params, state: FUSION_PARAMS, FUSION_STATE."""
    step = sensor_step_at(params, memory, cycle)
    for k in range(step.n):
        sample = step.sample[k]
        if step.result[k] == NEW:
            step.result[k] = _judge(params, state, sample, cycle, state.sensors.arrival[step.arrival[k]])
        elif step.result[k] == ACCEPTED:
            for group in range((params.sensors.slot[sample.sensor].n + 2) // 3):
                _innovate(params, state, sample, cycle, group)
                joint_filter.update(params.errors, state.filters, state.found_position)


@kernel
def _innovate(params, state, sample, cycle, group):
    """Write innovation and gain of a group of components into ``state.found_position``; return the NIS."""
    sensors, filters, joint = state.sensors, state.filters, state.found_position
    slot, innovation, x = params.sensors.slot[sample.sensor], sensors.innovation, filters.pkf.x
    delta_s = sample.t_s - cycle * params.pkf.dt_s
    innovate(params.sensors, slot, sensors, sample, x[0:3], x[3:6], filters.akf.x[0:4], filters.akf.w_CH_C, delta_s)
    first = 3 * group
    fill_matrix(joint.h, 0.0)
    fill_matrix(joint.noise, 0.0)
    for i in range(3):
        joint.value[i], joint.noise[i, i] = 0.0, 1.0  # absent component: no information
        if first + i >= slot.n:
            continue
        joint.value[i] = innovation.value[first + i]
        for j in range(3):
            if first + j < slot.n:
                joint.noise[i, j] = innovation.noise[first + i, first + j]
            joint.h[i, R + j] = innovation.h[first + i, j]
            joint.h[i, V + j] = innovation.h[first + i, 3 + j] + delta_s * innovation.h[first + i, j]
            joint.h[i, ROTATION + j] = innovation.h[first + i, 6 + j]
        for k in range(slot.errors):
            if slot.state[k] != 0:
                joint.h[i, slot.state[k]] += innovation.h_errors[first + i, k]
    return joint_filter.innovate(params.errors, filters, 0, FILTER_ERRORS, joint)


@kernel
def _judge(params, state, sample, cycle, arrival):
    """Gate a new sample and fuse it if it is accepted; return the result, also in ``arrival`` (SENSOR_ARRIVAL)."""
    sensors, innovation = state.sensors, state.found_position
    slot, monitor = params.sensors.slot[sample.sensor], sensors.monitor[sample.sensor]
    passes, arrival.nis = True, 0.0
    groups = (slot.n + 2) // 3
    for group in range(groups):
        nis = _innovate(params, state, sample, cycle, group)
        passes = passes and 0.0 <= nis <= slot.gate[group] and is_covariance_3(innovation.noise, np.inf)
        arrival.nis += nis
        for i in range(3):
            if 3 * group + i < slot.n:
                arrival.innovation[3 * group + i] = innovation.value[i] / math.sqrt(innovation.s[i, i])
    passes = passes and math.isfinite(arrival.nis)
    watch(params.sensors, monitor, slot.n, arrival, passes)
    if monitor.suspect == 1:
        monitor.suspect = 2  # from now on
        state.doubts.acts = 1
        for i in range(3):
            state.doubts.position[i] = max(state.doubts.position[i], monitor.missed_m[i])
    if not passes:
        arrival.result = REJECTED
        monitor.rejected += 1
        return REJECTED
    if monitor.suspect != 0:
        arrival.result = EXCLUDED
        monitor.excluded += 1
        return EXCLUDED
    count(monitor, sample.t_s)
    if monitor.accepted % _MISSED_EACH == 1:
        fill(monitor.missed_m, 0.0)
        fill(monitor.missed_mps, 0.0)
        monitor.missed_rad = 0.0
    for group in range(groups):
        if groups > 1:  # of the only group it is the one that was judged
            _innovate(params, state, sample, cycle, group)
        if monitor.accepted % _MISSED_EACH == 1:
            bound_missed(params.sensors, innovation, monitor, min(3, slot.n - 3 * group))
        joint_filter.update(params.errors, state.filters, innovation)
    arrival.result = ACCEPTED
    return ACCEPTED
