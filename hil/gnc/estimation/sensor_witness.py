"""Witness: a sensor that is not fused, but compared with the navigation, whose error it bounds.

The estimate is carried back to the measurement with its own rates. They disagree if a component of the innovation is
larger than the constant errors of a sound sensor and some standard deviations of both. Several consecutive
disagreements set the interlock, as many agreements release it; it stays set while nothing is measured.

A measurement that gives the position in three components also bounds the estimate's error, whatever the sensors of the
navigation measure: by the difference and by what the witness itself can be wrong.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.sensor_records import ACCEPTED, COMPONENTS_MAX, LATE, NOT_USED, REJECTED
from hil.gnc.estimation.sensor_innovation import innovate
from hil.maths import eigenvalues, stack
from hil.maths.arrays import fill

_OBSERVED_RAD = 0.5  # an angle with a larger standard deviation is not observed
_ROTATES = 1e-6  # deviation of the sensitivity to the position from a rotation

WITNESS_PARAMS = np.dtype(
    [
        ("acceleration", "f8"),  # m/s^2, largest of the chaser: the estimate is carried back with its velocity
        ("angular_acceleration", "f8"),  # rad/s^2
        ("age_max_s", "f8"),  # largest age of a measurement that is compared
        ("step_s", "f8"),  # age of the estimate: it is that of the cycle before
        ("bound_sigmas", "f8"),  # standard deviations of the witness in the bound on the estimate's error
    ],
    align=True,
)

WITNESS = np.dtype(
    [
        ("disagrees", "i8"),  # 1: the interlock is set
        ("compared", "i8"),  # measurements
        ("last_s", "f8"),  # the newest of them, time of the run
        ("beyond", "i8"),  # compared measurements that disagree
        ("beyond_in_a_row", "i8"),
        ("within_in_a_row", "i8"),
        ("component", "i8"),  # component of the last disagreement
        ("value", "f8"),  # its difference
        ("limit", "f8"),  # what is allowed
        ("bound_m", "f8"),  # largest position error of the estimate by the newest measurement, 0 for none
    ],
    align=True,
)
"""What is known of one witness."""


@kernel
def _known(sigma):
    """Return ``sigma``, 0 if it is not known (nan)."""
    return sigma if sigma > 0.0 else 0.0


@kernel
def _moved(params, h, i, age_s):
    """Return by how much accelerations within ``age_s`` can have changed component ``i``. h: its sensitivities."""
    position = math.sqrt(h[i, 0] ** 2 + h[i, 1] ** 2 + h[i, 2] ** 2)
    rotation = math.sqrt(h[i, 6] ** 2 + h[i, 7] ** 2 + h[i, 8] ** 2)
    return 0.5 * age_s * age_s * (position * params.acceleration + rotation * params.angular_acceleration)


@kernel
def _variance(innovation, navigation, i, age_s):
    """Return the variance of component ``i`` of the innovation: noise, and the stated errors of the estimate."""
    total, h = innovation.noise[i, i], innovation.h
    for j in range(3):
        r, v = _known(navigation.sigma_r_m[j]), _known(navigation.sigma_v_mps[j])
        total += h[i, j] ** 2 * (r * r + (age_s * v) ** 2) + (h[i, 3 + j] * v) ** 2
        total += (h[i, 6 + j] * _known(navigation.sigma_attitude_rad[j])) ** 2
    return total


@kernel
def _agrees(params, slot, witness, innovation, navigation, age_s, arrival):
    """Return whether no component of ``innovation`` is beyond its limit; keep the first one that is."""
    agrees, arrival.nis = True, 0.0
    for i in range(slot.n):
        variance, value = _variance(innovation, navigation, i, age_s), innovation.value[i]
        arrival.innovation[i] = value / math.sqrt(variance)
        arrival.nis += arrival.innovation[i] ** 2
        limit = innovation.tolerance[i] + _moved(params, innovation.h, i, age_s) + slot.sigmas * math.sqrt(variance)
        if agrees and not abs(value) <= limit:  # nan is beyond
            agrees = False
            witness.component, witness.value, witness.limit = i, abs(value), limit
    return agrees


@kernel
def _is_rotation(h, row, column):
    """Return whether three rows of ``h`` from ``row`` on are orthonormal in three columns from ``column`` on."""
    for i in range(3):
        for j in range(3):
            product = 0.0
            for k in range(3):
                product += h[row + i, column + k] * h[row + j, column + k]
            if not abs(product - (1.0 if i == j else 0.0)) <= _ROTATES:
                return False
    return True


@kernel
def _rotation_error(params, innovation, navigation, n, age_s):
    """Return the largest error of the estimate's attitude, rad: its protection level, or by the measured rotation."""
    level, most, square, tolerance = navigation.protection_level_rad, 0.0, 0.0, 0.0
    if n < COMPONENTS_MAX or not _is_rotation(innovation.h, 3, 6):
        return level
    for i in range(3, 6):
        most = max(most, innovation.noise[i, i])
        square += innovation.value[i] ** 2
        tolerance = max(tolerance, innovation.tolerance[i])
    if most > _OBSERVED_RAD**2:
        return level
    measured = math.sqrt(square) + tolerance + params.bound_sigmas * math.sqrt(most)
    measured += 0.5 * age_s * age_s * params.angular_acceleration
    return level if level <= measured else measured  # nan: none is reported


@kernel
def _error_bound(params, innovation, navigation, n, age_s):
    """Return the largest position error of the estimate at the time of a sound measurement, m; 0 if it has no bound.

    The difference, the constant errors, noise, and the estimate's error of the attitude over its lever arm, the largest
    singular value of the sensitivity to it.
    """
    h = innovation.h
    if n < 3 or not _is_rotation(h, 0, 0):
        return 0.0
    gram, square, most, tolerance = stack.matrix(3, 3), 0.0, 0.0, 0.0
    for i in range(3):
        square += innovation.value[i] ** 2
        most, tolerance = max(most, innovation.noise[i, i]), max(tolerance, innovation.tolerance[i])
        for j in range(3):
            gram[i, j] = h[0, 6 + i] * h[0, 6 + j] + h[1, 6 + i] * h[1, 6 + j] + h[2, 6 + i] * h[2, 6 + j]
    lever = math.sqrt(max(0.0, eigenvalues.largest_eigenvalue(gram)))
    bound = math.sqrt(square) + tolerance + params.bound_sigmas * math.sqrt(most)
    bound += 0.5 * age_s * age_s * params.acceleration
    if lever > 0.0:
        bound += lever * _rotation_error(params, innovation, navigation, n, age_s)
    return bound if math.isfinite(bound) else 0.0


@kernel
def _compare(params, state, t_s, navigation, arrival):
    """Compare one sample of a witness with the estimate of the cycle before ``t_s`` of the run."""
    slot, witness = params.slot[arrival.sample.sensor], state.witness[arrival.sample.sensor]
    monitor, age_s = state.monitor[arrival.sample.sensor], t_s - params.witness.step_s - arrival.sample.t_s
    arrival.result, arrival.nis = NOT_USED, np.nan
    fill(arrival.innovation, np.nan)
    if navigation.valid == 0 or slot.enabled == 0:
        return
    if not age_s <= params.witness.age_max_s:
        arrival.result = LATE
        monitor.late += 1
        return
    innovate(
        params, slot, state, arrival.sample, navigation.r_CT_H, navigation.v_CT_H, navigation.q_CH, navigation.w_CH_C,
        -age_s,
    )  # fmt: skip
    witness.compared += 1
    witness.last_s = arrival.sample.t_s
    witness.bound_m = _error_bound(params.witness, state.innovation, navigation, slot.n, age_s)
    agrees = _agrees(params.witness, slot, witness, state.innovation, navigation, age_s, arrival)
    if math.isfinite(arrival.nis):
        monitor.total_nis += arrival.nis
        monitor.judged += slot.n
    if agrees:
        arrival.result = ACCEPTED
        monitor.accepted += 1
        witness.within_in_a_row += 1
        witness.beyond_in_a_row = 0
        if witness.within_in_a_row >= slot.samples:
            witness.disagrees = 0
    else:
        arrival.result = REJECTED
        monitor.rejected += 1
        witness.beyond += 1
        witness.beyond_in_a_row += 1
        witness.within_in_a_row = 0
        if witness.beyond_in_a_row >= slot.samples:
            witness.disagrees = 1


@kernel
def compare_witnesses(params, state, t_s, navigation):
    """Compare what witnesses have measured with ``navigation`` (NAVIGATION), the estimate of the cycle before ``t_s``.

    params, state: SENSOR_FUSION_PARAMS, SENSOR_FUSION_STATE with the samples that have arrived by ``t_s`` of the run.
    The smallest bound of this cycle is kept in ``state.bound_m`` and ``bound_s``. A measurement that is too old, or
    that comes before the first estimate, does not count. Returns 1 if an interlock is set, else 0.
    """
    bounded = False
    for k in range(state.arrived):
        arrival = state.arrival[k]
        if params.slot[arrival.sample.sensor].witness == 0:
            continue
        _compare(params, state, t_s, navigation, arrival)
        if arrival.result == ACCEPTED or arrival.result == REJECTED:
            witness = state.witness[arrival.sample.sensor]
            if not bounded or 0.0 < witness.bound_m < state.bound_m or state.bound_m == 0.0:
                state.bound_m, state.bound_s, bounded = witness.bound_m, witness.last_s, True
    disagrees = 0
    for k in range(params.n):
        disagrees = max(disagrees, state.witness[k].disagrees)
    return disagrees
