"""Position and attitude control that ends in on/off demands: a phase plane for each of six axes.

The switching function of an axis is

    s = e + tau * e_dot + e_dot |e_dot| / (2 a)

with the error ``e``, its rate, a lead time ``tau`` and the acceleration ``a`` that the axis has. Its
last term is the parabola on which a full-thrust braking ends at rest; ``tau`` damps and leads lag and
noise. ``e`` is cut to ``tau`` times the greatest rate at which an error may be worked off, so a large
error is approached at that rate and not with one long burst each way.

An axis decides once a period. Outside the dead band it fires against s for as long as takes s to zero,
``|s| / (tau a)``, at least one cycle and at most the period. The dead band is the set one plus
``caution`` times the standard deviation of s as navigation knows it: far out, and while the filters
converge, s is mostly noise, and propellant spent on noise is spent twice. The brake of an abort
knows no caution.

The reference's acceleration is fed forward: what it will ask for over the coming period is fired in
one burn. What was asked for and not yet fired, or fired ahead, is ``owed``; the rate error is counted
against the rate that the reference had without it, so feedback never fires the same change again.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import fill

CONTROL_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        # six axes: force along x, y, z, then torque about x, y, z
        ("deadband", "f8", 6),  # m, rad
        ("caution", "f8", 6),  # standard deviations of s
        ("lead", "f8", 6),  # s
        ("correction_rate", "f8", 6),  # m/s, rad/s: greatest rate at which an error is worked off
        ("period", "i8", 6),  # cycles
        ("acceleration", "f8", 6),  # m/s^2, rad/s^2 of a demand
        ("boosted_acceleration", "f8", 3),  # m/s^2 of a force demand while boosted
    ],
    align=True,
)


@kernel
def burn(error, rate, acceleration, deadband, lead, period, dt):
    """Return how many cycles to fire, at most ``period``, negative against a positive s; 0 in the dead band."""
    s = error + lead * rate + rate * abs(rate) / (2.0 * acceleration)
    if abs(s) <= deadband:
        return 0
    cycles = min(period, max(1, int(abs(s) / (lead * acceleration * dt))))
    return -cycles if s > 0.0 else cycles


@kernel
def _decide(params, axis, error, rate, sigma, reference_acceleration, acceleration, command):
    """Keep up one of the six axes: go on with what it does, or decide anew when its period is over.

    error, rate: m, m/s or rad, rad/s. sigma: standard deviation of s; not a number counts as none.
    """
    dt = params.dt_s
    if command.until_decision[axis] <= 0:
        period, lead = params.period[axis], params.lead[axis]
        deadband = params.deadband[axis]
        if sigma > 0.0 and command.boost == 0:
            deadband += params.caution[axis] * sigma
        reach = lead * params.correction_rate[axis]
        cut = min(reach, max(-reach, error))
        cycles = burn(cut, rate + command.owed[axis], acceleration, deadband, lead, period, dt)
        ahead = round((command.owed[axis] + reference_acceleration * period * dt) / (acceleration * dt))
        ahead = min(period - cycles, max(-period - cycles, ahead))
        command.owed[axis] -= ahead * acceleration * dt
        command.cycles_left[axis] = cycles + ahead
        command.until_decision[axis] = period
    command.owed[axis] += reference_acceleration * dt
    command.until_decision[axis] -= 1
    left = command.cycles_left[axis]
    demand = 0
    if left > 0:
        demand = 1
    elif left < 0:
        demand = -1
    command.cycles_left[axis] -= demand
    if axis < 3:
        command.force[axis] = demand
    else:
        command.torque[axis - 3] = demand


@kernel
def rest(command):
    """Make ``command`` (COMMAND) demand nothing and forget what its axes were about."""
    fill(command.force, 0)
    fill(command.torque, 0)
    fill(command.cycles_left, 0)
    fill(command.until_decision, 0)
    fill(command.owed, 0.0)


@kernel
def control(params, navigation, reference, command):
    """Write the six demands of ``command`` (COMMAND), which holds what the axes are about.

    navigation: NAVIGATION; while it is not valid nothing is demanded. reference: REFERENCE. With
    ``reference.boost`` a force demand counts with the acceleration of the strong thruster sets; where
    it begins or ends, what the axes were about is dropped and they decide at once. The
    sigmas of navigation are taken axis by axis as if c were parallel to H: they do no more than
    widen dead bands.
    """
    if command.boost != reference.boost:
        rest(command)
        command.boost = reference.boost
    if navigation.valid == 0:
        rest(command)
        return
    error_c, rate_c, wanted_c, turn = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3)
    for i in range(3):
        error_c[i] = navigation.r_CT_H[i] - reference.r_CT_H[i]
        rate_c[i] = navigation.v_CT_H[i] - reference.v_CT_H[i]
    quat.transform_into(navigation.q_CH, error_c, error_c)
    quat.transform_into(navigation.q_CH, rate_c, rate_c)
    quat.transform_into(navigation.q_CH, reference.a_CT_H, wanted_c)
    quat.turn_between(navigation.q_CH, reference.q_CH, turn)
    for i in range(3):
        acceleration = params.boosted_acceleration[i] if command.boost != 0 else params.acceleration[i]
        sigma = 0.0
        if command.until_decision[i] <= 0:
            sigma = math.sqrt(navigation.sigma_r_m[i] ** 2 + (params.lead[i] * navigation.sigma_v_mps[i]) ** 2)
        _decide(params, i, error_c[i], rate_c[i], sigma, wanted_c[i], acceleration, command)
        _decide(
            params,
            3 + i,
            turn[i],
            navigation.w_CH_C[i],
            navigation.sigma_attitude_rad[i],
            0.0,
            params.acceleration[3 + i],
            command,
        )
