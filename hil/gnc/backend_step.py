"""Navigation and control elsewhere: backends called by the address of ``int step(input, output, instance)``.

The records are those of ``hil.core.backend_records``. An address of 0 stands for the built-in kernel, which
``hil.gnc.step`` calls directly. What a backend returns is checked before it is used.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.backend_records import (
    CONTROL_INPUT,
    CONTROL_OUTPUT,
    MAX_IMU_SAMPLES,
    NAVIGATION_INPUT,
    NAVIGATION_OUTPUT,
    TEXT_BYTES,
)
from hil.core.foreign_call import call_address, same_bytes
from hil.core.gnc_records import GncHealth, GncMode, GncState
from hil.core.jit import entry, kernel
from hil.maths.arrays import copy_into, fill
from hil.maths.record_view import copy_record
from hil.sensors.vision_unit.pose import write_all_sent

FINE, STATE, VALID, POSITION, VELOCITY, ATTITUDE, RATE, SIGMA, PROTECTION_LEVEL, HEALTH = range(10)
DIRECT, FORCE, TORQUE, THRUSTER, BIAS, REPORTED, RETURNED = range(10, 17)
"""Faults of an output. REPORTED: the backend reports a fault; RETURNED: its step returned another number than 0."""

NOBODY, NAVIGATION, CONTROL = range(3)
"""Backend that has failed."""

HEALTH_MAX = sum(bit.value for bit in GncHealth)
_NORM_TOLERANCE = 1e-3  # of an estimated quaternion
_STARTING, _WORKING, _ASKS_FOR_HOLD, _FAULT = (state.value for state in GncState)
_RUNNING = GncMode.RUNNING.value
_VISION_LOST = GncHealth.VISION_LOST.value

SLOT = np.dtype(
    [
        ("step", "i8"),  # address; 0: the built-in kernel
        ("instance", "i8"),  # third argument of the step
        ("text", "u1", TEXT_BYTES),  # of its last output
    ],
    align=True,
)
BACKENDS = np.dtype(
    [
        ("navigation", SLOT),
        ("control", SLOT),
        ("navigation_input", NAVIGATION_INPUT),
        ("navigation_output", NAVIGATION_OUTPUT),
        ("control_input", CONTROL_INPUT),
        ("control_output", CONTROL_OUTPUT),
        ("cycle", "i8"),  # number of the present one
        ("orders", "i8"),  # hil_gnc_order, as of the last cycle
        ("last_pose_s", "f8"),  # when the last pose arrived, time of the run
        ("new_text", "i8"),  # 1: a backend has another text than in the cycle before
        ("asks_for_hold", "i8"),  # NAVIGATION or CONTROL, 0 for none
        ("failed", "i8"),  # NAVIGATION or CONTROL, 0 for none
        ("fault", "i8"),
        ("place", "i8"),  # index in the field that has it
        ("code", "i8"),  # what its step returned
    ],
    align=True,
)


@kernel
def mark_invalid(navigation):
    """Write NAVIGATION without an estimate."""
    navigation.valid = 0
    fill(navigation.r_CT_H, np.nan)
    fill(navigation.v_CT_H, np.nan)
    fill(navigation.q_CH, np.nan)
    fill(navigation.w_CH_C, np.nan)
    fill(navigation.sigma_r_m, np.nan)
    fill(navigation.sigma_v_mps, np.nan)
    fill(navigation.sigma_attitude_rad, np.nan)
    navigation.nis_position = np.nan
    navigation.nis_attitude = np.nan
    fill(navigation.protection_level_m, np.nan)
    navigation.protection_level_rad = np.nan
    navigation.health = 0


@kernel
def _copy_estimate(estimate, out):
    """Copy the fields of NAVIGATION from an output to NAVIGATION."""
    out.valid, out.health = estimate.valid, estimate.health
    copy_into(out.r_CT_H, estimate.r_CT_H)
    copy_into(out.v_CT_H, estimate.v_CT_H)
    copy_into(out.q_CH, estimate.q_CH)
    copy_into(out.w_CH_C, estimate.w_CH_C)
    copy_into(out.sigma_r_m, estimate.sigma_r_m)
    copy_into(out.sigma_v_mps, estimate.sigma_v_mps)
    copy_into(out.sigma_attitude_rad, estimate.sigma_attitude_rad)
    out.nis_position, out.nis_attitude = estimate.nis_position, estimate.nis_attitude
    copy_into(out.protection_level_m, estimate.protection_level_m)
    out.protection_level_rad = estimate.protection_level_rad


@kernel
def _call(backends, slot, which, given, output):
    """Call the step of ``slot`` and take note of its text and its state; return whether it worked."""
    code = call_address(slot.step, given, output, slot.instance)
    if not same_bytes(output.text, slot.text):
        copy_into(slot.text, output.text)
        backends.new_text = 1
    fault = FINE
    if code != 0:
        fault = RETURNED
    elif not _STARTING <= output.state <= _FAULT:
        fault = STATE
    elif output.state == _FAULT:
        fault = REPORTED
    elif output.state == _ASKS_FOR_HOLD:
        backends.asks_for_hold = which
    if fault != FINE:
        backends.failed, backends.fault, backends.place, backends.code = which, fault, 0, code
    return fault == FINE


@kernel
def first_not_finite(values):
    """Return the index of the first of ``values`` that is not finite, -1 if all are finite."""
    for i in range(values.shape[0]):
        if not math.isfinite(values[i]):
            return i
    return -1


@kernel
def _negative(values):
    """Return the index of the first of ``values`` that is negative, -1 if there is none."""
    for i in range(values.shape[0]):
        if values[i] < 0.0:
            return i
    return -1


@kernel
def _fault_of_estimate(out):
    """Return (fault, index) of NAVIGATION_OUTPUT; (FINE, 0) if there is none."""
    if out.valid != 0 and out.valid != 1:
        return VALID, 0
    if out.valid == 0:
        return FINE, 0
    place = first_not_finite(out.r_CT_H)
    if place >= 0:
        return POSITION, place
    place = first_not_finite(out.v_CT_H)
    if place >= 0:
        return VELOCITY, place
    place = first_not_finite(out.w_CH_C)
    if place >= 0:
        return RATE, place
    square = 0.0
    for i in range(4):
        square += out.q_CH[i] * out.q_CH[i]
    if not abs(square - 1.0) <= 2.0 * _NORM_TOLERANCE:
        return ATTITUDE, 0
    place = max(_negative(out.sigma_r_m), _negative(out.sigma_v_mps), _negative(out.sigma_attitude_rad))
    if place >= 0:
        return SIGMA, place
    place = _negative(out.protection_level_m)
    if place >= 0:
        return PROTECTION_LEVEL, place
    if out.protection_level_rad < 0.0:
        return PROTECTION_LEVEL, 3
    place = max(
        _negative(out.bias_sigma_mps2), first_not_finite(out.bias_mps2) if math.isfinite(out.bias_sigma_mps2[0]) else -1
    )
    if place >= 0:
        return BIAS, place
    if not 0 <= out.health <= HEALTH_MAX:
        return HEALTH, 0
    return FINE, 0


@kernel
def _write_thrusters(params, thrusters, isolated_cycles, out):
    """Write the fields about thrusters that both inputs have. params: GNC_PARAMS. thrusters: THRUSTER_MONITOR_STATE."""
    out.fault, out.fault_thruster = thrusters.fault, thrusters.thruster
    if isolated_cycles > 0:
        for j in range(params.n_thrusters):
            out.isolated[j] = params.isolates[thrusters.thruster, j]


@entry
def navigate_elsewhere(params, state, t_s, samples, poses, n_poses, estimate, command):
    """Write NAVIGATION from the backend of navigation; return whether it worked. Arguments as of ``step.gnc_step``.

    A pose that no backend misses is missed by the bench: without one for the time that the scenario allows, vision is
    lost. Without a reported level there is none.
    """
    backends = state.backends
    given, out = backends.navigation_input, backends.navigation_output
    given.cycle, given.t_s, given.mode, given.orders = backends.cycle, t_s, _RUNNING, backends.orders
    given.imu_suspect = state.thrusters.imu_suspect
    given.n_samples = min(samples.shape[0], MAX_IMU_SAMPLES) if backends.cycle > 0 else 0
    for i in range(given.n_samples):
        copy_into(given.samples[i].rate_radps, samples[i].rate_C)
        copy_into(given.samples[i].force_mps2, samples[i].force_C)
    given.n_poses = n_poses
    for i in range(n_poses):
        write_all_sent(poses[i], given.poses[i])
    given.n_measurements, arrived = 0, state.navigation.fusion.sensors
    for i in range(arrived.arrived):
        sample = arrived.arrival[i].sample
        slot = params.navigation.fusion.sensors.slot[sample.sensor]
        if slot.witness == 0 and slot.enabled != 0:
            copy_record(sample, given.measurements[given.n_measurements])
            given.n_measurements += 1
    second = state.navigation.integrity
    given.second_bound_m, given.second_bound_s = second.second_m, second.second_s
    _write_thrusters(params, state.thrusters, state.isolated_cycles, given)
    for j in range(params.n_thrusters):
        given.commanded[j] = command.on[j]
    mark_invalid(out)
    fill(out.bias_mps2, np.nan)
    fill(out.bias_sigma_mps2, np.nan)
    out.state = _WORKING
    if not _call(backends, backends.navigation, NAVIGATION, given, out):
        return False
    backends.fault, backends.place = _fault_of_estimate(out)
    if backends.fault != FINE:
        backends.failed = NAVIGATION
        return False
    if out.valid == 0 or out.state == _STARTING:
        mark_invalid(estimate)
    else:
        _copy_estimate(out, estimate)
        for i in range(3):
            if estimate.protection_level_m[i] == 0.0:
                estimate.protection_level_m[i] = np.nan
        if estimate.protection_level_rad == 0.0:
            estimate.protection_level_rad = np.nan
    state.navigation.t_s += params.navigation.dt_s
    if n_poses > 0:
        backends.last_pose_s = t_s
    if estimate.valid != 0 and t_s - backends.last_pose_s > params.navigation.integrity.lost_after_s:
        estimate.health |= _VISION_LOST
    return True


@kernel
def reported_bias(params, backends, bias, sigma):
    """Write bias of the accelerometer and its standard deviation, (3,), m/s^2: as reported, else as before the run."""
    out = backends.navigation_output
    for i in range(3):
        bias[i], sigma[i] = out.bias_mps2[i], out.bias_sigma_mps2[i]
        if not (math.isfinite(bias[i]) and math.isfinite(sigma[i])):
            bias[i], sigma[i] = params.initial_bias[i], params.initial_bias_sigma


@entry
def control_elsewhere(params, state, t_s, estimate, reference, supervision, command):
    """Write the demands of COMMAND, or its thrusters, from the backend of control; return whether it worked.

    Not called while ``estimate`` is not valid: then there are no demands. The allocation of demands is the caller's.
    """
    backends = state.backends
    given, out = backends.control_input, backends.control_output
    fill(out.force, 0)
    fill(out.torque, 0)
    fill(out.on, 0)
    out.direct, out.state = 0, _WORKING
    command.boost = reference.boost
    if estimate.valid != 0:
        given.cycle, given.t_s, given.mode, given.orders = backends.cycle, t_s, _RUNNING, backends.orders
        given.phase, given.reaction, given.aborted = reference.phase, supervision.reaction, supervision.aborted
        _write_thrusters(params, state.thrusters, state.isolated_cycles, given)
        fill(given.withheld, 0)
        if state.thrusters.withheld_cycles > 0:
            given.withheld[state.thrusters.withheld] = 1
        copy_record(estimate, given.navigation)
        copy_record(reference, given.reference)
        for i in range(3):
            given.feed_force_mps2[i] = state.feed.acceleration[i]
            given.feed_torque_radps2[i] = state.feed.acceleration[3 + i]
            given.reference_rate_radps[i] = state.feed.rate_C[i]
        if not _call(backends, backends.control, CONTROL, given, out):
            return False
        backends.fault, backends.place = _fault_of_demands(out, params.n_thrusters)
        if backends.fault != FINE:
            backends.failed = CONTROL
            return False
    works = out.state != _STARTING
    for i in range(3):
        command.force[i] = out.force[i] if works and out.direct == 0 else 0
        command.torque[i] = out.torque[i] if works and out.direct == 0 else 0
    for j in range(params.n_thrusters):
        command.on[j] = out.on[j] if works else 0
    return True


@kernel
def _fault_of_demands(out, n_thrusters):
    """Return (fault, index) of CONTROL_OUTPUT; (FINE, 0) if there is none."""
    if out.direct != 0 and out.direct != 1:
        return DIRECT, 0
    for i in range(3):
        if not -1 <= out.force[i] <= 1:
            return FORCE, i
        if not -1 <= out.torque[i] <= 1:
            return TORQUE, i
    for j in range(out.on.shape[0]):
        if out.on[j] > 1 or (out.on[j] != 0 and j >= n_thrusters):
            return THRUSTER, j
    return FINE, 0
