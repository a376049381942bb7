"""Integrity of the navigation: admission of poses, monitors of the innovations, health, protection levels.

A pose is admitted if it can be a measurement. The innovations of the accepted ones are watched by two monitors: the
mean NIS against noise that is larger than reported, and a CUSUM (Page 1954) of each normalised innovation against a
bias that grows too slowly for the gate. The protection level bounds the error that the covariance and these monitors
leave possible (docs/explanation/integrity.md).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.gnc_records import GncHealth
from hil.core.jit import entry, kernel
from hil.core.messages import POSE
from hil.gnc.estimation import sensor_monitor, thrust_model
from hil.gnc.estimation.error_state import V
from hil.gnc.estimation.sensor_monitor import largest_missed
from hil.maths import elementary
from hil.maths.arrays import copy_into, fill
from hil.maths.record_view import copy_record
from hil.sensors.vision_unit import pose as vmu_pose

VISION_LOST, VISION_SUSPECT, COVARIANCE_INVALID, CAUSE_UNKNOWN = (
    GncHealth.VISION_LOST.value,
    GncHealth.VISION_SUSPECT.value,
    GncHealth.COVARIANCE_INVALID.value,
    GncHealth.CAUSE_UNKNOWN.value,
)
SUMS: Final = 12
"""CUSUMs: of six innovations, and of sum and difference of each pair of position."""
LEVEL_TERMS: Final = 5
"""Terms of a protection level: noise, undetected fault of the poses, its growth since the last pose, reopened gate,
bound of the second sensor."""
USUAL_SUM: Final = 12.0
"""Sum that noise reaches about once in a minute, standard deviations: the level of a go contains what it hides."""
_OVERSHOOT = 1.166  # of a sum of normal innovations beyond its limit, standard deviations (Siegmund 1985)
_REPEATS_MAX = 2  # repetitions of a pose with all its digits: with noise none are expected
_FOLLOW_EACH = 4  # accepted poses
_CONVERGES = 4.0  # times the variance of the velocity: what it was
_JUMP_S = 60.0  # in which a change of the dynamics is estimated
_SPREADS = 6.0  # standard deviations of the corrections of the velocity
_GAP_INTERVALS = 3.0  # between poses, from which on there is a gap
_CAP_S = 5.0  # after it
_CONFIRMED_FRACTION = 4  # of the accepted poses: the longest time over which a bias can have grown while they agree

INTEGRITY_PARAMS = np.dtype(
    [
        ("range_max", "f8"),  # m, of a pose
        ("sigma_max", "f8"),  # m, of a pose
        ("sigma_angle_max", "f8"),  # rad
        ("lost_after_s", "f8"),  # age of the last accepted pose from which on vision is lost
        ("suspect_after", "i8"),  # consecutive rejections from which on it is suspect
        ("mean_shift", "f8"),  # standard deviations, reference value of the CUSUM
        ("cusum_limit", "f8"),  # standard deviations
        ("nis_weight", "f8"),  # weight of a pose in the mean NIS
        ("nis_limit", "f8"),  # largest mean of three components
        ("gate", "f8"),  # standard deviations of one component that the gate passes
        ("sigmas", "f8"),  # in a protection level, from the integrity risk
        ("sigmas_go", "f8"),  # in the level that a go needs, from the certificate's risk
        ("vision_range", "f8"),  # m, up to which vision is expected
        ("go_interval_s", "f8"),  # mean time between two withdrawals of a go by the sums of sound poses
    ],
    align=True,
)

INTEGRITY_STATE = np.dtype(
    [
        ("refused", "i8"),  # poses that are no measurement
        ("refused_in_a_row", "i8"),
        ("repeats", "i8"),  # consecutive, of the last pose with another time
        ("last", POSE),
        ("monitored", "i8"),  # accepted poses so far
        ("high", "f8", SUMS),  # CUSUM of each innovation, position then attitude, and of pairs of position, upwards
        ("low", "f8", SUMS),  # and downwards
        ("doubted", "i8"),  # how often the rate was estimated again
        ("biased", "i8"),  # 1: a CUSUM has passed its limit; it stays so, as the filters follow a bias
        ("mean_nis", "f8", 2),  # position, attitude
        ("followed", "f8"),  # standard deviations of an innovation: error of the largest fault that is not found yet
        ("followed_speed", "f8"),  # 1/s, of the ramp that is never found, the same per second
        ("spread_mps", "f8"),  # standard deviation of the corrections of the velocity, largest
        ("drags", "i8"),  # 1: they are more than thrust and noise explain
        ("dragged", "f8"),  # the largest one, over what these explain
        ("cusum_go", "f8"),  # largest sum of the CUSUM with which there is a go, standard deviations
        ("worst", "f8"),  # largest sum
        ("worst_of", "i8"),  # its number
        ("peak", "f8"),  # largest one so far, over its limit
        ("followed_go", "f8"),  # as followed, of a fault that the present sums do not show
        ("go_m", "f8", 3),  # level that a go needs
        ("level", "f8", 3),  # m, protection level of the cycle before
        ("terms", "f8", (LEVEL_TERMS, 3)),  # m, of which it consists, see ``LEVEL_TERMS``
        ("cap", "f8", 3),  # m, the level when poses returned after a gap: with them less is possible, not more
        ("cap_s", "f8"),
        ("cause", "i8"),  # of the present inconsistency, ``NAMED`` or a hypothesis that explains it as well
        ("age_s", "f8"),  # age of the last accepted pose, in the previous cycle
        ("second_m", "f8"),  # bound on the position error by a second sensor, 0 for none
        ("second_s", "f8"),  # at this time of the run
        ("restarted_s", "f8"),  # when the filters were started again: a bound of before is none
    ],
    align=True,
)


@kernel
def _is_repeated(state, pose):
    """Return whether ``pose`` has all digits of the one before at another time, more often than by chance."""
    if not vmu_pose.is_repeat(state.last, pose):
        state.repeats = 0
    elif pose.t_s != state.last.t_s:
        state.repeats += 1
    copy_record(pose, state.last)
    return state.repeats > _REPEATS_MAX


@kernel
def admits(params, state, pose):
    """Return whether ``pose`` may be passed to the filters; count it if not."""
    is_one = vmu_pose.is_measurement(params.range_max, params.sigma_max, params.sigma_angle_max, pose)
    if is_one and not _is_repeated(state, pose):
        state.refused_in_a_row = 0
        return True
    state.refused += 1
    state.refused_in_a_row += 1
    return False


@kernel
def monitor(params, state, innovation, nis_position, nis_attitude):
    """Take an accepted pose: its normalised innovation (6,), position then attitude, and the NIS of both filters.

    nis_attitude: nan for a position alone, whose innovation of the attitude is 0.
    """
    state.monitored += 1
    state.worst = 0.0
    for i in range(SUMS):
        value = innovation[min(i, 5)]
        if i >= 6:  # a fault between two axes is no larger before it is found than one along an axis
            a, b = innovation[(i - 6) // 2], innovation[((i - 6) // 2 + 1) % 3]
            value = math.sqrt(0.5) * (a + b if i % 2 == 0 else a - b)
        state.high[i] = max(0.0, state.high[i] + value - params.mean_shift)
        state.low[i] = max(0.0, state.low[i] - value - params.mean_shift)
        if state.high[i] > params.cusum_limit or state.low[i] > params.cusum_limit:
            state.biased = 1
        larger = max(state.high[i], state.low[i])
        if larger > state.worst:
            state.worst, state.worst_of = larger, i
    state.peak = max(state.peak, state.worst / params.cusum_limit)
    weight = max(params.nis_weight, 1.0 / state.monitored)
    state.mean_nis[0] += weight * (nis_position - state.mean_nis[0])
    if not math.isnan(nis_attitude):
        state.mean_nis[1] += weight * (nis_attitude - state.mean_nis[1])


@kernel
def vision_health(params, state, age_s, rejected_in_a_row, distance):
    """Return the bits of the vision unit. age_s: of the last accepted pose. distance: of the target, m."""
    health = 0
    if age_s > params.lost_after_s and distance <= params.vision_range:
        health |= VISION_LOST
    noisy = state.monitored * params.nis_weight >= 1.0 and max(state.mean_nis[0], state.mean_nis[1]) > params.nis_limit
    if max(rejected_in_a_row, state.refused_in_a_row) >= params.suspect_after or noisy or state.biased != 0:
        health |= VISION_SUSPECT
    if state.drags != 0:
        health |= VISION_SUSPECT
    return health


@kernel
def missed_shift(params, accepted):
    """Return the largest bias of the innovations that both monitors can miss, in sigma, and over how many poses.

    ``mean_shift + cusum_limit / n`` over n poses: up to the CUSUM's own time constant, and a fraction of the
    ``accepted`` poses; at most what the gate passes.
    """
    n = params.cusum_limit / params.mean_shift
    n = min(n, max(1.0, accepted / _CONFIRMED_FRACTION))
    return min(params.gate, params.mean_shift + params.cusum_limit / n), n


@kernel
def go_sum(params, interval_s):
    """Return the largest sum of the CUSUM for a go, standard deviations, with poses every ``interval_s``.

    The sums of sound poses, upwards and downwards, pass it once in ``go_interval_s`` in the mean: Siegmund's run length
    (exp(2 k b) - 2 k b - 1) / (2 k^2) with b = h + 1.166, inverted by iteration.
    """
    if not interval_s > 0.0:
        return params.cusum_limit
    twice = 2.0 * params.mean_shift
    length = 0.5 * twice * twice * 2.0 * SUMS * params.go_interval_s / interval_s
    power = elementary.log(length + 1.0)
    power = elementary.log(length + 1.0 + power)
    return min(params.cusum_limit, max(0.0, power / twice - _OVERSHOOT))


@kernel
def follow(params, state, fusion, dt_s):
    """Write ``followed``, ``followed_speed`` and ``followed_go``, of the largest faults of the poses that are missed.

    Gains change slowly: one in ``_FOLLOW_EACH`` accepted poses is enough. After a change of the dynamics that the
    accelerometer has shown, gains are larger; but then this is the fault, and the poses are sound.
    """
    if fusion.accepted % _FOLLOW_EACH != 1:
        return
    if fusion.thrust.jumped > 0 and state.followed > 0.0 and (fusion.cycle - fusion.thrust.jumped) * dt_s < _JUMP_S:
        return
    _, n = missed_shift(params, fusion.accepted)
    most = np.inf  # ramp that corrections of the velocity do not show, per pose
    if fusion.noise_m > 0.0:
        most = _SPREADS * state.spread_mps * fusion.interval_s / fusion.noise_m
    gain, gain_speed = fusion.gain_position, fusion.gain_velocity * fusion.interval_s
    step, _ = largest_missed(params, gain, gain_speed, n, params.cusum_limit, 0, np.inf)
    ramp, speed = largest_missed(params, gain, gain_speed, n, params.cusum_limit, 1, most)
    state.followed = max(step, ramp)
    state.followed_speed = speed / fusion.interval_s if fusion.interval_s > 0.0 else 0.0
    state.cusum_go = go_sum(params, fusion.interval_s)
    limit = min(state.cusum_go, max(USUAL_SUM, state.worst))  # what the sums have reached, noise or not, is a fault
    n = min(n, limit / params.mean_shift)
    step, _ = largest_missed(params, gain, gain_speed, n, limit, 0, np.inf)
    ramp, _ = largest_missed(params, gain, gain_speed, n, limit, 1, most)
    state.followed_go = max(step, ramp)


@kernel
def watch_velocity(thrust, errors, state, fusion):
    """Compare the corrections of the velocity with what thrust and noise explain: the dynamics are a witness.

    A vision unit that drifts pulls the velocity along, however slowly. thrust: THRUST_PARAMS. errors: ERROR_STATE.
    """
    largest, state.dragged = 0.0, 0.0
    variance = max(fusion.filters.p[V, V], fusion.filters.p[V + 1, V + 1], fusion.filters.p[V + 2, V + 2])
    if fusion.thrust.spread == 0.0 or fusion.thrust.spread > _CONVERGES * variance:
        fusion.thrust.spread = variance  # corrections while the filters converge are none of these
        fill(fusion.corrected, 0.0)
    for i in range(3):
        spread = thrust_model.velocity_spread(thrust, errors, fusion.filters, fusion.thrust, i)
        largest = max(largest, spread)
        state.dragged = max(state.dragged, abs(fusion.corrected[i]) / (_SPREADS * spread))
    state.drags = 1 if state.dragged > 1.0 else 0
    state.spread_mps = largest


@kernel
def set_second(state, bound_m, t_s):
    """Take the bound ``bound_m`` on the position error by a second sensor, m, 0 for none, at ``t_s`` of the run."""
    state.second_m, state.second_s = bound_m, t_s


@kernel
def _second_bound(params, state, fusion, t_s, sigma_v, velocity):
    """Return the bound on the position error at ``t_s`` by the second sensor, m, inf if there is none.

    Since its measurement the estimate has moved away by its velocity error, and by poses up to the gate.
    """
    if state.second_m <= 0.0 or state.second_s < state.restarted_s or state.biased != 0:
        return np.inf
    largest = 0.0
    for i in range(3):
        largest = max(largest, sigma_v[i])
    drift = params.sigmas * largest + velocity
    if fusion.interval_s > 0.0:
        drift += params.gate * fusion.noise_m * fusion.gain_position / fusion.interval_s
    return state.second_m + drift * max(0.0, t_s - state.second_s)


@kernel
def _write_terms(state, i, noise, bias, grown, jump, other):
    """Write the terms of the level of component ``i``. other: level with the second sensor, which may be less."""
    terms, is_alone = state.terms, noise + bias + jump <= other
    terms[0, i], terms[3, i] = noise, jump
    terms[1, i], terms[2, i] = (bias - grown if bias < np.inf else np.inf, grown) if is_alone else (0.0, 0.0)
    terms[4, i] = 0.0 if is_alone else state.second_m


@entry
def protect(params, sensors, state, fusion, t_s, out):
    """Write the protection levels of ``out`` (NAVIGATION) at ``t_s``, from its sigmas and FUSION_STATE ``fusion``.

    sensors: SENSOR_FUSION_PARAMS. One fault at a time: of the poses, or of one of the sensors.

    ``K sigma`` and the error to which an undetected fault of the poses has led, as a velocity error since the last pose
    as well; and the jump of a gate that was opened again. After a gap the level is not above that of its end. A bias
    that the monitors have found has no bound. If poses or IMU are wrong, the second sensor is not: its bound, and the
    innovations' missed bias that an error of the IMU is, may be less.
    """
    shift, n = missed_shift(params, fusion.accepted)
    age_s = max(0.0, t_s - fusion.last_accepted_s)
    velocity = state.followed_speed * fusion.noise_m
    bias = state.followed * fusion.noise_m + velocity * age_s
    doubt = state.followed_go * fusion.noise_m
    unbounded = state.biased != 0 or fusion.unconfirmed != 0
    if unbounded:
        bias = doubt = np.inf
    second = _second_bound(params, state, fusion, t_s, out.sigma_v_mps, velocity)
    returns = fusion.updated != 0 and state.age_s > _GAP_INTERVALS * fusion.interval_s
    if returns:
        state.cap_s = t_s
        copy_into(state.cap, state.level)
    largest = 0.0
    for i in range(3):
        noise = params.sigmas * out.sigma_r_m[i]
        of_sensors = sensor_monitor.missed(sensors, fusion.sensors, t_s, i, out.sigma_r_m[i])
        other = max(noise + shift * fusion.noise_m, second + fusion.jump_m[i])
        level = min(noise + max(bias, of_sensors) + fusion.jump_m[i], other)
        if state.cap_s > 0.0 and t_s - state.cap_s < _CAP_S and state.biased == 0:
            level = min(level, state.cap[i] + velocity * (t_s - state.cap_s) + fusion.jump_m[i])
        _write_terms(state, i, noise, max(bias, of_sensors), velocity * age_s, fusion.jump_m[i], other)
        out.protection_level_m[i] = state.level[i] = level
        fault = min(max(doubt, of_sensors), second)
        state.go_m[i] = params.sigmas_go * out.sigma_r_m[i] + fault + fusion.jump_m[i]
        largest = max(largest, out.sigma_attitude_rad[i])
    state.age_s = age_s
    turned = max(
        shift * fusion.noise_rad * n * fusion.gain_attitude,
        sensor_monitor.missed_rotation(sensors, fusion.sensors, t_s, largest),
    )
    out.protection_level_rad = params.sigmas * largest + turned
    if unbounded:
        out.protection_level_rad = np.inf
