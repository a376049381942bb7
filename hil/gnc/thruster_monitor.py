"""Thruster monitor: finds a thruster that is stuck open or gives no thrust, from the IMU and the commands.

Over two cycles the mean specific force and the change of rate are compared with those of the commanded thrusters. The
residual, six components, is that of one thruster alone if its own force and torque explain nearly all of it: with the
sign of a thrust that was not commanded the thruster is open, with the opposite sign while it was commanded it is dead.
The gyro, which is quiet, separates the thrusters at one place by force, and those of one direction by torque.

Parameters are estimated before a device is accused. A valve delay: the commands of up to ``DELAYS`` cycles ago are
compared, and those that have explained most so far are used. Mass, thrust and inertia: a residual that is the expected
thrust times one factor of all forces, and one of all torques, is no fault. A lever arm of the accelerometers: what
angular acceleration times an arm explains is none either. And the least time for which a valve opens, which control
needs: short firings between others that are known to be over have given what was measured.

It also watches the IMU: readings that repeat themselves with all digits, and accelerations that no thruster explains.
Every accusation is tested after its reaction, and revoked if readings and commands contradict it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.gnc_records import GncHealth
from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.gnc import evidence
from hil.gnc.evidence import EVIDENCE_STATE
from hil.maths import elementary, stack
from hil.maths.arrays import copy_into, fill
from hil.models.valves import step_valves

IMU_SUSPECT, THRUSTER_FAULT = GncHealth.IMU_SUSPECT.value, GncHealth.THRUSTER_FAULT.value
CAUSE_UNKNOWN = GncHealth.CAUSE_UNKNOWN.value
NO_FAULT, STUCK_OPEN, DEAD = range(3)

_RESIDUAL_MIN = 0.3  # fraction of a thruster's force or torque: below it there is no fault
_UNEXPLAINED_MAX = 0.3  # fraction of the residual's square that the thruster may leave
_THRUST_MIN = 0.3  # fraction of the thrust that an open one has, or a dead one lacks
_TIE = 0.95  # of the largest square explained: as good an explanation
_BIAS_SIGMAS = 4.0
_CLEAR = 3  # of so many cycles one has to be clear
_REPEATS_MAX = 10  # cycles, of readings that seldom repeat themselves
_BY_CHANCE = -35.0  # logarithm of the probability of as many repetitions by a quantum that the GNC does not have
_WITHHELD = 8  # cycles: enough to find either of two
DELAYS: Final = 8
"""Valve delays that are compared, in cycles from 0."""
_DELAY_MEMORY = 0.995  # factor of past squares, per cycle
_DELAY_PRIOR = 1.0  # square that a longer delay has to explain
_SCALE_MIN, _SCALE_MAX = 0.4, 2.4  # factors of all forces, or torques, that mass, thrust and inertia can have
_IMPOSSIBLE = _SCALE_MAX + 1.0  # times what all thrusters together can do, against their commands
_SCALE_WEIGHT = 0.02  # weight of a cycle in the mean factor of the forces
_MEAN_WEIGHT = 0.04  # weight of a cycle in the mean residual
_ARM_MAX = 0.5  # m, of the accelerometers
_ARM_WEIGHT = 0.03  # weight of a cycle in the estimate
_PULSE_WEIGHT = 0.2  # weight of a firing in the least opening time of a valve
_PULSE_MAX_S = 0.3
_PULSE_MIN = 0.25  # cycles
_AXIS_IDLE = 5  # cycles in which a firing about an axis is over
_AXIS_FIRINGS = 4  # from which on they count
_UNMEASURED = 1.5  # times the least time of the data sheet
_REVOKED_MAX = 3  # accusations of a device that are revoked, then it stays accused

THRUSTER_MONITOR_PARAMS = np.dtype(
    [
        ("n", "i8"),
        ("dt_s", "f8"),
        ("minimum_on_s", "f8"),
        ("force_unit", "f8"),  # m/s^2, largest of a thruster
        ("torque_unit", "f8"),  # rad/s^2, the same
        ("signature", "f8", (MAX_THRUSTERS, 6)),  # signature of each thruster, in these units, in c
        ("open_cycles", "i8"),  # without its command, after which a thruster is stuck open
        ("dead_cycles", "i8"),  # with its command, after which it is dead
        ("imu_cycles", "i8"),  # consecutive, after which the IMU is suspect
        ("most", "f8", 6),  # largest of each component with all thrusters that have it
        ("sound_cycles", "i8"),  # in which readings must agree with the commands before an accusation is revoked
        ("settle_cycles", "i8"),  # after which a firing is over
        ("resolution", "f8", 2),  # of force and torque, in these units: what the quantum of the readings leaves open
    ],
    align=True,
)

THRUSTER_MONITOR_STATE = np.dtype(
    [
        ("calls", "i8"),  # since the start or a pause: the first one has no sample, the second none before it
        ("rate", "f8", 3),  # rad/s, mean over the last cycle
        ("force", "f8", 3),  # m/s^2
        ("open_s", "f8", MAX_THRUSTERS),  # for which each valve has been open
        ("open_count", "i8", MAX_THRUSTERS),
        ("clear_count", "i8", MAX_THRUSTERS),  # part of ``open_count`` that no dead thruster explains
        ("dead_count", "i8", MAX_THRUSTERS),
        ("counts", "i8"),  # 1: one of these is not 0
        ("fault", "i8"),  # NO_FAULT, STUCK_OPEN, DEAD
        ("thruster", "i8"),  # that has it, from 0
        ("withheld", "i8"),  # thruster whose command is withheld, from 0
        ("withheld_cycles", "i8"),  # for so many more
        ("unexplained", "i8"),  # cycles
        ("repeats", "i8"),  # cycles in which gyro or accelerometer repeat their readings
        ("repeated", "i8"),  # the same, of times that have passed and were short
        ("imu_suspect", "i8"),  # 1: until its readings agree with the commands again
        ("imu_since", "i8"),  # cycles before that in which its readings may have been wrong
        ("sound", "i8"),  # cycles in a row in which a suspect IMU agrees with the commands
        ("contradicted", "i8"),  # cycles in which the accused thruster contradicts the readings
        ("imu_revoked", "i8"),  # accusations of the IMU that were revoked
        ("thruster_revoked", "i8"),
        ("past", "f8", (DELAYS, MAX_THRUSTERS)),  # expected open fractions of the last cycles, a ring
        ("mean_residual", "f8", 6),
        ("row", "i8"),  # row of ``past`` with the last cycle
        ("open_cycles", "i8"),  # cycles since a thruster was expected to be open
        ("square", "f8", DELAYS),  # what the residuals with each delay sum up to
        ("delay", "i8"),  # the likeliest, cycles
        ("scale", "f8"),  # factor of the forces, mean; 0 before the first one
        ("arm", "f8", 3),  # m, of the accelerometers, in c
        ("pulse_s", "f8"),  # least time for which valves open, in that of the nominal thrust, once it is measured
        ("firings", "i8"),  # from which it is measured
        ("firing_cycles", "i8"),  # length of the present firing, -1: it is not measured
        ("firing_thrusters", "i8"),  # in it
        ("firing_s", "f8"),  # expected
        ("firing_expected", "f8", 3),  # sum of torques over its cycles, in the units of the monitor
        ("firing_measured", "f8", 3),
        ("busy", "i8"),  # 1: the chaser accelerates all the time, so that single firings are rare
        # firings about one axis among those of others, while it does
        ("axis_idle", "i8", 3),  # cycles since a torque about the axis was expected
        ("axis_cycles", "i8", 3),  # length of its present firing, 0: none, -1: it is not measured
        ("axis_expected", "f8", 3),  # sum of torques over its cycles, in the units of the monitor
        ("axis_measured", "f8", 3),
        ("axis_firings", "i8"),  # from which ``axis_pulse_s`` is measured
        ("axis_pulse_s", "f8"),  # as ``pulse_s``
        ("evidence", EVIDENCE_STATE),
        ("since_odd", "i8"),  # cycles since a residual that nothing explains
        ("jump", "f8"),  # rad/s, of the gyros' drift, for the filters; 0 for none
        ("unnamed", "i8"),  # 1: in this cycle a device would be accused if the evidence named it
    ],
    align=True,
)


@kernel
def _square_of(residual):
    """Return the square of the length of ``residual`` (6,)."""
    square = 0.0
    for i in range(6):
        square += residual[i] ** 2
    return square


@kernel
def _explain(params, residual, thrust, explained):
    """Write the thrust of each thruster that explains ``residual`` (6,) alone to ``explained`` (n,), 0 if none does.

    thrust: expected (n,). A thruster that is closed can only open, one that is fully open only fail.
    """
    square, most = _square_of(residual), 0.0
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
            is_failed = possible and abs(error) >= _THRUST_MIN * max(0.5, thrust[j]) and part >= _TIE * most
            explained[j] = error if is_failed and square - part <= _UNEXPLAINED_MAX * square else 0.0


@kernel
def _judge(params, state, residual, thrust):
    """Count what ``residual`` (6,) means; thrust: expected mean of each thruster (n,) over the same time.

    An open thruster looks like the opposite one that fails, as long as that is commanded: a third of the cycles has to
    be clear of that. A cycle without residual acquits one that is not commanded of being open, and one that is of
    being dead; one is dead only when all others are acquitted of being open. A command that lasts would acquit none: it
    is withheld for a moment from a thruster that looks dead.
    """
    for i in range(6):
        state.mean_residual[i] += _MEAN_WEIGHT * (residual[i] - state.mean_residual[i])
        if abs(residual[i]) > _IMPOSSIBLE * params.most[i]:
            _accuse_imu(state, 2)
    is_quiet = _square_of(residual) < _RESIDUAL_MIN**2 or _is_of_scale(params, state, residual, thrust)
    if is_quiet and state.counts == 0:
        state.unexplained = 0
        state.since_odd += 1
        evidence.keep(state.evidence, residual, thrust, params.n, False)
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
    # thrust that is late, or rises and falls slowly, leaves nothing in the mean
    lasts = _square_of(state.mean_residual) > _RESIDUAL_MIN**2
    is_odd = not (is_quiet or opens or fails)
    evidence.keep(state.evidence, residual, thrust, params.n, is_odd)
    _note_jump(params, state, residual, is_odd)
    state.unexplained = state.unexplained + 1 if lasts and is_odd else max(0, state.unexplained - 1)
    for j in range(params.n):
        if explained[j] > 0.0:
            state.open_count[j] += 1
            state.clear_count[j] += 0 if fails else 1
            state.dead_count[j] = max(0, state.dead_count[j] - 1)
        elif is_quiet and thrust[j] == 0.0:
            state.open_count[j] = state.clear_count[j] = 0
        if explained[j] < 0.0:
            state.dead_count[j] += 1
            state.open_count[j] = max(0, state.open_count[j] - 1)
        elif (thrust[j] > 0.0 and is_quiet) or (thrust[j] == 0.0 and not is_quiet):
            state.dead_count[j] = 0
        suspects = suspects or state.open_count[j] > 0
        if state.open_count[j] > 0 or state.dead_count[j] > 0:
            state.counts = 1
    for j in range(params.n):
        if state.open_count[j] >= params.open_cycles and _CLEAR * state.clear_count[j] >= params.open_cycles:
            _accuse_thruster(params, state, STUCK_OPEN, j)
        elif state.dead_count[j] >= params.dead_cycles and not suspects:
            _accuse_thruster(params, state, DEAD, j)
        elif state.dead_count[j] >= params.dead_cycles and state.withheld_cycles == 0:
            state.withheld, state.withheld_cycles = j, _WITHHELD
    if state.unexplained >= params.imu_cycles:
        state.unnamed = 1
        if evidence.names_imu(state.evidence):
            _accuse_imu(state, params.imu_cycles)


@kernel
def _note_jump(params, state, residual, odd):
    """Take an ``odd`` change of the rate alone, after a time without any, as one of the gyros' drift.

    Soon after a firing it has to be larger than that of several thrusters, which may be late.
    """
    if odd and state.since_odd >= params.imu_cycles:
        force = residual[0] ** 2 + residual[1] ** 2 + residual[2] ** 2
        change = math.sqrt(_square_of(residual) - force)
        if force < _RESIDUAL_MIN**2 and (state.open_cycles > params.settle_cycles or change > _IMPOSSIBLE):
            state.jump = change * params.torque_unit * params.dt_s
    state.since_odd = 0 if odd else state.since_odd + 1


@kernel
def _accuse_thruster(params, state, fault, thruster):
    """Accuse a thruster of ``fault`` if the evidence names it."""
    state.unnamed = 1
    if evidence.names_thruster(state.evidence, params.signature[: params.n], thruster, fault == STUCK_OPEN):
        state.fault, state.thruster = fault, thruster


@kernel
def _watch_readings(params, state, rate, force, thrust):
    """Count the cycles in which gyro or accelerometer read what they read before.

    Readings with a quantum repeat themselves: of these those cycles count in which ``thrust``, the expected mean (n,),
    changes them by more than the quantum leaves open.
    """
    rate_repeats, force_repeats = True, True
    for i in range(3):
        rate_repeats = rate_repeats and rate[i] == state.rate[i]
        force_repeats = force_repeats and force[i] == state.force[i]
    if not (rate_repeats or force_repeats):
        state.repeated += state.repeats if state.repeats < _REPEATS_MAX else 0
        state.repeats = 0
        return
    rate_changes, force_changes = params.resolution[1] == 0.0, params.resolution[0] == 0.0
    if not (rate_changes and force_changes):
        last = (state.row - state.delay + DELAYS) % DELAYS
        earlier = (last - 1 + DELAYS) % DELAYS
        for i in range(3):
            turned, pushed = 0.0, 0.0
            for j in range(params.n):
                turned += thrust[j] * params.signature[j, 3 + i]
                pushed += (state.past[last, j] - state.past[earlier, j]) * params.signature[j, i]
            rate_changes = rate_changes or abs(turned) > params.resolution[1]
            force_changes = force_changes or abs(pushed) > 4.0 * params.resolution[0]
    if (rate_repeats and rate_changes) or (force_repeats and force_changes):
        state.repeats += 1


@kernel
def _is_of_scale(params, state, residual, thrust):
    """Return whether ``residual`` is what one factor of all expected forces and one of all torques leave."""
    remainder = 0.0
    for first in range(0, 6, 3):
        product, size, square = 0.0, 0.0, 0.0
        for i in range(first, first + 3):
            expected = 0.0
            for j in range(params.n):
                expected += thrust[j] * params.signature[j, i]
            product += expected * residual[i]
            size += expected * expected
            square += residual[i] ** 2
        change = product / size if size > 0.05 else 0.0
        if not _SCALE_MIN <= 1.0 + change <= _SCALE_MAX:
            return False
        remainder += square - change * change * size
        if first == 0 and size > 0.5 and square - change * change * size < 0.05 * size:
            mean = state.scale if state.scale > 0.0 else 1.0 + change
            state.scale = mean + _SCALE_WEIGHT * (1.0 + change - mean)
    return remainder < _RESIDUAL_MIN**2


@kernel
def _accuse_imu(state, cycles):
    """Accuse the IMU, whose readings may have been wrong for so many cycles."""
    if state.imu_suspect == 0:
        state.imu_suspect, state.imu_since, state.sound = 1, cycles, 0
        evidence.forget(state.evidence)


@kernel
def _remember(params, state, thrust):
    """Take the expected ``thrust`` (n,) of the last cycle into the ring."""
    state.row = state.row + 1 if state.row + 1 < DELAYS else 0
    is_open = False
    for j in range(params.n):
        state.past[state.row, j] = thrust[j]
        is_open = is_open or thrust[j] > 0.0
    state.open_cycles = 0 if is_open else state.open_cycles + 1


@kernel
def _least_time(params):
    """Return the least time, s, for which valves are commanded to open, or open by the data sheet."""
    return max(params.minimum_on_s, params.dt_s)


@kernel
def _measure_pulse(params, state, thrust, since, rate):
    """Measure for how long the valves of a single firing were open, if it is one of the shortest.

    thrust: expected in the last cycle (n,). since: cycles since the firing before. rate: mean of the cycle.
    """
    count, largest = 0, 0.0
    if state.open_cycles == 0:
        for j in range(params.n):
            if thrust[j] > 0.0:
                count += 1
                largest = max(largest, thrust[j])
        if state.firing_cycles == 0 and since > params.settle_cycles:
            state.firing_cycles, state.firing_thrusters, state.firing_s = 1, count, 0.0
            fill(state.firing_expected, 0.0)
            fill(state.firing_measured, 0.0)
        elif state.firing_cycles > 0 and since == 0 and count == state.firing_thrusters:
            state.firing_cycles += 1
        else:
            state.firing_cycles = -1
    if state.firing_cycles == 0:
        return
    if state.firing_cycles > 0:
        state.firing_s += largest * params.dt_s
        for i in range(3):
            state.firing_measured[i] += (rate[i] - state.rate[i]) / (params.dt_s * params.torque_unit)
        for j in range(params.n):
            if thrust[j] > 0.0:
                for i in range(3):
                    state.firing_expected[i] += thrust[j] * params.signature[j, 3 + i]
    if state.open_cycles > params.settle_cycles:
        if state.firing_cycles > 0:
            _learn_pulse(params, state)
        state.firing_cycles = 0


@kernel
def _learn_pulse(params, state):
    """Take a firing that is over into the least time for which valves open, by its change of the rate.

    The rate is measured well from the start, the specific force only once the bias of the accelerometer is known.
    """
    square, product = 0.0, 0.0
    for i in range(3):
        square += state.firing_expected[i] ** 2
        product += state.firing_expected[i] * state.firing_measured[i]
    if square < (0.5 * state.firing_cycles) ** 2:
        return
    commanded_s = state.firing_s
    if commanded_s < _least_time(params) + 0.5 * params.dt_s:  # the shortest that is commanded
        known_s = state.pulse_s if state.firings > 0 else commanded_s
        state.firings += 1
        state.pulse_s = _mean_pulse(params, known_s, state.firings, product / square * commanded_s)


@kernel
def _mean_pulse(params, known_s, firings, open_s):
    """Return the least time for which valves open, s, with the last one of ``firings``, which has taken ``open_s``."""
    open_s = min(_PULSE_MAX_S, max(_PULSE_MIN * params.dt_s, open_s))
    return known_s + max(_PULSE_WEIGHT, 1.0 / (1.0 + firings)) * (open_s - known_s)


@kernel
def _measure_axis_pulses(params, state, thrust, rate):
    """Measure for how long valves open by firings that are single about their axis, but not among all axes.

    A chaser that accelerates all the time seldom has a moment without thrust. Arguments: see ``_measure_pulse``.
    """
    shortest = int(_least_time(params) / params.dt_s + 0.5)
    for i in range(3):
        expected = 0.0
        for j in range(params.n):
            expected += thrust[j] * params.signature[j, 3 + i]
        if abs(expected) > _RESIDUAL_MIN:
            if state.axis_idle[i] >= _AXIS_IDLE:
                state.axis_cycles[i] = 1
                state.axis_expected[i] = state.axis_measured[i] = 0.0
            elif state.axis_cycles[i] > 0 and state.axis_idle[i] == 0:
                state.axis_cycles[i] += 1
            else:
                state.axis_cycles[i] = -1
            state.axis_idle[i] = 0
        else:
            state.axis_idle[i] += 1
        if state.axis_cycles[i] <= 0:
            continue
        state.axis_expected[i] += expected
        state.axis_measured[i] += (rate[i] - state.rate[i]) / (params.dt_s * params.torque_unit)
        if state.axis_idle[i] == _AXIS_IDLE:
            if state.axis_cycles[i] == shortest:
                commanded_s = shortest * params.dt_s
                known_s = state.axis_pulse_s if state.axis_firings > 0 else commanded_s
                state.axis_firings += 1
                open_s = state.axis_measured[i] / state.axis_expected[i] * commanded_s
                state.axis_pulse_s = _mean_pulse(params, known_s, state.axis_firings, open_s)
            state.axis_cycles[i] = 0


@kernel
def _mean_thrust(params, state, delay, out):
    """Write the expected mean (n,) over the last two cycles, with the valves ``delay`` cycles late."""
    last = (state.row - delay + DELAYS) % DELAYS
    earlier = (last - 1 + DELAYS) % DELAYS
    for j in range(params.n):
        out[j] = 0.5 * (state.past[last, j] + state.past[earlier, j])


@kernel
def shortest_firing(params, state, busy):
    """Return the least time for which valves open, s, and what each firing gives beyond that of the data sheet, s.

    busy: whether the chaser accelerates all the time. Until it is measured with an IMU, it is taken to be larger than
    that of the data sheet: pulses that drive each other across a dead band that is too small leave no time to measure
    any.
    """
    least_s = _least_time(params)
    state.busy = 1 if busy else 0
    if busy and state.axis_firings >= _AXIS_FIRINGS:
        return state.axis_pulse_s, state.axis_pulse_s - least_s
    if state.firings > 0:
        return state.pulse_s, state.pulse_s - least_s
    return (_UNMEASURED * least_s if state.calls >= 2 and state.imu_suspect == 0 else least_s), 0.0


@kernel
def in_transit(params, state, out):
    """Write the change of velocity, m/s, and rate, rad/s, in c, that valves which are late have yet to give, (6,)."""
    fill(out, 0.0)
    for k in range(state.delay):
        row = (state.row - k + DELAYS) % DELAYS
        for j in range(params.n):
            if state.past[row, j] > 0.0:
                for i in range(3):
                    out[i] += state.past[row, j] * params.signature[j, i] * params.force_unit * params.dt_s
                    out[3 + i] += state.past[row, j] * params.signature[j, 3 + i] * params.torque_unit * params.dt_s


@kernel
def _subtract(params, measured, thrust, residual):
    """Write ``measured`` (6,) without the forces and torques of ``thrust`` (n,)."""
    for i in range(6):
        residual[i] = measured[i]
    for j in range(params.n):
        if thrust[j] > 0.0:
            for i in range(6):
                residual[i] -= thrust[j] * params.signature[j, i]


@kernel
def _find_delay(params, state, measured, thrust, residual):
    """Count how much each valve delay leaves of ``measured`` (6,); write thrust and residual of the likeliest.

    Only delays whose older cycle is in the ring are compared: up to ``DELAYS - 2``.
    """
    if state.open_cycles < DELAYS:
        best = np.inf
        for delay in range(DELAYS - 1):
            _mean_thrust(params, state, delay, thrust)
            _subtract(params, measured, thrust, residual)
            state.square[delay] = _DELAY_MEMORY * state.square[delay] + min(_square_of(residual), 4.0)
            total = state.square[delay] + _DELAY_PRIOR * delay
            if total < best:
                best, state.delay = total, delay
    _mean_thrust(params, state, state.delay, thrust)
    _subtract(params, measured, thrust, residual)


@kernel
def _correct_for_arm(params, state, measured):
    """Take what the arm of the accelerometers explains out of ``measured`` (6,): with alpha comes alpha x arm."""
    a, scale = stack.vector(3), params.torque_unit / params.force_unit
    for i in range(3):
        a[i] = measured[3 + i] * scale
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        measured[i] -= a[j] * state.arm[k] - a[k] * state.arm[j]


@kernel
def _learn_arm(params, state, measured, residual):
    """Estimate the arm from the forces of ``residual`` (6,) that angular accelerations in ``measured`` come with.

    By normalised least mean squares of what thrusters do not explain. What the mean factor of the forces explains comes
    with them too, but is none of an arm.
    """
    a, force, scale = stack.vector(3), stack.vector(3), params.torque_unit / params.force_unit
    change = state.scale - 1.0 if state.scale > 0.0 else 0.0
    square = 0.0
    for i in range(3):
        a[i] = measured[3 + i] * scale
        square += a[i] ** 2
        force[i] = residual[i] - change * (measured[i] - residual[i])
    if square < 0.1 * scale * scale:
        return
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        arm = state.arm[i] + _ARM_WEIGHT * (force[j] * a[k] - force[k] * a[j]) / square
        state.arm[i] = min(_ARM_MAX, max(-_ARM_MAX, arm))


@kernel
def _test_imu(params, state, residual, thrust, repeats):
    """Revoke the accusation of the IMU once its readings have agreed with the commands for long enough."""
    is_small = _square_of(residual) < _RESIDUAL_MIN**2
    agrees = not repeats and (is_small or _is_of_scale(params, state, residual, thrust))
    state.sound = state.sound + 1 if agrees else 0
    if state.sound >= params.sound_cycles and state.imu_revoked < _REVOKED_MAX:
        state.imu_suspect = state.sound = state.unexplained = 0
        state.imu_revoked += 1


@kernel
def _test_thruster(params, state, measured, isolated):
    """Revoke the accusation of a thruster that the readings contradict. isolated: whether its supply is closed.

    With its reaction the thrusters commanded are those without it: what they give has to be what is measured, with the
    thrust of one stuck open as long as its supply is not closed.
    """
    thrust, residual = stack.vector(MAX_THRUSTERS), stack.vector(6)
    _mean_thrust(params, state, state.delay, thrust)
    thrust[state.thruster] = 0.0
    if state.fault == STUCK_OPEN and not isolated:
        thrust[state.thruster] = 1.0
    _subtract(params, measured, thrust, residual)
    is_quiet = _square_of(residual) < (2.0 * _RESIDUAL_MIN) ** 2 or _is_of_scale(params, state, residual, thrust)
    state.contradicted = max(0, state.contradicted + (-1 if is_quiet else 1))
    if state.contradicted >= params.sound_cycles and state.thruster_revoked < _REVOKED_MAX:
        state.fault, state.contradicted = NO_FAULT, 0
        state.thruster_revoked += 1
        fill(state.open_count, 0)
        fill(state.clear_count, 0)
        fill(state.dead_count, 0)
        state.counts = 0


@kernel
def watch(params, state, samples, on, bias, isolated, estimate):
    """Compare the IMU's ``samples`` (n,) since the last call with the commands ``on`` (n,) of that time.

    bias: (6,), m/s^2, of the accelerometer, then its standard deviation; what the bias may explain is no residual.
    isolated: whether the supply of an accused thruster is closed. Adds its bits to ``estimate.health`` (NAVIGATION).
    """
    rate, force, thrust = stack.vector(3), stack.vector(3), stack.vector(MAX_THRUSTERS)
    measured, residual = stack.vector(6), stack.vector(6)
    weight = 1.0 / samples.shape[0]
    for i in range(3):
        rate[i] = force[i] = 0.0
        for k in range(samples.shape[0]):
            rate[i] += weight * samples[k].rate_C[i]
            force[i] += weight * samples[k].force_C[i]
    state.unnamed = 0
    step_valves(on[: params.n], state.open_s, params.minimum_on_s, params.dt_s, thrust)
    if state.withheld_cycles > 0:
        state.withheld_cycles -= 1
    since = state.open_cycles
    _remember(params, state, thrust)
    if state.calls >= 2:
        per_force, per_torque = 1.0 / params.force_unit, 1.0 / (params.dt_s * params.torque_unit)
        for i in range(3):
            measured[i] = (0.5 * (force[i] + state.force[i]) - bias[i]) * per_force
            measured[3 + i] = (rate[i] - state.rate[i]) * per_torque
        if state.imu_suspect == 0 and state.fault == NO_FAULT:
            _measure_pulse(params, state, thrust, since, rate)
            if state.busy != 0:
                _measure_axis_pulses(params, state, thrust, rate)
        _correct_for_arm(params, state, measured)
        _find_delay(params, state, measured, thrust, residual)
        _watch_readings(params, state, rate, force, thrust)
        for i in range(6):
            possible = params.resolution[1]
            if i < 3:
                possible = _BIAS_SIGMAS * bias[3 + i] * per_force + params.resolution[0]
            residual[i] -= min(possible, max(-possible, residual[i]))
        if state.imu_suspect != 0:
            _test_imu(params, state, residual, thrust, state.repeats > 0)
        elif state.fault != NO_FAULT:
            _test_thruster(params, state, measured, isolated)
        else:
            _judge(params, state, residual, thrust)
            _learn_arm(params, state, measured, residual)
    if (
        state.repeats >= _REPEATS_MAX
        and state.repeats * elementary.log((1.0 + state.repeated) / state.calls) < _BY_CHANCE
    ):
        _accuse_imu(state, state.repeats + 1)
    copy_into(state.rate, rate)
    copy_into(state.force, force)
    state.calls += 1
    if state.imu_suspect != 0:
        estimate.health |= IMU_SUSPECT
    if state.fault != NO_FAULT:
        estimate.health |= THRUSTER_FAULT
    if state.unnamed != 0 and state.imu_suspect == 0 and state.fault == NO_FAULT:
        estimate.health |= CAUSE_UNKNOWN


@kernel
def pause(state):
    """Take note that the next samples do not follow the last ones."""
    state.calls = 1
    state.repeats = state.repeated = state.unexplained = 0
    evidence.forget(state.evidence)
    fill(state.open_count, 0)
    fill(state.clear_count, 0)
