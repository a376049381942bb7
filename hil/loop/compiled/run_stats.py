"""Statistics of a run in a campaign, accumulated per cycle: the numbers of ``hil run --json`` without a history."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import entry, kernel
from hil.core.messages import MAX_THRUSTERS
from hil.dynamics import truth as truth_kernels
from hil.gnc import ready_phase
from hil.gnc.integrity_verdict import INTEGRITY_STATE, start_integrity, update_integrity
from hil.gnc.ready_phase import READY_STATE
from hil.maths import stack
from hil.models.rotating_frame import frame_acceleration, tumble_rate

RUN_STATS = np.dtype(
    [
        ("cycles", "i8"),
        ("limited_cycles", "i8"),
        ("ended", "i8"),  # reason of ``run_cycles``, written by the caller
        ("ready", READY_STATE),
        ("integrity", INTEGRITY_STATE),
        ("view_margin", "f8"),  # px, least at an exposure
        ("view_margin_s", "f8"),
        ("view_lost_s", "f8"),  # exposure at which it was first negative
        ("reference_delta_v", "f8"),  # m/s, changes of the reference's velocity, and what axes that rotate ask
        ("mass_start", "f8"),  # kg
        ("mass_end", "f8"),
        ("force_cycles", "i8", 3),  # with a demand on the axis
        ("torque_cycles", "i8", 3),
        ("thruster_open", "f8", MAX_THRUSTERS),  # cycles, fractions included
        ("thruster_firings", "i8", MAX_THRUSTERS),
        ("was_open", "i8", MAX_THRUSTERS),
        ("estimates", "i8"),  # cycles with an estimate in steady state
        ("square_error", "f8", 9),  # sums: position, m^2, velocity, small-angle rotation, rad^2
        ("fused", "i8"),  # updates in steady state
        ("nees_position", "f8"),  # sums over them
        ("nees_attitude", "f8"),
        ("reference_v", "f8", 3),
    ],
    align=True,
)


@kernel
def start_run_stats(stats):
    """Initialise the zeroed ``stats`` for a run."""
    stats.view_margin = np.inf
    start_integrity(stats.integrity)


@kernel
def _frame_acceleration(params, now):
    """Return the acceleration, m/s^2, that the reference needs because the target's axes rotate."""
    w, dw, a = stack.vector(3), stack.vector(3), stack.vector(3)
    tumble_rate(params.gnc.navigation.fusion.orbit.tumble, now.t_s, w, dw)
    frame_acceleration(w, dw, now.reference.r_CT_H, now.reference.v_CT_H, a)
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@kernel
def _count_thrusters(params, now, stats):
    for j in range(params.gnc.n_thrusters):
        fraction = now.truth.thrust_fraction[j]
        is_open = 1 if fraction > 0.0 else 0
        stats.thruster_open[j] += fraction
        if is_open != 0 and stats.was_open[j] == 0:
            stats.thruster_firings[j] += 1
        stats.was_open[j] = is_open
    change = 0.0
    for i in range(3):
        stats.force_cycles[i] += 1 if now.command.force[i] != 0 else 0
        stats.torque_cycles[i] += 1 if now.command.torque[i] != 0 else 0
        change += (now.reference.v_CT_H[i] - stats.reference_v[i]) ** 2
        stats.reference_v[i] = now.reference.v_CT_H[i]
    if change > 0.0:
        stats.reference_delta_v += math.sqrt(change)
    if params.gnc.navigation.fusion.orbit.tumble.rotates != 0:
        stats.reference_delta_v += params.step_s * _frame_acceleration(params, now)
    if stats.cycles == 0:
        stats.mass_start = now.truth.mass_kg
    stats.mass_end = now.truth.mass_kg


@kernel
def _count_navigation(now, stats):
    """Add the errors of the estimate."""
    truth, estimate = now.truth, now.navigation
    stats.estimates += 1
    p, q = estimate.q_CH, truth.q_CH
    # vector and scalar part of q_true * conj(q_estimate); the small-angle rotation is twice the former
    scalar = p[3] * q[3] + p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    sign = 2.0 if scalar >= 0.0 else -2.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rotation = sign * (p[3] * q[i] - q[3] * p[i] + q[j] * p[k] - q[k] * p[j])
        stats.square_error[i] += (truth.r_CT_H[i] - estimate.r_CT_H[i]) ** 2
        stats.square_error[3 + i] += (truth.v_CT_H[i] - estimate.v_CT_H[i]) ** 2
        stats.square_error[6 + i] += rotation * rotation
    if not math.isnan(now.nees_position):
        stats.fused += 1
        stats.nees_position += now.nees_position
        stats.nees_attitude += now.nees_attitude


@entry
def count_cycle(params, state, stats):
    """Count the cycle in ``state.now``. params: LOOP_PARAMS."""
    now = state.now
    rate = stack.vector(3)
    truth_kernels.rate_against_hill(now.truth, rate)
    if now.supervision.aborted == 0:  # an abort ends the ready phase
        ready_phase.update_from(
            params.ready, stats.ready, now.t_s, now.truth.r_CT_H, now.truth.v_CT_H, now.truth.q_CH, rate
        )
    update_integrity(params.integrity, stats.integrity, now)
    _count_thrusters(params, now, stats)
    if now.navigation.valid != 0 and now.t_s >= params.steady_state_after_s:
        _count_navigation(now, stats)
    stats.cycles += 1
