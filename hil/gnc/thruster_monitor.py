"""Thruster monitor: finds a thruster that is stuck open or gives no thrust, from the IMU and the commands.

Over two cycles the mean specific force and the change of rate are compared with those of the commanded thrusters. The
residual, six components, is that of one thruster alone if its own force and torque explain nearly all of it: with the
sign of a thrust that was not commanded the thruster is open, with the opposite sign while it was commanded it is dead.
The gyro, which is quiet, separates the thrusters at one place by force, and those of one direction by torque.

It also watches the IMU: readings that repeat themselves with all digits, and accelerations that no thruster explains.
"""

from __future__ import annotations

import numpy as np

from hil.core.gnc_records import GncHealth
from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.maths import stack
from hil.maths.arrays import copy_into, fill

IMU_SUSPECT, THRUSTER_FAULT = GncHealth.IMU_SUSPECT.value, GncHealth.THRUSTER_FAULT.value
NO_FAULT, STUCK_OPEN, DEAD = range(3)

_RESIDUAL_MIN = 0.3  # of a thruster's force or torque: below it all is well
_UNEXPLAINED_MAX = 0.3  # fraction of the residual's square that the thruster may leave
_THRUST_MIN = 0.3  # fraction of the thrust that an open one has, or a dead one lacks
_TIE = 0.95  # of the largest square explained: as good an explanation
_IMPOSSIBLE = 2.0  # times what all thrusters together can do
_BIAS_SIGMAS = 4.0
_CLEAR = 3  # of so many cycles one has to be clear
_REPEATS_MAX = 10  # cycles
_WITHHELD = 8  # cycles: enough to find either of two

THRUSTER_MONITOR_PARAMS = np.dtype(
    [
        ("n", "i8"),
        ("dt_s", "f8"),
        ("minimum_on_s", "f8"),
        ("force_unit", "f8"),  # m/s^2, largest of a thruster
        ("torque_unit", "f8"),  # rad/s^2, the same
        ("signature", "f8", (MAX_THRUSTERS, 6)),  # of each thruster, in these units, in c
        ("open_cycles", "i8"),  # without its command, after which a thruster is stuck open
        ("dead_cycles", "i8"),  # with its command, after which it is dead
        ("imu_cycles", "i8"),  # consecutive, after which the IMU is suspect
        ("most", "f8", 6),  # largest of each component with all thrusters that have it
    ],
    align=True,
)

THRUSTER_MONITOR_STATE = np.dtype(
    [
        ("calls", "i8"),  # since the start or a pause: the first one has no sample, the second none before it
        ("rate", "f8", 3),  # rad/s, mean over the last cycle
        ("force", "f8", 3),  # m/s^2
        ("thrust", "f8", MAX_THRUSTERS),  # expected open fraction of each thruster in it
        ("open_s", "f8", MAX_THRUSTERS),  # for which each valve has been open
        ("open_count", "i8", MAX_THRUSTERS),
        ("clear_count", "i8", MAX_THRUSTERS),  # of ``open_count`` those that no dead thruster explains
        ("dead_count", "i8", MAX_THRUSTERS),
        ("counts", "i8"),  # 1: one of these is not 0
        ("fault", "i8"),  # NO_FAULT, STUCK_OPEN, DEAD
        ("thruster", "i8"),  # that has it, from 0
        ("withheld", "i8"),  # thruster whose command is withheld, from 0
        ("withheld_cycles", "i8"),  # for so many more
        ("unexplained", "i8"),  # cycles
        ("repeats", "i8"),  # cycles in which gyro or accelerometer repeat their readings
        ("imu_suspect", "i8"),  # 1: it stays so
    ],
    align=True,
)


@kernel
def _expected_thrust(params, state, on, thrust):
    """Write the open fraction (n,) of the cycle that has ended with the commands ``on`` (n,)."""
    for j in range(params.n):
        thrust[j] = 0.0
        if on[j] > 0:
            thrust[j] = 1.0
            state.open_s[j] += params.dt_s
        elif 0.0 < state.open_s[j] < params.minimum_on_s:
            thrust[j] = min(1.0, (params.minimum_on_s - state.open_s[j]) / params.dt_s)
            state.open_s[j] += params.dt_s
            if state.open_s[j] >= params.minimum_on_s:
                state.open_s[j] = 0.0
        else:
            state.open_s[j] = 0.0


@kernel
def _explain(params, residual, thrust, explained):
    """Write the thrust of each thruster that explains ``residual`` (6,) alone to ``explained`` (n,), 0 if none does.

    thrust: expected (n,). A thruster that is closed can only open, one that is fully open only fail.
    """
    square, most = 0.0, 0.0
    for i in range(6):
        square += residual[i] ** 2
    for turn in range(2):  # the largest square that one explains, then those that explain as much
        for j in range(params.n):
            along, size = 0.0, 0.0
            for i in range(6):
                along += residual[i] * params.signature[j, i]
                size += params.signature[j, i] ** 2
            part, error = along * along / size, along / size
            possible = thrust[j] < 1.0 if error > 0.0 else thrust[j] > 0.0
            if turn == 0:
                most = max(most, part)
                continue
            found = possible and abs(error) >= _THRUST_MIN * max(0.5, thrust[j]) and part >= _TIE * most
            explained[j] = error if found and square - part <= _UNEXPLAINED_MAX * square else 0.0


@kernel
def _judge(params, state, residual, thrust):
    """Count what ``residual`` (6,) means; thrust: expected mean of each thruster (n,) over the same time.

    An open thruster looks like the opposite one that fails, as long as that is commanded: a third of the cycles has to
    be clear of that. A cycle without residual acquits one that is not commanded of being open, and one that is of
    being dead; one is dead only when all others are acquitted of being open. A command that lasts would acquit none: it
    is withheld for a moment from a thruster that looks dead.
    """
    square = 0.0
    for i in range(6):
        square += residual[i] ** 2
        if abs(residual[i]) > _IMPOSSIBLE * params.most[i]:
            state.imu_suspect = 1
    is_quiet = square < _RESIDUAL_MIN**2
    if is_quiet and state.counts == 0:
        state.unexplained = 0
        return
    explained = stack.vector(MAX_THRUSTERS)
    state.counts = 0
    opens, fails, suspects = False, False, False
    if is_quiet:
        fill(explained, 0.0)
    else:
        _explain(params, residual, thrust, explained)
    for j in range(params.n):
        opens, fails = opens or explained[j] > 0.0, fails or explained[j] < 0.0
    state.unexplained = 0 if is_quiet or opens or fails else state.unexplained + 1
    for j in range(params.n):
        if explained[j] > 0.0:
            state.open_count[j] += 1
            state.clear_count[j] += 0 if fails else 1
        elif is_quiet and thrust[j] == 0.0:
            state.open_count[j] = state.clear_count[j] = 0
        if explained[j] < 0.0:
            state.dead_count[j] += 1
        elif (thrust[j] > 0.0 and is_quiet) or (thrust[j] == 0.0 and not is_quiet):
            state.dead_count[j] = 0
        suspects = suspects or state.open_count[j] > 0
        if state.open_count[j] > 0 or state.dead_count[j] > 0:
            state.counts = 1
    for j in range(params.n):
        if state.open_count[j] >= params.open_cycles and _CLEAR * state.clear_count[j] >= params.open_cycles:
            state.fault, state.thruster = STUCK_OPEN, j
        elif state.dead_count[j] >= params.dead_cycles and not suspects:
            state.fault, state.thruster = DEAD, j
        elif state.dead_count[j] >= params.dead_cycles and state.withheld_cycles == 0:
            state.withheld, state.withheld_cycles = j, _WITHHELD


@kernel
def _watch_readings(state, rate, force):
    """Count the cycles in which gyro or accelerometer read what they read before."""
    rate_repeats, force_repeats = True, True
    for i in range(3):
        rate_repeats = rate_repeats and rate[i] == state.rate[i]
        force_repeats = force_repeats and force[i] == state.force[i]
    state.repeats = state.repeats + 1 if rate_repeats or force_repeats else 0


@kernel
def watch(params, state, samples, on, bias, bias_sigma, estimate):
    """Compare the IMU's ``samples`` (n,) since the last call with the commands ``on`` (n,) of that time.

    bias, bias_sigma: of the accelerometer, (3,), m/s^2; what the bias may explain is no residual. Adds its bits to
    ``estimate.health`` (NAVIGATION).
    """
    rate, force, thrust = stack.vector(3), stack.vector(3), stack.vector(MAX_THRUSTERS)
    residual = stack.vector(6)
    weight = 1.0 / samples.shape[0]
    for i in range(3):
        rate[i] = force[i] = 0.0
        for k in range(samples.shape[0]):
            rate[i] += weight * samples[k].rate_C[i]
            force[i] += weight * samples[k].force_C[i]
    _expected_thrust(params, state, on, thrust)
    if state.withheld_cycles > 0:
        state.withheld_cycles -= 1
    if state.calls >= 2:
        _watch_readings(state, rate, force)
    if state.calls >= 2 and state.imu_suspect == 0 and state.fault == NO_FAULT:
        per_force, per_torque = 1.0 / params.force_unit, 1.0 / (params.dt_s * params.torque_unit)
        for i in range(3):
            residual[i] = (0.5 * (force[i] + state.force[i]) - bias[i]) * per_force
            residual[3 + i] = (rate[i] - state.rate[i]) * per_torque
        for j in range(params.n):
            state.thrust[j] = 0.5 * (state.thrust[j] + thrust[j])
            if state.thrust[j] > 0.0:
                for i in range(6):
                    residual[i] -= state.thrust[j] * params.signature[j, i]
        for i in range(3):
            possible = _BIAS_SIGMAS * bias_sigma[i] * per_force
            residual[i] -= min(possible, max(-possible, residual[i]))
        _judge(params, state, residual, state.thrust)
    if state.repeats >= _REPEATS_MAX or state.unexplained >= params.imu_cycles:
        state.imu_suspect = 1
    copy_into(state.rate, rate)
    copy_into(state.force, force)
    for j in range(params.n):
        state.thrust[j] = thrust[j]
    state.calls += 1
    if state.imu_suspect != 0:
        estimate.health |= IMU_SUSPECT
    if state.fault != NO_FAULT:
        estimate.health |= THRUSTER_FAULT


@kernel
def pause(state):
    """Take note that the next samples do not follow the last ones."""
    state.calls = 1
    state.repeats = state.unexplained = 0
    fill(state.open_count, 0)
    fill(state.clear_count, 0)
