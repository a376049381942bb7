"""Sensors of a scenario in the loop: modelled measurements with their faults and delays, and those that have arrived.

The stage in Python and the compiled loop call the same kernels: ``measure`` for modelled sensors, ``put_sample`` for
those of another source, then ``deliver`` to the navigation. The random numbers of a sensor depend on the seed, its
number and the number of the measurement alone.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.foreign_call import call_address
from hil.core.gnc_records import MAX_SETTINGS
from hil.core.jit import entry, kernel
from hil.core.sensor_records import (
    COMPONENTS_MAX,
    MAX_SENSORS,
    MEMORY,
    NORMALS,
    NOT_USED,
    SAMPLES_PER_CYCLE,
    SENSOR_OUTPUT,
    SENSOR_SAMPLE,
    SENSOR_TRUTH,
)
from hil.maths.arrays import copy_into, fill, fill_matrix
from hil.maths.record_view import copy_record
from hil.models.camera_timing import TIME_SLACK_S, exposure_time
from hil.models.faults import (
    AT,
    AT_ARRIVAL,
    FAULTS,
    KIND,
    NUMBER,
    OPTION,
    SIZE,
    VALUE,
    displace_at_random,
    is_active,
    normal,
    uniform,
)

NO_SAMPLE, FROZEN, OFFSET, DRIFT, OUTLIER, NOISE_SCALE, SIGMA_SCALE, LATENCY = range(8)
"""Kinds of faults of sensors."""
NO_POSE = NO_SAMPLE  # its name for the docking monitor
_OUTLIER_SIGMAS = 30.0
_WAITING_MAX = 32  # samples between measurement and arrival; further ones are lost
_LANES = 256  # random numbers of a measurement
_NOISE_LANE, _FAULT_LANE, _LOSS_LANE = 0, 32, 64

SENSOR_SOURCE = np.dtype(
    [
        ("settings", "f8", MAX_SETTINGS),  # true ones; first: the argument of ``measure``
        ("measure", "i8"),  # address
        ("models", "i8"),  # 1: its measurements are modelled
        ("sees_bench", "i8"),  # 1: where the axes are; 0: the truth
        ("n", "i8"),  # components
        ("rate_hz", "f8"),
        ("latency_s", "f8"),
        ("loss", "f8"),  # probability
    ],
    align=True,
)
SENSOR_PARAMS = np.dtype(
    [("n", "i8"), ("source", SENSOR_SOURCE, MAX_SENSORS), ("seed", "i8"), ("faults", FAULTS), ("sun_I", "f8", 3)],
    align=True,
)

SENSOR_TRACK = np.dtype(
    [
        ("next", "i8"),  # number of the next measurement
        ("measured_s", "f8"),  # the last one
        ("has_measured", "i8"),
        ("has_sample", "i8"),
        ("frozen", SENSOR_SAMPLE),  # last sample that was passed on
        ("memory", "f8", MEMORY),  # memory of the module
    ],
    align=True,
)
SENSOR_STATE = np.dtype(
    [
        ("track", SENSOR_TRACK, MAX_SENSORS),
        ("truth", SENSOR_TRUTH),
        ("output", SENSOR_OUTPUT),
        ("waiting", "i8"),
        ("lost", "i8"),  # samples that did not fit
        ("sample", SENSOR_SAMPLE, _WAITING_MAX),
    ],
    align=True,
)


@kernel
def is_any_due(params, state, t_s):
    """Return whether a modelled sensor measures at ``t_s`` of the run."""
    for k in range(params.n):
        source = params.source[k]
        if source.models != 0 and exposure_time(state.track[k].next, source.rate_hz) <= t_s + TIME_SLACK_S:
            return True
    return False


@entry
def measure(params, state, t_s, true, w_CH_C, r_CT_H, q_CH):
    """Measure with each sensor that is due at ``t_s`` of the run.

    true: TRUTH. w_CH_C: (3,), true rate against H. r_CT_H, q_CH: of the bench.
    """
    for k in range(params.n):
        source, track = params.source[k], state.track[k]
        if source.models == 0 or exposure_time(track.next, source.rate_hz) > t_s + TIME_SLACK_S:
            continue
        number = track.next
        while exposure_time(track.next, source.rate_hz) <= t_s + TIME_SLACK_S:
            track.next += 1
        _measure_one(params, state, k, number, t_s, true, w_CH_C, r_CT_H, q_CH)


@kernel
def noise_of(seed, k, number, i):
    """Return standard normal ``i`` of measurement ``number`` of sensor ``k``; 0 for a negative ``seed``."""
    return normal(seed, number, _LANES * (k + 1) + _NOISE_LANE + i) if seed >= 0 else 0.0


@kernel
def _measure_one(params, state, k, number, t_s, true, w_CH_C, r_CT_H, q_CH):
    source, track, truth, output = params.source[k], state.track[k], state.truth, state.output
    truth.t_s = t_s
    truth.dt_s = t_s - track.measured_s if track.has_measured != 0 else 0.0
    track.measured_s, track.has_measured = t_s, 1
    if source.sees_bench != 0:
        copy_into(truth.r_CT_H, r_CT_H)
        copy_into(truth.q_CH, q_CH)
    else:
        copy_into(truth.r_CT_H, true.r_CT_H)
        copy_into(truth.q_CH, true.q_CH)
    copy_into(truth.v_CT_H, true.v_CT_H)
    copy_into(truth.w_CH_C, w_CH_C)
    copy_into(truth.r_T_I, true.r_T_I)
    copy_into(truth.v_T_I, true.v_T_I)
    copy_into(truth.q_HI, true.q_HI)
    copy_into(truth.sun_I, params.sun_I)
    truth.sunlight = true.sunlight
    copy_into(truth.memory, track.memory)
    first = _LANES * (k + 1)
    for i in range(NORMALS):
        truth.normal[i] = noise_of(params.seed, k, number, i)
    sample = output.sample
    output.valid = 1
    sample.sensor, sample.number, sample.t_s, sample.status = k, number, t_s, 0
    fill(sample.value, 0.0)
    fill_matrix(sample.covariance, 0.0)
    call_address(source.measure, truth, output, source)
    copy_into(track.memory, truth.memory)
    if output.valid == 0 or uniform(params.seed, number, first + _LOSS_LANE) < source.loss:
        return
    sample.received_s = t_s + source.latency_s
    put_sample(params, state, sample)


@kernel
def put_sample(params, state, sample):
    """Take ``sample`` (SENSOR_SAMPLE) on its way to the loop, with the faults that act on its sensor."""
    if not _disturb(params, state, sample):
        return
    if state.waiting == _WAITING_MAX:
        state.lost += 1
        return
    copy_record(sample, state.sample[state.waiting])
    state.waiting += 1


@kernel
def _disturb(params, state, sample):
    """Let the faults act on ``sample``; return whether it is passed on."""
    track, k = state.track[sample.sensor], sample.sensor
    first = _LANES * (k + 1) + _FAULT_LANE
    frozen = is_stamped_late = False
    for i in range(params.faults.n):
        row = params.faults.row[i]
        if int(row[NUMBER]) != k or not is_active(row, sample.t_s):
            continue
        kind = int(row[KIND])
        if kind == NO_SAMPLE:
            return False
        if kind == FROZEN:
            frozen = track.has_sample != 0
        elif kind in (OFFSET, DRIFT):
            factor = 1.0 if kind == OFFSET else sample.t_s - row[AT]
            for j in range(3):
                sample.value[j] += factor * row[VALUE + j]
        elif kind == OUTLIER and row[SIZE] > 0.0:
            displace_at_random(row[VALUE], row[SIZE], params.faults.seed, sample.number, first, sample.value)
        elif kind == OUTLIER:
            if uniform(params.faults.seed, sample.number, first) < row[VALUE]:
                for j in range(COMPONENTS_MAX):
                    sign = 1.0 if uniform(params.faults.seed, sample.number, first + 1 + j) < 0.5 else -1.0
                    sample.value[j] += sign * _OUTLIER_SIGMAS * math.sqrt(sample.covariance[j, j])
        elif kind == SIGMA_SCALE:
            for j in range(COMPONENTS_MAX):
                for m in range(COMPONENTS_MAX):
                    sample.covariance[j, m] *= row[VALUE] ** 2
        elif kind == LATENCY:
            sample.received_s += row[VALUE]
            is_stamped_late = is_stamped_late or row[OPTION] == AT_ARRIVAL
        else:
            for j in range(COMPONENTS_MAX):
                excess = math.sqrt(max(0.0, row[VALUE] ** 2 - 1.0) * sample.covariance[j, j])
                sample.value[j] += excess * normal(params.faults.seed, sample.number, first + 8 + j)
    if is_stamped_late:
        sample.t_s = sample.received_s
    if frozen:
        copy_into(sample.value, track.frozen.value)
        for i in range(COMPONENTS_MAX):
            for j in range(COMPONENTS_MAX):
                sample.covariance[i, j] = track.frozen.covariance[i, j]
    else:
        copy_record(sample, track.frozen)
        track.has_sample = 1
    return True


@entry
def deliver(state, t_s, inbox):
    """Move the samples that have arrived by ``t_s`` of the run to ``inbox``, in the order of arrival.

    inbox: SENSOR_FUSION_STATE. Those that do not fit wait for the next cycle.
    """
    inbox.arrived = 0
    while inbox.arrived < SAMPLES_PER_CYCLE:
        earliest = -1
        for i in range(state.waiting):
            if state.sample[i].received_s <= t_s + TIME_SLACK_S and (
                earliest < 0 or state.sample[i].received_s < state.sample[earliest].received_s
            ):
                earliest = i
        if earliest < 0:
            return
        arrival = inbox.arrival[inbox.arrived]
        copy_record(state.sample[earliest], arrival.sample)
        arrival.result, arrival.nis = NOT_USED, np.nan
        fill(arrival.innovation, np.nan)
        inbox.arrived += 1
        state.waiting -= 1
        for i in range(earliest, state.waiting):  # the order of the others stays
            copy_record(state.sample[i + 1], state.sample[i])


@kernel
def log_arrivals(inbox, cycle, log, logged):
    """Write the arrivals of ``cycle`` into ``log``, of SENSOR_ARRIVAL, from ``logged`` on; return its rows."""
    for i in range(inbox.arrived):
        inbox.arrival[i].cycle = cycle
        if logged < log.shape[0]:
            copy_record(inbox.arrival[i], log[logged])
            logged += 1
    return logged
