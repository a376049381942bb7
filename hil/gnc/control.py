"""Position and attitude control that ends in on/off demands: a phase plane for each of six axes.

The switching function of an axis is

    s = e + tau * e_dot + e_dot |e_dot| / (2 a)

with the error ``e``, its rate, a lead time ``tau`` and the acceleration ``a`` that the axis has. Its
last term is the parabola on which a full-thrust braking ends at rest; ``tau`` damps and leads lag and
noise. ``e`` is cut to ``tau`` times the greatest rate at which an error may be worked off, so a large
error is approached at that rate and not with one long burst each way.

An axis decides once per period. Outside the dead band it fires against s for as long as takes s to zero,
``|s| / (tau a)``, at least one cycle and at most the period. The dead band is the set one plus
``deadband_sigmas`` times the standard deviation of s by the covariance of navigation: far out, and while
the filters converge, s is mostly noise, and propellant spent on noise is spent twice. The brake of an
abort has the set dead band only.

The reference's acceleration is fed forward, with what axes of H that rotate ask beyond it (``hil.gnc.body_frame``):
the change of rate that it requires over the coming period is fired in one burn. The part required and not yet fired,
or fired ahead, is the pending delta-v (``owed`` in COMMAND); the rate error is taken against the reference's rate
without it, so feedback never fires the same change again.
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
        ("deadband_sigmas", "f8", 6),  # standard deviations of s
        ("lead", "f8", 6),  # s
        ("correction_rate", "f8", 6),  # m/s, rad/s: greatest rate at which an error is worked off
        ("period", "i8", 6),  # cycles
        ("acceleration", "f8", 6),  # m/s^2, rad/s^2 of a demand
        ("high_thrust_acceleration", "f8", 3),  # m/s^2 of a force demand with the full-thrust sets
        ("inertia", "f8", (3, 3)),  # kg m^2, in c
    ],
    align=True,
)


@kernel
def burn_duration(error, rate, acceleration, deadband, lead, period, dt):
    """Return how many cycles to fire, at most ``period``, negative against a positive s; 0 in the dead band."""
    s = error + lead * rate + rate * abs(rate) / (2.0 * acceleration)
    if abs(s) <= deadband:
        return 0
    cycles = min(period, max(1, int(abs(s) / (lead * acceleration * dt))))
    return -cycles if s > 0.0 else cycles


@kernel
def update_axis(params, axis, error, rate, sigma, reference_acceleration, acceleration, command):
    """Update one of the six axes: continue its burn, or decide again when its period is over.

    error, rate: m, m/s or rad, rad/s. sigma: standard deviation of s; nan counts as zero.
    """
    dt = params.dt_s
    if command.until_decision[axis] <= 0:
        period, lead = params.period[axis], params.lead[axis]
        deadband = params.deadband[axis]
        if sigma > 0.0 and command.boost == 0:
            deadband += params.deadband_sigmas[axis] * sigma
        reach = lead * params.correction_rate[axis]
        cut = min(reach, max(-reach, error))
        cycles = burn_duration(cut, rate + command.owed[axis], acceleration, deadband, lead, period, dt)
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
def clear_demands(command):
    """Clear the demands of ``command`` (COMMAND), the burns under way and the pending delta-v."""
    fill(command.force, 0)
    fill(command.torque, 0)
    fill(command.cycles_left, 0)
    fill(command.until_decision, 0)
    fill(command.owed, 0.0)


FEED_FORWARD = np.dtype(
    [
        ("acceleration", "f8", 6),  # m/s^2, in H, beyond the reference's own; rad/s^2, about the axes of c
        ("rate_C", "f8", 3),  # rad/s, of the reference against H
        ("q_CH", "f8", 4),  # the reference's attitude of the cycle before
        ("turned", "i8"),  # 1: rate or angular acceleration were not zero
        ("transit_C", "f8", 6),  # m/s, rad/s: what has been fired and is not felt yet, as valves are late
    ],
    align=True,
)
"""What a reference that turns, axes of H that rotate, and late valves ask of control; zero without any of them."""


@kernel
def control(params, navigation, reference, feed, command):
    """Write the six demands of ``command`` (COMMAND), which holds the state of the axes as well.

    navigation: NAVIGATION; while it is not valid there are no demands. reference: REFERENCE. feed: FEED_FORWARD. With
    ``reference.boost`` a force demand has the acceleration of the full-thrust sets; when that begins or
    ends, the axes drop their burns and decide at once. The sigmas of navigation are taken axis by axis as
    if c were parallel to H: they only widen dead bands.
    """
    if command.boost != reference.boost:
        clear_demands(command)
        command.boost = reference.boost
    if navigation.valid == 0:
        clear_demands(command)
        return
    error_c, rate_c, acceleration_c, rotation = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3)
    for i in range(3):
        error_c[i] = navigation.r_CT_H[i] - reference.r_CT_H[i]
        rate_c[i] = navigation.v_CT_H[i] - reference.v_CT_H[i]
    quat.transform_into(navigation.q_CH, error_c, error_c)
    quat.transform_into(navigation.q_CH, rate_c, rate_c)
    for i in range(3):
        rate_c[i] += feed.transit_C[i]
        acceleration_c[i] = reference.a_CT_H[i] + feed.acceleration[i]
    quat.transform_into(navigation.q_CH, acceleration_c, acceleration_c)
    quat.rotation_between(navigation.q_CH, reference.q_CH, rotation)
    for i in range(3):
        acceleration = params.high_thrust_acceleration[i] if command.boost != 0 else params.acceleration[i]
        sigma = 0.0
        if command.until_decision[i] <= 0:
            sigma = math.sqrt(navigation.sigma_r_m[i] ** 2 + (params.lead[i] * navigation.sigma_v_mps[i]) ** 2)
        update_axis(params, i, error_c[i], rate_c[i], sigma, acceleration_c[i], acceleration, command)
        update_axis(
            params,
            3 + i,
            rotation[i],
            navigation.w_CH_C[i] - feed.rate_C[i] + feed.transit_C[3 + i],
            navigation.sigma_attitude_rad[i],
            feed.acceleration[3 + i],
            params.acceleration[3 + i],
            command,
        )
