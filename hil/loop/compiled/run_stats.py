"""Statistics of a run, counted cycle by cycle: what the verdict of ``hil run`` and the row of a campaign are made of.

A case of a campaign is counted in its loop, a run or a recording by its rows, however they are split.
"""

from __future__ import annotations

import math

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.jit import entry, kernel
from hil.core.kernel_record import kernel_record
from hil.core.messages import MAX_PHASES, MAX_THRUSTERS, new
from hil.dynamics import truth as truth_kernels
from hil.gnc import ready_phase
from hil.gnc.integrity_verdict import INTEGRITY_PARAMS, INTEGRITY_STATE, start_integrity, update_integrity
from hil.gnc.ready_phase import READY_PARAMS, READY_STATE
from hil.maths import stack
from hil.maths.record_view import copy_record
from hil.models.rotating_frame import TUMBLE, frame_acceleration, tumble_rate
from hil.params.dynamics import expected_rate
from hil.params.integrity import integrity
from hil.params.ready import SETTLED_S, ready_params
from hil.params.target import known_tumble

_WINDOW_BEGIN_S, _WINDOW_END_S = 360.0, 400.0  # bench paper Fig. 8
BEFORE, SETTLED = 0, 1

RUN_STATS_PARAMS = np.dtype(
    [
        ("step_s", "f8"),
        ("n_thrusters", "i8"),
        ("settled_s", "f8"),  # from here on errors of the navigation count as SETTLED
        ("ready", READY_PARAMS),
        ("integrity", INTEGRITY_PARAMS),
        ("tumble", TUMBLE),  # of the target's axes, as the GNC is given it
        ("transfers", "i8", MAX_PHASES),  # 1: what the reference needs is its acceleration by thrust alone
    ],
    align=True,
)

NAVIGATION_SUMS = np.dtype(
    [
        ("estimates", "i8", 2),  # cycles with an estimate BEFORE the navigation had SETTLED, and from then on
        ("square_error", "f8", (2, 9)),  # sums: position, m^2, velocity, small-angle rotation, rad^2
        ("square_sigma", "f8", (2, 6)),  # sums, as reported: position, m^2, attitude, rad^2
        ("updates", "i8", (2, 2)),  # with a NEES, of position and of attitude
        ("nees", "f8", (2, 2)),  # sums over them
    ],
    align=True,
)

MAX_LEGS = 2 * MAX_PHASES
LEG = np.dtype([("t_s", "f8"), ("state", "f8", 6)], align=True)
"""A state of the reference, [r, v] in H, m and m/s, and its time."""

RUN_STATS = np.dtype(
    [
        ("cycles", "i8"),
        ("limited_cycles", "i8"),
        ("ended", "i8"),  # reason of ``run_cycles``, written by the caller
        ("ready", READY_STATE),
        ("integrity", INTEGRITY_STATE),
        ("view_margin", "f8"),  # px, least at an exposure of the bench in memory
        ("view_margin_s", "f8"),
        ("view_lost_s", "f8"),  # exposure at which it was first negative
        ("reference_delta_v", "f8"),  # m/s, changes of the reference's velocity, and what axes that rotate ask
        ("shadow_cycles", "f8"),  # in the shadow of the central body, fractions included
        ("mass_start", "f8"),  # kg
        ("mass_end", "f8"),
        ("force_cycles", "i8", 3),  # with a demand on the axis
        ("torque_cycles", "i8", 3),
        ("torque_cycles_360_400_s", "i8", 3),
        ("thruster_open", "f8", MAX_THRUSTERS),  # cycles, fractions included
        ("thruster_firings", "i8", MAX_THRUSTERS),
        ("was_open", "i8", MAX_THRUSTERS),
        ("navigation", NAVIGATION_SUMS),
        ("reference_v", "f8", 3),
        ("n_legs", "i8"),  # phases that were begun
        ("leg", LEG, MAX_LEGS),  # at their start
        ("last", LEG),  # of the last cycle
        ("phase", "i8"),
    ],
    align=True,
)


def run_stats_params(scenario: Scenario, rig: Rig | None, settled_s: float) -> np.record:
    """Return RUN_STATS_PARAMS. rig: with the limits of the axes; None: their margins are not counted."""
    params = new(RUN_STATS_PARAMS)
    params.step_s, params.settled_s = scenario.step_s, settled_s
    params.n_thrusters = len(scenario.chaser.thrusters.position_m)
    params.ready, params.integrity = ready_params(scenario.requirements), integrity(scenario, rig)
    params.tumble = known_tumble(scenario, expected_rate(scenario))
    settings = scenario.gnc.guidance
    for k, name in enumerate(settings.sequence):
        params.transfers[k] = settings.phases[name].kind == "transfer"
    return params


def new_run_stats() -> np.record:
    """Return RUN_STATS of a run before its first row."""
    stats = kernel_record(new(RUN_STATS))
    start_run_stats(stats)
    return stats


def counted(rows: np.ndarray, scenario: Scenario, rig: Rig | None = None) -> np.record:
    """Return RUN_STATS of ``rows`` (n,) of CYCLE, a whole run. rig: as for ``run_stats_params``."""
    stats = new_run_stats()
    count_rows(run_stats_params(scenario, rig, SETTLED_S), stats, rows.view(np.ndarray))
    return stats


@kernel
def start_run_stats(stats):
    """Initialise the zeroed ``stats`` for a run."""
    stats.view_margin = np.inf
    start_integrity(stats.integrity)


@kernel
def _frame_acceleration(params, now):
    """Return the acceleration, m/s^2, that the reference needs because the target's axes rotate."""
    w, dw, a = stack.vector(3), stack.vector(3), stack.vector(3)
    tumble_rate(params.tumble, now.t_s, w, dw)
    frame_acceleration(w, dw, now.reference.r_CT_H, now.reference.v_CT_H, a)
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@kernel
def _count_thrusters(params, now, stats):
    for j in range(params.n_thrusters):
        fraction = now.truth.thrust_fraction[j]
        is_open = 1 if fraction > 0.0 else 0
        stats.thruster_open[j] += fraction
        if is_open != 0 and stats.was_open[j] == 0:
            stats.thruster_firings[j] += 1
        stats.was_open[j] = is_open
    change, in_window = 0.0, _WINDOW_BEGIN_S <= now.t_s < _WINDOW_END_S
    for i in range(3):
        stats.force_cycles[i] += 1 if now.command.force[i] != 0 else 0
        stats.torque_cycles[i] += 1 if now.command.torque[i] != 0 else 0
        stats.torque_cycles_360_400_s[i] += 1 if in_window and now.command.torque[i] != 0 else 0
        if now.reference.phase < MAX_PHASES and params.transfers[now.reference.phase] != 0:
            change += (params.step_s * now.reference.a_CT_H[i]) ** 2
        else:
            change += (now.reference.v_CT_H[i] - stats.reference_v[i]) ** 2
        stats.reference_v[i] = now.reference.v_CT_H[i]
    if change > 0.0:
        stats.reference_delta_v += math.sqrt(change)
    if params.tumble.rotates != 0:
        stats.reference_delta_v += params.step_s * _frame_acceleration(params, now)
    if stats.cycles == 0:
        stats.mass_start = now.truth.mass_kg
    stats.mass_end = now.truth.mass_kg


@kernel
def _note_leg(now, stats):
    """Take the reference of ``now`` as the start of a leg if its phase has begun."""
    last, reference = stats.last, now.reference
    last.t_s = now.t_s
    for i in range(3):
        last.state[i], last.state[3 + i] = reference.r_CT_H[i], reference.v_CT_H[i]
    if (stats.cycles == 0 or reference.phase != stats.phase) and stats.n_legs < MAX_LEGS:
        copy_record(last, stats.leg[stats.n_legs])
        stats.n_legs += 1
    stats.phase = reference.phase


@kernel
def _add_nees(sums, span, which, nees):
    if math.isfinite(nees):
        sums.updates[span, which] += 1
        sums.nees[span, which] += nees


@kernel
def count_navigation(settled_s, sums, now):
    """Add the errors of the estimate in the cycle ``now`` (CYCLE), if it has one. sums: NAVIGATION_SUMS."""
    truth, estimate = now.truth, now.navigation
    if estimate.valid == 0:
        return
    span = SETTLED if now.t_s >= settled_s else BEFORE
    sums.estimates[span] += 1
    p, q = estimate.q_CH, truth.q_CH
    # vector and scalar part of q_true * conj(q_estimate); the small-angle rotation is twice the former
    scalar = p[3] * q[3] + p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    sign = 2.0 if scalar >= 0.0 else -2.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rotation = sign * (p[3] * q[i] - q[3] * p[i] + q[j] * p[k] - q[k] * p[j])
        sums.square_error[span, i] += (truth.r_CT_H[i] - estimate.r_CT_H[i]) ** 2
        sums.square_error[span, 3 + i] += (truth.v_CT_H[i] - estimate.v_CT_H[i]) ** 2
        sums.square_error[span, 6 + i] += rotation * rotation
        sums.square_sigma[span, i] += estimate.sigma_r_m[i] ** 2
        sums.square_sigma[span, 3 + i] += estimate.sigma_attitude_rad[i] ** 2
    _add_nees(sums, span, 0, now.nees_position)
    _add_nees(sums, span, 1, now.nees_attitude)


@entry
def count_cycle(params, stats, now):
    """Count the cycle ``now`` (CYCLE). params: RUN_STATS_PARAMS. stats: RUN_STATS."""
    rate = stack.vector(3)
    truth_kernels.rate_against_hill(now.truth, rate)
    if now.supervision.aborted == 0:  # an abort ends the ready phase
        ready_phase.update_from(
            params.ready, stats.ready, now.t_s, now.truth.r_CT_H, now.truth.v_CT_H, now.truth.q_CH, rate
        )
    update_integrity(params.integrity, stats.integrity, now)
    _count_thrusters(params, now, stats)
    _note_leg(now, stats)
    count_navigation(params.settled_s, stats.navigation, now)
    stats.shadow_cycles += 1.0 - now.truth.sunlight
    stats.cycles += 1


@kernel
def count_rows(params, stats, rows):
    """``count_cycle`` for each of ``rows`` (n,) of CYCLE."""
    for k in range(rows.shape[0]):
        count_cycle(params, stats, rows[k])


@kernel
def count_navigation_of_rows(settled_s, sums, rows):
    """``count_navigation`` for each of ``rows`` (n,) of CYCLE."""
    for k in range(rows.shape[0]):
        count_navigation(settled_s, sums, rows[k])
