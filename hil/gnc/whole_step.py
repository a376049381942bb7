"""Whole GNC elsewhere: navigation and control answered by one call, ``int step(instance, input, output)``.

Guidance and approach monitor are the bench's, before and after the call. The output (GNC_OUTPUT) is taken apart into
those of navigation and control, and checked and used as theirs (``hil.gnc.backend_outputs``).
"""

from __future__ import annotations

from numba import typeof, types

from hil.core.foreign_call import call_address
from hil.core.gnc_records import GncMode, GncOrder
from hil.core.jit import entry, kernel
from hil.core.messages import POSITION_ONLY
from hil.gnc import allocation, backend_outputs, backend_step, step
from hil.gnc.backend_outputs import ASKS_FOR_HOLD, CYCLE, FAULT, FINE, GNC, REPORTED, RETURNED, STARTING, STATE, WORKING
from hil.maths.arrays import copy_into, fill
from hil.maths.record_view import copy_record
from hil.sensors.vision_unit.pose import write_sent

_RUNNING, _HOLD = GncMode.RUNNING.value, GncMode.HOLD.value
_GO, _ABORT = GncOrder.GO.value, GncOrder.ABORT.value


@kernel
def guide(params, approach, t_s, supervision, reference):
    """Write the reference for ``t_s``; return the orders of the input. Arguments: see ``step.guide``."""
    progress, orders = approach.progress, _ABORT if approach.abort_began != 0 else 0
    ordered, phase = progress.go, progress.phase
    step.guide(params, approach, t_s, supervision, reference)
    if ordered != 0 and progress.phase != phase:
        orders |= _GO
    return orders


@kernel
def write_input(cycle, t_s, mode, orders, imu, reference, poses, n_poses, out):
    """Write ``out`` (GNC_INPUT) but for what is measured. poses: array of POSE, of which the first ``n_poses`` are new.

    Those whose attitude is a guess are among what is measured alone: ``poses`` of GNC_INPUT has no status.
    """
    out.cycle, out.t_s, out.mode, out.orders = cycle, t_s, mode, orders
    copy_into(out.rate_radps, imu.rate_C)
    copy_into(out.force_mps2, imu.force_C)
    copy_into(out.reference_r_CT_H_m, reference.r_CT_H)
    copy_into(out.reference_v_CT_H_mps, reference.v_CT_H)
    copy_into(out.reference_a_CT_H_mps2, reference.a_CT_H)
    copy_into(out.reference_q_CH, reference.q_CH)
    out.boost = reference.boost
    out.n_poses = 0
    for i in range(n_poses):
        if poses[i].status != POSITION_ONLY:
            write_sent(poses[i], out.poses[out.n_poses])
            out.n_poses += 1


@kernel
def clear_output(out, cycle):
    """Make ``out`` (GNC_OUTPUT) the answer to the input ``cycle`` with state WORKING, no demands and no estimate."""
    out.cycle = cycle
    out.state = WORKING
    out.direct = 0
    out.estimate = 0
    fill(out.force, 0)
    fill(out.torque, 0)
    fill(out.on, 0)
    fill(out.r_CT_H_m, 0.0)
    fill(out.v_CT_H_mps, 0.0)
    fill(out.q_CH, 0.0)
    fill(out.w_CH_C_radps, 0.0)
    fill(out.protection_level_m, 0.0)
    out.protection_level_rad = 0.0
    out.health = 0


@kernel
def call(address, instance, given, out):
    """Call the step at ``address`` with its instance, GNC_INPUT and GNC_OUTPUT; return its return value."""
    clear_output(out, given.cycle)
    return call_address(address, instance, given, out)


def compile_call(given, out):
    """Compile ``call`` for these records without calling anything."""
    call.compile((types.int64, types.int64, typeof(given), typeof(out)))


@kernel
def take_apart(out, cycle, n_thrusters, navigation, control):
    """Write the outputs of navigation and control from ``out`` (GNC_OUTPUT); return (fault, index), (FINE, 0) for none.

    cycle: of the input. Demands and estimate of a GNC that is starting or reports a fault do not count.
    """
    backend_outputs.preset_navigation(navigation)
    backend_outputs.preset_control(control)
    if out.cycle != cycle:
        return CYCLE, 0
    if not STARTING <= out.state <= FAULT:
        return STATE, 0
    navigation.state = control.state = out.state
    if out.state == STARTING or out.state == FAULT:
        return FINE, 0
    control.direct, navigation.valid = out.direct, out.estimate
    if out.direct == 0:
        copy_into(control.force, out.force)
        copy_into(control.torque, out.torque)
    else:
        copy_into(control.on, out.on)
    fault, index = backend_outputs.fault_of_demands(control, n_thrusters)
    if fault != FINE or out.estimate == 0:
        return fault, index
    copy_into(navigation.r_CT_H, out.r_CT_H_m)
    copy_into(navigation.v_CT_H, out.v_CT_H_mps)
    copy_into(navigation.q_CH, out.q_CH)
    copy_into(navigation.w_CH_C, out.w_CH_C_radps)
    copy_into(navigation.protection_level_m, out.protection_level_m)
    navigation.protection_level_rad, navigation.health = out.protection_level_rad, out.health
    return backend_outputs.fault_of_estimate(navigation)


@kernel
def use_output(params, boost, navigation, control, estimate, command):
    """Write NAVIGATION and COMMAND from the outputs of navigation and control of ``take_apart``.

    params: GNC_PARAMS, for the allocation of demands. boost: as in the reference.
    """
    backend_outputs.write_estimate(navigation, estimate)
    if control.state == STARTING or control.state == FAULT:
        close_thrusters(command)
        return
    command.boost = boost
    backend_outputs.write_demands(control, params.n_thrusters, command)
    if control.direct == 0:
        allocation.select(params.sets, params.n_thrusters, command)


@kernel
def close_thrusters(command):
    """Write COMMAND without demands and with all thrusters closed."""
    fill(command.force, 0)
    fill(command.torque, 0)
    fill(command.on, 0)


@entry
def whole_step(params, state, now, samples, poses, n_poses, cycle, t_s):
    """Run stages 4 to 7 with a whole GNC elsewhere; return False if its output is a fault.

    params: GNC_PARAMS. state: GNC_STATE, whose ``backends`` then have the reason. now: CYCLE. samples: (n,) of IMU
    since the last step. poses: array of POSE, of which the first ``n_poses`` are new.
    """
    backends, approach, arrived = state.backends, state.approach, state.navigation.fusion.sensors
    slot, given, out = backends.gnc, backends.gnc_input, backends.gnc_output
    backends.new_text = backends.asks_for_hold = 0
    orders = guide(params.approach, approach, t_s, now.supervision, now.reference)
    copy_record(approach.progress, state.guided)
    write_input(cycle, t_s, _RUNNING, orders, now.imu, now.reference, poses, n_poses, given)
    backend_step.write_measured(
        params, cycle, samples, poses, n_poses, arrived.arrival, arrived.arrived, given.measured
    )  # fmt: skip
    backends.fault, backends.place, backends.code = RETURNED, 0, call(slot.step, slot.instance, given, out)
    if backends.code == 0:
        backends.fault, backends.place = take_apart(
            out, cycle, params.n_thrusters, backends.navigation_output, backends.control_output
        )
    if backends.fault == FINE:
        backend_step.take_text(backends, slot, GNC, out)
        if out.state == FAULT:
            backends.fault = REPORTED
        elif out.state == ASKS_FOR_HOLD:
            backends.asks_for_hold = GNC
    if backends.fault != FINE:
        backends.failed = GNC
        copy_into(slot.text, out.text)
        return False
    use_output(
        params, now.reference.boost, backends.navigation_output, backends.control_output, now.navigation, now.command
    )
    step.watch_approach(params.approach, approach, t_s, now.navigation, now.reference, now.supervision, True)
    return True


@kernel
def hold_step(backends):
    """Call a whole GNC in a cycle of a hold: nothing is measured; return False if it fails. backends: BACKENDS."""
    slot, given, out = backends.gnc, backends.gnc_input, backends.gnc_output
    given.mode, given.orders, given.n_poses = _HOLD, 0, 0
    given.measured.n_samples = given.measured.n_poses = given.measured.n_measurements = 0
    backends.code = call(slot.step, slot.instance, given, out)
    if backends.code == 0 and out.state != FAULT:
        return True
    backends.failed, backends.fault = GNC, REPORTED if backends.code == 0 else RETURNED
    copy_into(slot.text, out.text)
    return False
