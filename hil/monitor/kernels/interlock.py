"""Interlock: the navigation's estimate against the docking monitor's measurements, an independent sensor.

The estimate is carried back to the measurement with its own rates, and gives the pose at which the docking target
should have been seen. They disagree if a component differs by more than the errors of the mounting and ``sigmas``
standard deviations of both. ``frames`` consecutive disagreements set the interlock, as many agreements release it; it
stays set while nothing is measured.

A measurement of a sound monitor also bounds the estimate's error, whatever the vision unit measures: by the difference
and by what the monitor itself can be wrong.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.models.mounting import camera_pose

_OBSERVED_RAD = 0.5  # an angle with a larger standard deviation is not observed

INTERLOCK_PARAMS = np.dtype(
    [
        ("sigmas", "f8"),
        ("position", "f8"),  # m, error of the mounting
        ("attitude", "f8"),  # rad, the same; also of the line of sight
        ("frames", "i8"),  # consecutive
        ("acceleration", "f8"),  # m/s^2, largest of the chaser: the estimate is carried back with its velocity
        ("angular_acceleration", "f8"),  # rad/s^2
        ("age_max_s", "f8"),  # of a measurement that is compared
        ("step_s", "f8"),  # age of the estimate: it is that of the cycle before
        ("bound_sigmas", "f8"),  # standard deviations of the monitor in the bound on the estimate's error
    ],
    align=True,
)

INTERLOCK_STATE = np.dtype(
    [
        ("disagrees", "i8"),  # 1: the interlock is set
        ("compared", "i8"),  # measurements
        ("last_s", "f8"),  # the newest of them, time of the run
        ("beyond", "i8"),  # of them those that disagree
        ("beyond_in_a_row", "i8"),
        ("within_in_a_row", "i8"),
        ("component", "i8"),  # of the last disagreement: 0 to 2 position, 3 to 5 attitude, in the camera's axes
        ("value", "f8"),  # its difference, m or rad
        ("limit", "f8"),  # what is allowed
        ("bound_m", "f8"),  # largest position error of the estimate by the newest measurement, 0 for none
    ],
    align=True,
)


@kernel
def _known(sigma):
    """Return ``sigma``, 0 if it is not known (nan)."""
    return sigma if sigma > 0.0 else 0.0


@kernel
def _is_beyond(state, component, difference, limit):
    """Return whether a difference exceeds its limit, and keep it."""
    if abs(difference) <= limit:  # nan is beyond
        return False
    state.component, state.value, state.limit = component, abs(difference), limit
    return True


@kernel
def _seen_from(estimate, mounting, age_s, t_v, q_vt):
    """Write the pose of the target in the camera ``age_s`` before ``estimate``."""
    r, back, before, q = stack.vector(3), stack.vector(3), stack.vector(4), stack.vector(4)
    for i in range(3):
        r[i] = estimate.r_CT_H[i] - age_s * estimate.v_CT_H[i]
        back[i] = -age_s * estimate.w_CH_C[i]
    quat.from_rotation_vector_into(back, before)
    quat.multiply_into(before, estimate.q_CH, q)
    camera_pose(mounting, r, q, t_v, q_vt)


@kernel
def _disagrees(params, mounting, state, t_v, q_vt, variance, estimate, age_s):
    """Return whether a measurement, with the variances (6,) of its components, and ``estimate`` are too far apart."""
    seen, q_seen, rotation = stack.vector(3), stack.vector(4), stack.vector(3)
    _seen_from(estimate, mounting, age_s, seen, q_seen)
    attitude, of_position, square = 0.0, 0.0, 0.0
    for i in range(3):
        attitude = max(attitude, _known(estimate.sigma_attitude_rad[i]) ** 2)
        position = _known(estimate.sigma_r_m[i]) ** 2 + (age_s * _known(estimate.sigma_v_mps[i])) ** 2
        of_position = max(of_position, position)
        square += seen[i] * seen[i]
    # an error of the attitude moves the target across the line of sight
    of_position += square * attitude
    moved = 0.5 * age_s * age_s
    tolerance = params.position + params.attitude * math.sqrt(square) + moved * params.acceleration
    for i in range(3):
        limit = tolerance + params.sigmas * math.sqrt(of_position + variance[i])
        if _is_beyond(state, i, t_v[i] - seen[i], limit):
            return True
    for i in range(3):
        if variance[3 + i] > _OBSERVED_RAD**2:
            return False
    quat.rotation_between(q_vt, q_seen, rotation)
    for i in range(3):
        limit = params.attitude + params.sigmas * math.sqrt(attitude + variance[3 + i])
        limit += moved * params.angular_acceleration
        if _is_beyond(state, 3 + i, rotation[i], limit):
            return True
    return False


@kernel
def _error_bound(params, mounting, t_v, q_vt, variance, estimate, age_s):
    """Return the largest position error of ``estimate`` at the time of a sound measurement, m; 0 if it has no bound.

    In each axis: the difference, the errors of the mounting, noise, and the estimate's error of the attitude over the
    distance, which the measured attitude or the protection level bounds.
    """
    seen, q_seen, rotation = stack.vector(3), stack.vector(4), stack.vector(3)
    _seen_from(estimate, mounting, age_s, seen, q_seen)
    square, apart, angle = 0.0, 0.0, 0.0
    of_position, of_attitude = 0.0, 0.0
    for i in range(3):
        square += seen[i] * seen[i]
        apart += (t_v[i] - seen[i]) ** 2
        of_position, of_attitude = max(of_position, variance[i]), max(of_attitude, variance[3 + i])
    moved = 0.5 * age_s * age_s
    attitude = estimate.protection_level_rad
    if of_attitude <= _OBSERVED_RAD**2:
        quat.rotation_between(q_vt, q_seen, rotation)
        for i in range(3):
            angle += rotation[i] * rotation[i]
        measured = math.sqrt(angle) + params.attitude + params.bound_sigmas * math.sqrt(of_attitude)
        measured += moved * params.angular_acceleration
        if not attitude <= measured:  # nan: none is reported
            attitude = measured
    distance = math.sqrt(square)
    bound = math.sqrt(apart) + params.position + params.bound_sigmas * math.sqrt(of_position)
    bound += (params.attitude + attitude) * distance + moved * params.acceleration
    return bound if math.isfinite(bound) else 0.0


@kernel
def compare_estimate(params, mounting, state, t_s, measured_s, t_v, q_vt, variance, estimate):
    """Compare a measurement of ``measured_s`` with the estimate of the cycle before ``t_s``, times of the run.

    params: INTERLOCK_PARAMS. mounting: MOUNTING of television camera and docking target. state: INTERLOCK_STATE.
    t_v: (3,), m, q_vt: (4,), as of ``models.mounting``. variance: (6,), m^2 and rad^2. estimate: NAVIGATION. A
    measurement that is too old, or that comes before the first estimate, does not count.
    """
    age_s = t_s - params.step_s - measured_s
    if estimate.valid == 0 or not age_s <= params.age_max_s:
        return
    state.compared += 1
    state.last_s = measured_s
    state.bound_m = _error_bound(params, mounting, t_v, q_vt, variance, estimate, age_s)
    if _disagrees(params, mounting, state, t_v, q_vt, variance, estimate, age_s):
        state.beyond += 1
        state.beyond_in_a_row += 1
        state.within_in_a_row = 0
        if state.beyond_in_a_row >= params.frames:
            state.disagrees = 1
    else:
        state.within_in_a_row += 1
        state.beyond_in_a_row = 0
        if state.within_in_a_row >= params.frames:
            state.disagrees = 0
