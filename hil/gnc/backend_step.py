"""Navigation and control elsewhere: backends called by the address of ``int step(input, output, instance)``.

The records are those of ``hil.core.gnc_records``. An address of 0 stands for the built-in kernel, which
``hil.gnc.step`` calls directly. What a backend returns is checked before it is used, here and for a whole GNC
(``hil.gnc.whole_step``), which is both parts answered by one call.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.foreign_call import call_address, same_bytes
from hil.core.gnc_records import (
    CONTROL_INPUT,
    GNC_INPUT,
    MAX_IMU_SAMPLES,
    NAVIGATION_INPUT,
    OUTPUTS,
    TEXT_BYTES,
    GncHealth,
    GncMode,
)
from hil.core.jit import entry, kernel
from hil.gnc import backend_outputs
from hil.gnc.backend_outputs import ASKS_FOR_HOLD, CONTROL, FAULT, FINE, NAVIGATION, REPORTED, RETURNED, STARTING, STATE
from hil.maths.arrays import copy_into, fill
from hil.maths.record_view import copy_record
from hil.sensors.vision_unit.pose import write_all_sent

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
        ("gnc", SLOT),
        ("navigation_input", NAVIGATION_INPUT),
        ("navigation_output", OUTPUTS["navigation"]),  # of a whole GNC as well
        ("control_input", CONTROL_INPUT),
        ("control_output", OUTPUTS["control"]),  # of a whole GNC as well
        ("gnc_input", GNC_INPUT),
        ("gnc_output", OUTPUTS["gnc"]),
        ("cycle", "i8"),  # number of the present one
        ("orders", "i8"),  # hil_gnc_order, as of the last cycle
        ("last_pose_s", "f8"),  # when the last pose arrived, time of the run
        ("new_text", "i8"),  # bits 1 << NAVIGATION, CONTROL, GNC: it has another text than in the cycle before
        ("asks_for_hold", "i8"),  # NAVIGATION, CONTROL or GNC, 0 for none
        ("failed", "i8"),  # the same
        ("fault", "i8"),
        ("place", "i8"),  # index in the field that has it
        ("code", "i8"),  # what its step returned
    ],
    align=True,
)


@kernel
def take_text(backends, slot, which, output):
    """Take note of the text of ``output`` if it differs from the last output's."""
    if not same_bytes(output.text, slot.text):
        copy_into(slot.text, output.text)
        backends.new_text |= 1 << which


@kernel
def _call(backends, slot, which, given, output):
    """Call the step of ``slot`` and take note of its text and its state; return whether it worked."""
    code = call_address(slot.step, given, output, slot.instance)
    take_text(backends, slot, which, output)
    fault = FINE
    if code != 0:
        fault = RETURNED
    elif not STARTING <= output.state <= FAULT:
        fault = STATE
    elif output.state == FAULT:
        fault = REPORTED
    elif output.state == ASKS_FOR_HOLD:
        backends.asks_for_hold = which
    if fault != FINE:
        backends.failed, backends.fault, backends.place, backends.code = which, fault, 0, code
    return fault == FINE


@kernel
def _write_thrusters(params, thrusters, isolated_cycles, out):
    """Write the fields about thrusters that both inputs have. params: GNC_PARAMS. thrusters: THRUSTER_MONITOR_STATE."""
    out.fault, out.fault_thruster = thrusters.fault, thrusters.thruster
    if isolated_cycles > 0:
        for j in range(params.n_thrusters):
            out.isolated[j] = params.isolates[thrusters.thruster, j]


@kernel
def write_measured(params, cycle, samples, poses, n_poses, arrivals, n_arrivals, given):
    """Write samples, poses and measurements of further sensors to ``given``, which has the fields of MEASURED_FIELDS.

    params: GNC_PARAMS. arrivals: array of SENSOR_ARRIVAL, of which the first ``n_arrivals`` are new.
    """
    given.n_samples = min(samples.shape[0], MAX_IMU_SAMPLES) if cycle > 0 else 0
    for i in range(given.n_samples):
        copy_into(given.samples[i].rate_radps, samples[i].rate_C)
        copy_into(given.samples[i].force_mps2, samples[i].force_C)
    given.n_poses = n_poses
    for i in range(n_poses):
        write_all_sent(poses[i], given.poses[i])
    given.n_measurements = 0
    for i in range(n_arrivals):
        sample = arrivals[i].sample
        slot = params.navigation.fusion.sensors.slot[sample.sensor]
        if slot.witness == 0 and slot.enabled != 0:
            copy_record(sample, given.measurements[given.n_measurements])
            given.n_measurements += 1


@entry
def navigate_elsewhere(params, state, t_s, samples, poses, n_poses, estimate, command):
    """Write NAVIGATION from the backend of navigation; return whether it worked. Arguments: see ``step.gnc_step``.

    A pose that no backend misses is missed by the bench: without one for the time that the scenario allows, vision is
    lost. Without a reported level there is none.
    """
    backends = state.backends
    given, out = backends.navigation_input, backends.navigation_output
    given.cycle, given.t_s, given.mode, given.orders = backends.cycle, t_s, _RUNNING, backends.orders
    given.imu_suspect = state.thrusters.imu_suspect
    arrived = state.navigation.fusion.sensors
    write_measured(
        params, backends.cycle, samples, poses, n_poses, arrived.arrival, arrived.arrived, given
    )  # fmt: skip
    second = state.navigation.integrity
    given.second_bound_m, given.second_bound_s = second.second_m, second.second_s
    _write_thrusters(params, state.thrusters, state.isolated_cycles, given)
    for j in range(params.n_thrusters):
        given.commanded[j] = command.on[j]
    backend_outputs.preset_navigation(out)
    if not _call(backends, backends.navigation, NAVIGATION, given, out):
        return False
    backends.fault, backends.place = backend_outputs.fault_of_estimate(out)
    if backends.fault != FINE:
        backends.failed = NAVIGATION
        return False
    backend_outputs.write_estimate(out, estimate)
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
    backend_outputs.preset_control(out)
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
        backends.fault, backends.place = backend_outputs.fault_of_demands(out, params.n_thrusters)
        if backends.fault != FINE:
            backends.failed = CONTROL
            return False
    backend_outputs.write_demands(out, params.n_thrusters, command)
    return True
