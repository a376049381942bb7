"""What a campaign keeps of a run, counted while it is flown: the numbers of ``hil run --json`` without its history."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS
from hil.dynamics import truth as truth_kernels
from hil.gnc import approach_monitor, ready_phase
from hil.gnc.ready_phase import READY_STATE
from hil.maths import stack
from hil.maths.arrays import copy_into
from hil.models.camera import view_margin
from hil.models.mounting import camera_pose

RUN_STATS = np.dtype(
    [
        ("cycles", "i8"),
        ("limited_cycles", "i8"),
        ("ready", READY_STATE),
        ("aborted", "i8"),  # cause, 0 for none
        ("aborted_at_s", "f8"),
        ("corridor_margin", "f8"),  # m, least on the truth, up to an abort
        ("closing_margin", "f8"),  # m/s, the same
        ("nearest", "f8"),  # m, least range
        ("view_margin", "f8"),  # px, least at an exposure
        ("line", "f8"),  # m/s, changes of the reference's velocity
        ("mass_start", "f8"),  # kg
        ("mass_end", "f8"),
        ("force_cycles", "i8", 3),  # with a demand on the axis
        ("torque_cycles", "i8", 3),
        ("thruster_open", "f8", MAX_THRUSTERS),  # cycles, parts of them included
        ("thruster_firings", "i8", MAX_THRUSTERS),
        ("was_open", "i8", MAX_THRUSTERS),
        ("known", "i8"),  # cycles with an estimate, settled
        ("square_error", "f8", 9),  # sums: position, m^2, velocity, small turn, rad^2
        ("fused", "i8"),  # updates, settled
        ("nees_position", "f8"),  # sums over them
        ("nees_attitude", "f8"),
        ("from_H", "f8", 3),  # line of the cycle before
        ("to_H", "f8", 3),
        ("reference_v", "f8", 3),
        ("room", "f8", 12),  # deviations of the present cycle
    ],
    align=True,
)


@kernel
def start_tally(tally):
    """Make the zeroed ``tally`` ready for a run."""
    tally.corridor_margin = tally.closing_margin = tally.nearest = tally.view_margin = np.inf


@kernel
def count_exposure(camera, mounting, leds, r, q, tally):
    """Take account of the view at an exposure with the bench at ``r`` (3,), m, ``q`` (4,)."""
    t_v, q_vt = stack.vector(3), stack.vector(4)
    camera_pose(mounting, r, q, t_v, q_vt)
    tally.view_margin = min(tally.view_margin, view_margin(camera, leds, t_v, q_vt))


@kernel
def _count_security(params, now, tally):
    truth, reference = now.truth, now.reference
    square = 0.0
    for i in range(3):
        square += truth.r_CT_H[i] * truth.r_CT_H[i]
    tally.nearest = min(tally.nearest, math.sqrt(square))
    if tally.aborted != 0:
        return
    if now.supervision.aborted != 0:
        tally.aborted = now.supervision.aborted
        tally.aborted_at_s = now.supervision.aborted_at_s
    if now.supervision.aborted == 0 or tally.cycles == 0:  # otherwise the line before the abort
        copy_into(tally.from_H, reference.from_H)
        copy_into(tally.to_H, reference.to_H)
    corridor = approach_monitor.corridor_margin(params.judged, tally.from_H, tally.to_H, truth.r_CT_H)
    closing = approach_monitor.closing_margin(params.judged, truth.r_CT_H, truth.v_CT_H)
    tally.corridor_margin = min(tally.corridor_margin, corridor)
    tally.closing_margin = min(tally.closing_margin, closing)


@kernel
def _count_thrusters(params, now, tally):
    for j in range(params.n_thrusters):
        fraction = now.truth.thrust_fraction[j]
        is_open = 1 if fraction > 0.0 else 0
        tally.thruster_open[j] += fraction
        if is_open != 0 and tally.was_open[j] == 0:
            tally.thruster_firings[j] += 1
        tally.was_open[j] = is_open
    change = 0.0
    for i in range(3):
        tally.force_cycles[i] += 1 if now.command.force[i] != 0 else 0
        tally.torque_cycles[i] += 1 if now.command.torque[i] != 0 else 0
        change += (now.reference.v_CT_H[i] - tally.reference_v[i]) ** 2
        tally.reference_v[i] = now.reference.v_CT_H[i]
    tally.line += math.sqrt(change)
    if tally.cycles == 0:
        tally.mass_start = now.truth.mass_kg
    tally.mass_end = now.truth.mass_kg


@kernel
def _count_navigation(now, tally):
    """Add the errors of the estimate."""
    truth, estimate = now.truth, now.navigation
    tally.known += 1
    p, q = estimate.q_CH, truth.q_CH
    # vector and scalar part of q_true * conj(q_estimate); the small turn is twice the former
    scalar = p[3] * q[3] + p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    sign = 2.0 if scalar >= 0.0 else -2.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turn = sign * (p[3] * q[i] - q[3] * p[i] + q[j] * p[k] - q[k] * p[j])
        tally.square_error[i] += (truth.r_CT_H[i] - estimate.r_CT_H[i]) ** 2
        tally.square_error[3 + i] += (truth.v_CT_H[i] - estimate.v_CT_H[i]) ** 2
        tally.square_error[6 + i] += turn * turn
    if not math.isnan(now.nees_position):
        tally.fused += 1
        tally.nees_position += now.nees_position
        tally.nees_attitude += now.nees_attitude


@kernel
def count_cycle(params, state, tally):
    """Take account of the cycle in ``state.now``. params: LOOP_PARAMS."""
    now = state.now
    rate = stack.vector(3)
    truth_kernels.rate_against_hill(now.truth, rate)
    ready_phase.deviations(params.ready, now.truth.r_CT_H, now.truth.v_CT_H, now.truth.q_CH, rate, tally.room)
    ready_phase.judge_moment(params.ready, tally.ready, now.t_s, tally.room)
    _count_security(params, now, tally)
    _count_thrusters(params, now, tally)
    if now.navigation.valid != 0 and now.t_s >= params.settled_s:
        _count_navigation(now, tally)
    tally.cycles += 1
