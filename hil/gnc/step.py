"""One step of the GNC: stages 4 to 7 of the cycle, compiled into one function.

The cycle in Python and the compiled loop call ``gnc_step``, in which navigation and control are the built-in kernels
or backends that are called by their addresses (``hil.gnc.backend_step``). A whole GNC that is elsewhere has ``guide``
before it and ``watch_approach`` after (``hil.gnc.whole_step``); the GNC server, whose guidance runs on the bench, calls
``navigation.navigate`` and ``actuate``.
"""

from __future__ import annotations

import numpy as np

from hil.core.gnc_records import MAX_SETTINGS, GncHealth, GncOrder
from hil.core.jit import entry, kernel
from hil.core.messages import MAX_THRUSTERS
from hil.gnc import allocation, approach_monitor, backend_step, control, guidance, reactions, thruster_monitor
from hil.gnc.allocation import ROWS
from hil.gnc.approach_monitor import APPROACH_MONITOR_PARAMS, NOT_ABORTED
from hil.gnc.backend_step import BACKENDS
from hil.gnc.control import CONTROL_PARAMS, FEED_FORWARD
from hil.gnc.docking_go import GO_CHECK
from hil.gnc.estimation import body_frame, navigation, target_motion
from hil.gnc.estimation.hypotheses import NAMED, READINGS
from hil.gnc.estimation.navigation import NAVIGATION_PARAMS, NAVIGATION_STATE
from hil.gnc.guidance import GUIDANCE_PARAMS, GUIDANCE_STATE
from hil.gnc.reactions import REACTION_PARAMS, REACTION_STATE
from hil.gnc.thruster_monitor import DEAD, NO_FAULT, THRUSTER_MONITOR_PARAMS, THRUSTER_MONITOR_STATE
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, copy_matrix, fill
from hil.maths.limits import has_held

CAUSE_UNKNOWN = GncHealth.CAUSE_UNKNOWN.value
MONITOR_DISAGREES, BENCH_DISAGREES = GncHealth.MONITOR_DISAGREES.value, GncHealth.BENCH_DISAGREES.value
_GO, _ABORT = GncOrder.GO.value, GncOrder.ABORT.value

APPROACH_PARAMS = np.dtype(
    [
        ("target_rate_sigma", "f8"),  # rad/s, of a component of the target's rate, up to which the approach holds
        ("guidance", GUIDANCE_PARAMS),
        ("monitor", APPROACH_MONITOR_PARAMS),
        ("reactions", REACTION_PARAMS),
    ],
    align=True,
)

GNC_PARAMS = np.dtype(
    [
        ("approach", APPROACH_PARAMS),
        ("navigation", NAVIGATION_PARAMS),
        ("control", CONTROL_PARAMS),
        ("n_thrusters", "i8"),
        ("sets", "i8", (ROWS, 2, MAX_THRUSTERS)),  # thruster sets by demand, see allocation.select
        ("dead_sets", "i1", (MAX_THRUSTERS, ROWS, 2, MAX_THRUSTERS)),  # the same without a dead thruster
        ("open_sets", "i1", (MAX_THRUSTERS, ROWS, 2, MAX_THRUSTERS)),  # without one stuck open and those against it
        ("against", "i1", (MAX_THRUSTERS, MAX_THRUSTERS)),  # those that cancel one stuck open
        ("isolation", "i8"),  # 1: isolation valves close one stuck open
        ("closing_cycles", "i8"),  # that these take
        ("isolates", "i1", (MAX_THRUSTERS, MAX_THRUSTERS)),  # those whose supply is closed with that of each thruster
        ("isolated_sets", "i1", (MAX_THRUSTERS, ROWS, 2, MAX_THRUSTERS)),  # sets without these
        ("thruster_monitor", THRUSTER_MONITOR_PARAMS),
        ("settings", "f8", (2, MAX_SETTINGS)),  # settings of the backends of navigation and control, as declared
    ],
    align=True,
)

APPROACH_PROGRESS = np.dtype(
    [
        ("phase", "i8"),  # as guidance has it, before an abort that begins in this cycle
        ("go", "i8"),  # 1: the operator's order to continue, pending
        ("docking_go", "i8"),  # 1: docking is a go by the ready state as guidance had it
        ("ready_since_s", "f8"),  # start of the ready state, nan if it does not hold
        ("ready", "i8"),  # 1: the ready state has held for the dwell time since the phase began, without an abort
        ("aborted", "i8"),  # cause, 0 for none
        ("reaction", "i8"),  # to the health of the navigation
        ("cause", "i8"),  # cause of the reaction, numbered as for an abort
    ],
    align=True,
)
"""Progress of the approach: events are the differences between two cycles, see ``gnc_backends.approach_events``."""

APPROACH_STATE = np.dtype(
    [
        ("guidance", GUIDANCE_STATE),
        ("reactions", REACTION_STATE),
        ("abort_ordered", "i8"),  # 1: by the operator
        ("abort_began", "i8"),  # 1: in this cycle
        ("target_unknown", "i8"),  # 1: the rate of a target that tumbles is not known well enough for an approach
        ("monitor_disagrees", "i8"),  # 1: the docking monitor's interlock is set
        ("bench_disagrees", "i8"),  # 1: the encoders contradict the estimate
        ("bench_breach", "f8", 3),  # component of their difference nearest its limit: number, size, limit, m or rad
        ("go", GO_CHECK),
        ("progress", APPROACH_PROGRESS),
    ],
    align=True,
)

GNC_STATE = np.dtype(
    [
        ("approach", APPROACH_STATE),
        ("navigation", NAVIGATION_STATE),
        ("thrusters", THRUSTER_MONITOR_STATE),
        ("isolated_cycles", "i8"),  # since the isolation valves were commanded, 0 before
        ("feed", FEED_FORWARD),
        ("backends", BACKENDS),
        ("guided", APPROACH_PROGRESS),  # progress of the approach after guidance, with a whole GNC elsewhere
    ],
    align=True,
)


@entry
def gnc_step(params, state, memory, t_s, samples, poses, n_poses, estimate, reference, supervision, command):
    """Run stages 4 to 7: write NAVIGATION, REFERENCE, SUPERVISION and COMMAND for ``t_s``, time of the run.

    Return False if a backend has failed; ``state.backends`` then has the reason, and the records are not complete.

    params: GNC_PARAMS. state: GNC_STATE, zeroed at the start of a run but for guidance (``guidance.start``) and the
    addresses and setups of ``backends``. memory: of ``step_memory.new_memory``. samples: (n,) of IMU
    since the last step. poses: array of POSE, of which the first ``n_poses`` are new.
    """
    backends, approach = state.backends, state.approach
    backends.new_text = backends.asks_for_hold = 0
    copy_into(state.navigation.fusion.commanded, command.on)
    if backends.navigation.step == 0:
        navigation.navigate(params.navigation, state.navigation, memory, samples, poses, n_poses, estimate)
    elif not backend_step.navigate_elsewhere(params, state, t_s, samples, poses, n_poses, estimate, command):
        return False
    watch_thrusters(params, state, memory, samples, command, estimate)
    if backends.navigation.step == 0:
        navigation.write_go(state.navigation, approach.go)
        if estimate.health & CAUSE_UNKNOWN != 0:
            cause = state.navigation.integrity.cause
            approach.reactions.hypothesis = cause if cause > NAMED else READINGS
            approach.reactions.half_swing_s = state.navigation.fusion.thrust.swing.half_s
        approach.reactions.from_future = state.navigation.fusion.from_future
        copy_matrix(approach.reactions.terms, state.navigation.integrity.terms)
    sigma = target_motion.largest_sigma(params.navigation.fusion, state.navigation.fusion)
    approach.target_unknown = 1 if sigma > params.approach.target_rate_sigma else 0
    ordered = approach.progress.go
    guide(params.approach, approach, t_s, supervision, reference)
    watch_approach(params.approach, approach, t_s, estimate, reference, supervision, False)
    backends.orders = _GO if ordered != approach.progress.go else 0
    if approach.abort_began != 0:
        backends.orders |= _ABORT
    _feed_forward(params, state, reference)
    if backends.control.step == 0:
        control.control(params.control, estimate, reference, state.feed, command)
        if approach.go.near != 0 and approach.go.given == 0:
            control.predict_hold(params.control, estimate, reference, state.feed, approach.go.hold)
    elif not backend_step.control_elsewhere(params, state, t_s, estimate, reference, supervision, command):
        return False
    _select_thrusters(params, state, command)
    if supervision.reaction == reactions.COAST:
        control.clear_demands(command)
        fill(command.on, 0)
    backends.cycle += 1
    return True


@kernel
def has_event(before, after):
    """Return whether the approach has made progress that is an event. before, after: APPROACH_PROGRESS."""
    return (
        before.phase != after.phase
        or before.go != after.go
        or before.ready != after.ready
        or before.aborted != after.aborted
        or before.reaction != after.reaction
    )


@entry
def watch_thrusters(params, state, memory, samples, command, estimate):
    """Stage 4: compare the IMU with the thrusters of the cycle before; without a sound IMU the commands replace it.

    Arguments: see ``gnc_step``. Vision alone has no IMU to compare.
    """
    if params.navigation.sensors == navigation.VISION_ALONE and state.backends.navigation.step == 0:
        return
    bias = stack.vector(6)
    if state.backends.navigation.step == 0:
        navigation.bias_of(state.navigation, bias[0:3], bias[3:6])
    else:
        backend_step.reported_bias(params.navigation.fusion.pkf, state.backends, bias[0:3], bias[3:6])
    isolated = state.isolated_cycles > params.closing_cycles
    thruster_monitor.watch(params.thruster_monitor, state.thrusters, samples, command.on, bias, isolated, estimate)
    navigation.use_imu(params.navigation, state.navigation, memory, state.thrusters, samples.shape[0])


@entry
def guide(params, state, t_s, supervision, reference):
    """Stage 5: start the next phase when its time or its order has come, and write REFERENCE.

    params: APPROACH_PARAMS. state: APPROACH_STATE. supervision: SUPERVISION of the cycle before.
    """
    progress = state.progress
    is_go = (
        supervision.aborted == NOT_ABORTED
        and supervision.reaction == reactions.CONTINUE
        and has_held(supervision.ready_since_s, t_s, params.monitor.dwell_s)
    )
    progress.docking_go = 1 if is_go else 0
    progress.ready_since_s = supervision.ready_since_s
    held = (0 if is_go else guidance.HOLDS_FINAL) | (guidance.HOLDS_HOLD if state.target_unknown != 0 else 0)
    did = guidance.advance(params.guidance, state.guidance, t_s, progress.go, held)
    if did != guidance.STAYED:
        progress.go = 0
    if did == guidance.MOVED:
        progress.ready = 0
    progress.phase = state.guidance.phase
    guidance.reference(params.guidance, state.guidance, t_s, reference)


@entry
def watch_approach(params, state, t_s, estimate, reference, supervision, abort_without_estimate):
    """Stage 6: check the estimate against corridor, closing rate and ready state; react to its health.

    Writes SUPERVISION, and REFERENCE if an abort, a hold or a retreat begins or ends. abort_without_estimate: an abort
    that is ordered does not wait for a valid estimate, but starts from the reference. A docking monitor that disagrees
    is added to the health of any GNC's estimate. Other arguments: see ``guide``.
    """
    if state.monitor_disagrees != 0:
        estimate.health |= MONITOR_DISAGREES
    if state.bench_disagrees != 0:
        estimate.health |= BENCH_DISAGREES
    guidance.note(state.guidance, t_s, estimate)
    aborted = supervision.aborted
    ordered = state.abort_ordered
    if abort_without_estimate and estimate.valid == 0:
        approach_monitor.abort_from_reference(
            params.monitor, params.guidance, state.guidance, t_s, reference, ordered, supervision
        )
    if estimate.valid != 0:
        reactions.acquire(params.reactions, params.monitor, state.reactions, t_s, estimate)
        reactions.write_level(params.monitor, state.reactions, estimate, supervision)
    approach_monitor.update(
        params.monitor, params.guidance, state.guidance, t_s, estimate, reference, ordered, state.reactions, state.go,
        supervision,
    )  # fmt: skip
    cause = stack.vector(1)
    reactions.react(
        params.reactions, params.guidance, state.reactions, state.guidance, t_s, estimate, reference, supervision, cause
    )
    state.abort_began = 1 if supervision.aborted != aborted else 0
    progress = state.progress
    progress.aborted = supervision.aborted
    progress.reaction, progress.cause = supervision.reaction, int(cause[0])
    is_ready = supervision.aborted == NOT_ABORTED and has_held(supervision.ready_since_s, t_s, params.monitor.dwell_s)
    progress.ready = 1 if is_ready else 0


@kernel
def _feed_forward(params, state, reference):
    """Write ``state.feed``: what late valves have yet to give, and what the reference of this cycle asks.

    The rate of the reference is its change since the previous cycle.
    """
    feed, dt = state.feed, params.control.dt_s
    thruster_monitor.in_transit(params.thruster_monitor, state.thrusters, feed.transit_C)
    p, q, rotates = feed.q_CH, reference.q_CH, params.navigation.fusion.orbit.tumble.rotates
    for i in range(6):  # from the previous cycle
        state.approach.go.firing[i] = max(params.control.pulse_s, feed.pulse_s) * params.control.acceleration[i]
    busy = control.is_busy(params.control, feed)
    feed.pulse_s, feed.extra_s = thruster_monitor.shortest_firing(params.thruster_monitor, state.thrusters, busy)
    turned = p[0] != q[0] or p[1] != q[1] or p[2] != q[2] or p[3] != q[3]
    if not turned and rotates == 0 and feed.turned == 0:
        return  # with a feed that is zero
    if p[0] == 0.0 and p[1] == 0.0 and p[2] == 0.0 and p[3] == 0.0:
        turned = False  # the first cycle
    rate, change = stack.vector(3), stack.vector(3)
    fill(rate, 0.0)
    if turned:
        quat.rotation_between(reference.q_CH, feed.q_CH, rate)
    feed.turned = 0
    for i in range(3):
        rate[i] /= dt
        change[i] = (rate[i] - feed.rate_C[i]) / dt
        feed.rate_C[i] = rate[i]
        if rate[i] != 0.0 or change[i] != 0.0:
            feed.turned = 1
    copy_into(feed.q_CH, reference.q_CH)
    rate_H, change_H = stack.vector(3), stack.vector(3)
    fill(rate_H, 0.0)
    fill(change_H, 0.0)
    feed.rotates = rotates
    if rotates != 0:
        t_s = state.navigation.t_s - params.navigation.dt_s
        target_motion.present_rate(params.navigation.fusion, state.navigation.fusion, t_s, rate_H, change_H)
    body_frame.feed_forward(
        rate_H, change_H, params.control.inertia, reference.q_CH, rate, change, reference, feed.acceleration
    )  # fmt: skip


@entry
def actuate(params, state, estimate, reference, command):
    """Stage 7: write the six demands and the thrusters of COMMAND. params, state: GNC_PARAMS, GNC_STATE."""
    _feed_forward(params, state, reference)
    control.control(params.control, estimate, reference, state.feed, command)
    _select_thrusters(params, state, command)


@kernel
def _select_thrusters(params, state, command):
    """Allocate the demands of COMMAND, unless control has opened thrusters itself.

    A thruster stuck open is cancelled by those against it until its isolation valve, if it has one, is closed.
    """
    fault, thruster = state.thrusters.fault, state.thrusters.thruster
    direct = state.backends.control_output.direct != 0
    if fault == NO_FAULT:
        if not direct:
            allocation.select(params.sets, params.n_thrusters, command)
        if state.thrusters.withheld_cycles > 0:
            command.on[state.thrusters.withheld] = 0
    elif fault == DEAD:
        if not direct:
            allocation.select(params.dead_sets[thruster], params.n_thrusters, command)
    elif state.isolated_cycles > params.closing_cycles:
        if not direct:
            allocation.select(params.isolated_sets[thruster], params.n_thrusters, command)
    else:
        if not direct:
            allocation.select(params.open_sets[thruster], params.n_thrusters, command)
            for j in range(params.n_thrusters):
                if params.against[thruster, j] != 0:
                    command.on[j] = 1
        state.isolated_cycles += params.isolation
