"""Monitor of one further sensor: whether it is suspect, and the error that a fault that it misses leads to."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.sensor_records import COMPONENTS_MAX
from hil.gnc.estimation.error_state import ROTATION, R, V


@kernel
def largest_missed(params, gain, gain_speed, n, limit, kind, most):
    """Return the largest error to which a fault leads until it is found, and the size of that fault.

    In standard deviations of an innovation. params: ``mean_shift`` of the CUSUM, ``gate`` of a component. gain,
    gain_speed: of position and velocity per measurement. kind: 0 a step, 1 a ramp of so much per measurement. limit: of
    the CUSUM. n: measurements. most: largest fault.
    Position and velocity follow the fault by the gains, and the innovations fade as they do; it is found when its
    normalised innovations have passed the gate or summed up to the limit.
    """
    r, v, total, missed, largest = 0.0, 0.0, 0.0, np.inf, 0.0
    for j in range(1, int(n) + 1):
        fault = 1.0 if kind == 0 else float(j)
        r += v
        innovation = fault - r
        r += gain * innovation
        v += gain_speed * innovation
        total += innovation
        size = (params.mean_shift * j + limit) / total if total > 0.0 else np.inf
        if innovation > 0.0:
            size = min(size, params.gate / innovation)
        if size < missed or most < missed:  # one that was found before has ended
            missed = min(missed, size)
            largest = max(largest, min(size, most) * abs(r))
    return largest, min(missed, most)


_WEIGHT = 0.1  # weight of an interval in the mean


@kernel
def mean_interval(mean_s, interval_s):
    """Return the mean after ``interval_s``; 0 before the first one.

    A gap is no interval: what counts is how soon measurements follow each other.
    """
    mean = min(interval_s, 1.0) if mean_s == 0.0 else mean_s
    return mean + _WEIGHT * (min(interval_s, 2.0 * mean) - mean)


_CONFIRMED_FRACTION = 4  # of the accepted samples: the longest time over which a fault can have grown
_SILENT_INTERVALS = 10.0  # after the last accepted sample
_SHORTEST_S = 1.0
_NO_CHANGE = 1e-12  # variance ratio of a component that the estimate does not follow

SENSOR_MONITOR = np.dtype(
    [
        ("accepted", "i8"),
        ("rejected", "i8"),
        ("excluded", "i8"),
        ("late", "i8"),
        ("rejected_in_a_row", "i8"),
        ("suspect", "i8"),  # 1: as of this sample, 2: excluded
        ("suspected", "i8"),  # how often
        ("high", "f8", COMPONENTS_MAX),  # CUSUM of each normalised innovation upwards
        ("low", "f8", COMPONENTS_MAX),  # and downwards
        ("mean_nis", "f8"),  # per component
        ("total_nis", "f8"),
        ("judged", "i8"),  # components in ``total_nis``
        ("last_s", "f8"),  # newest accepted sample
        ("interval_s", "f8"),  # between accepted samples
        ("missed_m", "f8", 3),  # error of the position by the largest fault that is not found, in H
        ("missed_mps", "f8", 3),  # missed velocity
        ("missed_rad", "f8"),
    ],
    align=True,
)
"""What is known of one sensor."""


@kernel
def count(monitor, t_s):
    """Count an accepted sample of ``t_s``."""
    monitor.accepted += 1
    if t_s > monitor.last_s and monitor.accepted > 1:
        monitor.interval_s = mean_interval(monitor.interval_s, t_s - monitor.last_s)
    monitor.last_s = max(monitor.last_s, t_s)


@kernel
def watch(params, monitor, n, arrival, passes):
    """Take the innovations of a sample into the monitors of its sensor: suspect, or no longer.

    params: SENSOR_FUSION_PARAMS. A suspicion is lifted once all sums are half their limit or less and the mean NIS is
    that of the covariance.
    """
    largest = 0.0
    if math.isfinite(arrival.nis):
        for i in range(n):
            value = max(-params.gate, min(params.gate, arrival.innovation[i]))
            monitor.high[i] = min(2.0 * params.cusum_limit, max(0.0, monitor.high[i] + value - params.mean_shift))
            monitor.low[i] = min(2.0 * params.cusum_limit, max(0.0, monitor.low[i] - value - params.mean_shift))
            largest = max(largest, max(monitor.high[i], monitor.low[i]))
        seen = monitor.judged // n
        weight = max(params.nis_weight, 1.0 / (seen + 1))
        per_component = min(arrival.nis / n, params.gate**2)
        monitor.mean_nis += weight * (per_component - monitor.mean_nis)
        monitor.judged += n
        monitor.total_nis += arrival.nis
    monitor.rejected_in_a_row = 0 if passes else monitor.rejected_in_a_row + 1
    noisy = monitor.judged * params.nis_weight >= n and monitor.mean_nis > params.nis_limit
    if monitor.suspect == 0:
        if largest > params.cusum_limit or monitor.rejected_in_a_row >= params.suspect_after or noisy:
            monitor.suspect = 1
            monitor.suspected += 1
    elif passes and largest <= 0.5 * params.cusum_limit and not noisy:
        monitor.suspect = 0


@kernel
def bound_missed(params, innovation, monitor, n):
    """Raise the ``missed`` errors by what a fault of one of ``n`` components leads to before it is found.

    innovation: INNOVATION. The fault is a step or a ramp of the component, which the expected value follows by
    ``h K = 1 - R / S``, and position, velocity and attitude by their gains. It can have grown for a fraction of the
    accepted samples at most.
    """
    steps = min(params.cusum_limit / params.mean_shift, max(1.0, monitor.accepted / _CONFIRMED_FRACTION))
    for c in range(n):
        follows, speed = 1.0 - innovation.noise[c, c] / innovation.s[c, c], 0.0
        if not follows > _NO_CHANGE:
            continue
        for i in range(3):
            speed += innovation.h[c, R + i] * innovation.gain[c, V + i] * monitor.interval_s
        step, _ = largest_missed(params, follows, speed, steps, params.cusum_limit, 0, np.inf)
        ramp, _ = largest_missed(params, follows, speed, steps, params.cusum_limit, 1, np.inf)
        size = max(step, ramp) * math.sqrt(innovation.s[c, c]) / follows
        for i in range(3):
            monitor.missed_m[i] = max(monitor.missed_m[i], size * abs(innovation.gain[c, R + i]))
            monitor.missed_mps[i] = max(monitor.missed_mps[i], size * abs(innovation.gain[c, V + i]))
            monitor.missed_rad = max(monitor.missed_rad, size * abs(innovation.gain[c, ROTATION + i]))


@kernel
def _left(params, monitor, error, t_s, sigma):
    """Return the part of ``error``, caused by a fault of a sensor, that remains in the estimate at ``t_s``.

    Once the sensor has been silent for long, the other sensors bound the error: their gates, in standard deviations
    ``sigma``, pass no more.
    """
    if t_s - monitor.last_s > _SILENT_INTERVALS * max(monitor.interval_s, _SHORTEST_S):
        return min(error, params.gate * sigma)
    return error


@kernel
def missed(params, state, t_s, i, sigma):
    """Return the error of the position along axis ``i`` at ``t_s`` by an undetected fault of one sensor, m.

    params, state: SENSOR_FUSION_PARAMS, SENSOR_FUSION_STATE. sigma: of that component of the position, m.
    """
    largest = 0.0
    for k in range(params.n):
        monitor = state.monitor[k]
        error = monitor.missed_m[i] + monitor.missed_mps[i] * max(0.0, t_s - monitor.last_s)
        largest = max(largest, _left(params, monitor, error, t_s, sigma))
    return largest


@kernel
def missed_rotation(params, state, t_s, sigma):
    """Return the same of the attitude, rad. sigma: the largest of a component."""
    largest = 0.0
    for k in range(params.n):
        largest = max(largest, _left(params, state.monitor[k], state.monitor[k].missed_rad, t_s, sigma))
    return largest


@kernel
def is_suspect(params, state):
    """Return whether a sensor is excluded."""
    suspects = 0
    for k in range(params.n):
        suspects += state.monitor[k].suspect
    return suspects != 0
