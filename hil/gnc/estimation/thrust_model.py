"""Commanded thrust as information: what the specific force of a step is, and how well it is known.

While no thruster is open the specific force is that of a small disturbance, a state of the filters, and known far
better than any accelerometer reads it; the accelerometer then measures its own bias. While one is open the
accelerometer measures the thrust, whatever mass, thrust and valves are in truth. Without a sound IMU the thrust is that
of the commands, with an uncertain scale, and the rate follows from their torques.

    QUIET:      s = d + w,          w ~ noise^2 / dt
    MEASURED:   s = s_measured - b + w,  w ~ sigma_accelerometer^2 + (measured_fraction |s|)^2
    COMMANDED:  s = u + d + w,      w ~ noise^2 / dt + (fraction |u|)^2

A step is QUIET only if the accelerometer agrees. docs/explanation/commanded-thrust.md
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.gnc.estimation import torque_witness
from hil.gnc.estimation.error_state import BIAS, DRIFT, V
from hil.gnc.estimation.torque_witness import TORQUE_PARAMS, TORQUE_STATE
from hil.maths import elementary, stack
from hil.maths.arrays import copy_into, fill, fill_matrix
from hil.models.valves import step_valves

MEASURED, QUIET, COMMANDED = range(3)
"""Source of a step's specific force."""
REGAINED = 2
MEMORY_S: Final = 30.0
"""Time over which corrections of the velocity are compared with what noise and thrust explain."""
JUMP_NIS: Final = 45.0
"""Of the mean of quiet readings: a change of bias or disturbance; noise may be 1.5 times as large as assumed."""
JUMP_WINDOWS: Final = 4
"""Over which they are averaged for it."""

_MEAN_WEIGHT: Final = 1.0 / 16.0
"""Weight of a step in the mean of what bias and disturbance leave: a leak below the noise of a reading is no quiet."""
_MEAN_SIGMAS: Final = 7.5
_HALF_SWING_S = 0.2, 15.0  # half a period of a flexible mode or of slosh
_HALF_SWINGS = 3  # in a row: readings without thrust that go to the other side and back swing
_SWINGS_S = 20.0  # after the last half swing, in which the force without thrust is as the accelerometer reads it

THRUST_PARAMS = np.dtype(
    [
        ("enabled", "i8"),  # 1: a step without thrust is known to be one; 0: commands only replace an IMU
        ("n", "i8"),  # thrusters
        ("dt_s", "f8"),
        ("force", "f8", (MAX_THRUSTERS, 3)),  # m/s^2, of each thruster, in c
        ("torque", "f8", (MAX_THRUSTERS, 3)),  # rad/s^2
        ("minimum_on_s", "f8"),
        ("settle", "i8"),  # steps after the last expected thrust in which a valve may still be open
        ("variance", "f8"),  # (m/s^2)^2 of a step's specific force without thrust
        ("fraction", "f8"),  # fraction of a commanded thrust, 1 sigma, without IMU
        ("measured_fraction", "f8"),  # fraction of a measured thrust
        ("walk", "f8"),  # m/s^2 in a step, of the disturbance
        ("rate_variance", "f8"),  # (rad/s)^2 that the rate gains in a step without gyros
        ("window", "i8"),  # steps over which quiet readings are averaged
        ("gate", "f8"),  # standard deviations of a reading
        ("witness", TORQUE_PARAMS),  # of the gyros
    ],
    align=True,
)

SWING_STATE = np.dtype(
    [
        ("sense", "i8", 3),  # -1, 1: side on which the mean of unexplained readings was last beyond its limit
        ("since", "i8", 3),  # step at which it came there
        ("last", "i8", 3),  # at which it was last there
        ("halves", "i8", 3),  # half swings in a row
        ("half_s", "f8"),  # duration of the last half swing
        ("until", "i8"),  # step up to which the chaser swings, 0: it has not
    ],
    align=True,
)
"""Oscillation of the specific force without thrust: a flexible mode or slosh that the filters do not model."""

THRUST_STATE = np.dtype(
    [
        ("open_s", "f8", MAX_THRUSTERS),  # for which each valve has been open
        ("since", "i8"),  # steps since a thruster was expected to be open
        ("without_imu", "i8"),  # 1: the commands replace the IMU; REGAINED: the next step has it again
        ("rate_C", "f8", 3),  # rad/s, the last one used, with the gyros' drift
        ("drift", "f8", 3),  # rad/s, of the gyros, when they were replaced
        ("drift_variance", "f8", 3),
        ("unexplained", "f8", 3),  # m/s^2, mean of what bias and disturbance leave of readings without thrust
        ("swing", SWING_STATE),
        ("jumped", "i8"),  # step at which quiet readings did not agree with bias and disturbance, 0 for none
        ("spread", "f8"),  # (m/s)^2, what white noise adds to the velocity, forgotten over ``MEMORY_S``
        ("gained_C", "f8", 3),  # m/s, velocity by thrust, the same
        ("excess_C", "f8", 3),  # m/s, of it: what the accelerometer reads beyond the commands, the same
        ("witness", TORQUE_STATE),
    ],
    align=True,
)


@kernel
def _expect(params, state, commanded, step):
    """Write the thrust that ``commanded`` (n,) gives in ``step`` (STEP); count the steps without any."""
    fraction = stack.vector(MAX_THRUSTERS)
    step_valves(commanded[: params.n], state.open_s, params.minimum_on_s, params.dt_s, fraction)
    fill(step.thrust_C, 0.0)
    fill(step.torque_C, 0.0)
    state.since += 1
    for j in range(params.n):
        if fraction[j] > 0.0:
            state.since = 0
            for i in range(3):
                step.thrust_C[i] += fraction[j] * params.force[j, i]
                step.torque_C[i] += fraction[j] * params.torque[j, i]


@kernel
def _note_swing(swing, axis, side, step, dt_s):
    """Take note that unexplained readings along ``axis`` are beyond their limit on one ``side``, -1 or 1, in ``step``.

    A disturbance or a valve's tail stays on its side; what goes to the other one and back again swings.
    """
    if side != swing.sense[axis]:
        half_s = (step - swing.since[axis]) * dt_s
        lasts = (step - swing.last[axis]) * dt_s <= _HALF_SWING_S[1]
        is_half = lasts and _HALF_SWING_S[0] <= half_s <= _HALF_SWING_S[1]
        swing.halves[axis] = swing.halves[axis] + 1 if is_half else 0
        swing.sense[axis], swing.since[axis] = side, step
        if swing.halves[axis] >= _HALF_SWINGS:
            swing.half_s, swing.until = half_s, step + int(_SWINGS_S / dt_s)
    swing.last[axis] = step


@kernel
def _is_quiet(params, of_pkf, errors, filters, force, state, step):
    """Return whether a reading ``force`` (3,) is what bias and disturbance explain, and so is the mean of them.

    state: THRUST_STATE, whose mean of what they have left of the readings so far, a low-pass, is updated.
    """
    d, quiet, mean = errors.disturbance, True, state.unexplained
    for i in range(3):
        b, noise = BIAS + i, of_pkf.sigma_accelerometer**2
        known = filters.p[b, b] + filters.p[d + i, d + i] + 2.0 * filters.p[b, d + i]
        off = force[i] - filters.pkf.x[6 + i] - filters.parameters[d + i]
        allowed = params.gate * math.sqrt(noise + known)
        mean[i] += _MEAN_WEIGHT * (min(allowed, max(-allowed, off)) - mean[i])
        if abs(mean[i]) > _MEAN_SIGMAS * math.sqrt(0.5 * _MEAN_WEIGHT * noise + known):
            quiet = False
            _note_swing(state.swing, i, 1 if mean[i] > 0.0 else -1, step, params.dt_s)
        elif abs(off) > allowed:
            quiet = False
    return quiet and step >= state.swing.until


@kernel
def _doubt_disturbance(params, state, step):
    """Let the filters estimate the disturbance again if the gyros show a change of it. state: FUSION_STATE.

    It has moved the chaser for as long as their mean is late.
    """
    more = torque_witness.watch(params.witness, state.thrust.witness, state.thrust.rate_C, step.rate_C, params.dt_s)
    if more > 0.0:
        doubts, late_s = state.doubts, params.witness.delay * params.dt_s
        doubts.acts, doubts.disturbance = 1, elementary.hypot(doubts.disturbance, more)
        doubts.across = elementary.hypot(doubts.across, more * late_s)
        for i in range(3):
            doubts.position[i] = elementary.hypot(doubts.position[i], 0.5 * more * late_s**2)
        state.thrust.jumped = state.cycle


@kernel
def begin(params, state, started, commanded, step):
    """Write thrust, kind and noise of ``step`` (STEP), whose IMU sample is there already.

    params: FUSION_PARAMS. state: FUSION_STATE. started: whether the filters have. commanded: (MAX_THRUSTERS,).
    """
    thrust, of_pkf = params.thrust, params.pkf
    step.kind, step.rate_variance, step.regains = MEASURED, 0.0, 0
    _expect(thrust, state.thrust, commanded, step)
    torque_witness.count_firings(thrust.witness, state.thrust.witness, step.torque_C)
    if state.thrust.without_imu == 1:
        replace(thrust, state.thrust, step)
        return
    if state.thrust.without_imu == REGAINED:
        step.regains, state.thrust.without_imu = 1, 0
    is_closed = thrust.enabled != 0 and state.thrust.since > thrust.settle
    if is_closed and started and state.thrust.since > thrust.settle + 1:
        _doubt_disturbance(thrust, state, step)
    copy_into(state.thrust.rate_C, step.rate_C)
    if is_closed and (
        not started or _is_quiet(thrust, of_pkf, params.errors, state.filters, step.force_C, state.thrust, state.cycle)
    ):
        step.kind = QUIET


@kernel
def replace(params, state, step):
    """Replace the IMU's sample of ``step`` by what its commands give, from the rate of the step before."""
    step.kind, step.rate_variance = COMMANDED, params.rate_variance
    for i in range(3):
        turn = step.torque_C[i] * params.dt_s
        state.rate_C[i] += turn
        step.rate_C[i] = state.rate_C[i]
        step.rate_variance += (params.fraction * turn) ** 2


@kernel
def lose(state, filters):
    """Keep the drift of the gyros, with its variance, for the moment at which they are used again."""
    state.without_imu = 1
    for i in range(3):
        state.drift[i], state.drift_variance[i] = filters.akf.x[4 + i], filters.p[DRIFT + i, DRIFT + i]


@kernel
def regain(state, filters):
    """Use the gyros again: their drift is that of before, and not what the rate of the commands was off by."""
    for i in range(3):
        filters.akf.x[4 + i] = state.drift[i]
        for j in range(filters.p.shape[0]):
            filters.p[DRIFT + i, j] = 0.0
        for j in range(filters.p.shape[0]):
            filters.p[j, DRIFT + i] = 0.0
        filters.p[DRIFT + i, DRIFT + i] = state.drift_variance[i]


@kernel
def _force_variance(params, of_pkf, kind, square):
    """Return the variance, (m/s^2)^2, of a specific force of ``kind`` whose square is ``square``."""
    if kind != MEASURED:
        return params.variance + params.fraction**2 * square
    return of_pkf.sigma_accelerometer**2 + params.measured_fraction**2 * square


@kernel
def count_spread(params, of_pkf, state, bias, step):
    """Take ``step`` (STEP) into what the velocity may have changed by that its prediction does not contain.

    bias: of the accelerometer, (3,), m/s^2, as estimated.
    """
    forgotten, square = params.dt_s / MEMORY_S, 0.0
    for i in range(3):
        force = 0.0
        if step.kind == MEASURED:
            force = step.force_C[i] - of_pkf.initial_bias[i]
        elif step.kind == COMMANDED:
            force = step.thrust_C[i]
        excess = step.force_C[i] - bias[i] - step.thrust_C[i] if step.kind == MEASURED else 0.0
        state.gained_C[i] += force * params.dt_s - forgotten * state.gained_C[i]
        state.excess_C[i] += excess * params.dt_s - forgotten * state.excess_C[i]
        square += force * force
    if state.spread > 0.0:
        variance = _force_variance(params, of_pkf, step.kind, square)
        state.spread += variance * params.dt_s**2 - 2.0 * forgotten * state.spread


@kernel
def velocity_spread(params, errors, filters, state, i):
    """Return the standard deviation, m/s, of the corrections of velocity ``i`` over ``MEMORY_S`` without a fault."""
    part = params.fraction if state.without_imu == 1 else params.measured_fraction
    square, d, k = 0.0, errors.disturbance, errors.thrust_scale
    part = filters.p[k, k] if k != 0 else part * part
    for j in range(3):
        square += state.gained_C[j] ** 2
    variance = filters.p[V + i, V + i] + state.spread + part * square
    if d != 0:
        largest = max(filters.p[d, d], filters.p[d + 1, d + 1], filters.p[d + 2, d + 2])
        variance += 0.25 * MEMORY_S**2 * largest
    if errors.target_walk != 0.0:  # a change of the target's rate moves the velocity in its axes
        r = filters.pkf.x
        distance_squared = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        variance += errors.target_walk * MEMORY_S / params.dt_s * distance_squared
    return math.sqrt(variance)


@kernel
def write_input(params, of_pkf, errors, filters, step):
    """Write ``filters.input``: specific force and rate of ``step`` without bias and drift, and the force's noise."""
    moved, d, square = filters.input, errors.disturbance, 0.0
    moved.measured = 1 if step.kind == MEASURED else 0
    for i in range(3):
        moved.rate[i] = step.rate_C[i] - filters.akf.x[4 + i]
        if step.kind == MEASURED:
            moved.force[i] = step.force_C[i] - filters.pkf.x[6 + i]
            square += moved.force[i] ** 2 if params.enabled != 0 else 0.0
        else:
            thrust = step.thrust_C[i] if step.kind == COMMANDED else 0.0
            if errors.thrust_scale != 0:
                thrust *= 1.0 + filters.parameters[errors.thrust_scale]
            moved.force[i] = thrust + filters.parameters[d + i]
            square += thrust * thrust
    moved.variance = _force_variance(params, of_pkf, step.kind, square)


@kernel
def bias_innovation(of_pkf, errors, filters, mean, count, innovation):
    """Write innovation and sensitivity of the ``mean`` (3,) of ``count`` quiet readings into ``innovation``."""
    fill_matrix(innovation.h, 0.0)
    for i in range(3):
        innovation.value[i] = mean[i] - filters.pkf.x[6 + i]
        innovation.h[i, BIAS + i] = innovation.h[i, errors.disturbance + i] = 1.0
        fill(innovation.noise[i], 0.0)
        innovation.noise[i, i] = of_pkf.sigma_accelerometer**2 / count


@kernel
def admit_jump(errors, filters, innovation):
    """Take an innovation of quiet readings that neither bias nor disturbance explain as a possible change of both."""
    for i in range(3):
        square = innovation.value[i] ** 2
        filters.p[BIAS + i, BIAS + i] += square
        d = errors.disturbance + i
        filters.p[d, d] += square
