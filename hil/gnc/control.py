"""Position and attitude control that ends in on/off demands: a phase plane for each of six axes.

The switching function of an axis is

    s = e + tau * e_dot + e_dot |e_dot| / (2 a)

with the error ``e``, its rate, a lead time ``tau`` and the acceleration ``a`` that the axis has. Its
last term is the parabola on which a full-thrust braking ends at rest; ``tau`` damps and leads lag and
noise. ``e`` is cut to ``tau`` times the greatest rate at which an error may be worked off, so a large
error is approached at that rate and not with one long burst each way; never to what the dead band hides.

An axis decides once per period. Lead, dead band and burns follow from the noise of navigation and from the smallest
change of rate d that the valves can fire (docs/explanation/control.md derives them):

- lead: the ratio of the standard deviations of error and rate, with which both have an equal part in the noise of s,
  at most the time in which d moves s through the noise's dead band, and between two bounds; without noise the shorter.
- dead band: ``deadband_sigmas`` standard deviations of s or tau d / 2, the larger one, and a coast. From one
  edge d may not reach the other; the coast is the amplitude d^2 / (4 u) of a limit cycle with the mean acceleration u.
  The brake of an abort has no noise in it.
- burn: against s back to the edge of the dead band, and one smallest burn.

The reference's acceleration is fed forward, with what axes of H that rotate ask beyond it
(``hil.gnc.estimation.body_frame``): the change of rate that it requires over the coming period is fired in one burn,
unless that is less than half a smallest one. The part required and not yet fired, or fired ahead, is the pending
delta-v (``owed`` in COMMAND); the rate error is taken against the reference's rate without it, so feedback never fires
the same change again.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import entry, kernel
from hil.gnc.predictive import STEPS, predicted_burn
from hil.maths import quat, stack
from hil.maths.arrays import fill

COAST_OF_TOLERANCE = 0.25  # that a limit cycle may take at most: its coast of the tolerance, its firing of the rate
_FIRED = 0.5  # of a smallest firing, from which on one is fired
_JUST_FIRED = 0.51  # above it by a margin for rounding: 0.5 + 1e-7 flies as well
_KNOWN = 3.0  # standard deviations of the rate within the correction rate
_BEYOND = 0.75  # of what a smallest firing moves s by, beyond the dead band: half of one may be pending against it
_SHARE = 0.5  # of the tolerance, of each of ripple and error

CONTROL_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        # six axes: force along x, y, z, then torque about x, y, z
        ("deadband", "f8", 6),  # m, rad: least coast
        ("deadband_sigmas", "f8", 6),  # standard deviations of s
        ("lead", "f8", 6),  # s, 0: between the bounds, by noise and smallest burn
        ("lead_bounds", "f8", (6, 2)),  # s
        ("coast_scale", "f8", 6),  # s^2/m, s^2/rad: 1 / (4 u), of the square of the smallest change of rate
        ("coast_max", "f8", 6),  # m, rad
        ("rate_max", "f8", 6),  # m/s, rad/s: of the requirement
        ("go_fraction", "f8"),  # of the requirements, within which docking is a go
        ("go_s", "f8"),  # for which a go promises the ready state
        ("drift", "f8", 6),  # m/s^2, rad/s^2: largest acceleration without thrust
        ("pulse_s", "f8"),  # least time for which a valve opens
        ("correction_rate", "f8", 6),  # m/s, rad/s: greatest rate at which an error is worked off
        ("period", "i8", 6),  # cycles
        ("acceleration", "f8", 6),  # m/s^2, rad/s^2 of a demand
        ("high_thrust_acceleration", "f8", 3),  # m/s^2 of a force demand with the full-thrust sets
        ("inertia", "f8", (3, 3)),  # kg m^2, in c
        ("predicts", "i8"),  # 1: burns are those of the predictive law
        ("held", "i8", 6),  # 1: an axis in which the vehicle is held has no demands
    ],
    align=True,
)


@kernel
def lead_time(params, axis, sigma, sigma_rate, pulse):
    """Return the lead of an axis, s. sigma, sigma_rate: of error and rate, nan if unknown. pulse: d, m/s or rad/s."""
    if params.lead[axis] > 0.0:
        return params.lead[axis]
    low, high = params.lead_bounds[axis, 0], params.lead_bounds[axis, 1]
    used = params.deadband_sigmas[axis] * sigma
    if not (sigma_rate >= 0.0 and used >= 0.0):
        return math.sqrt(low * high)
    lead = min(high, 2.0 * used / pulse)
    if sigma_rate > 0.0:
        lead = min(lead, sigma / sigma_rate)
    return max(low, lead)


@kernel
def coast_of(params, axis, pulse):
    """Return the amplitude of the limit cycle of an axis, m or rad. pulse: d, m/s or rad/s."""
    return max(params.deadband[axis], min(params.coast_max[axis], params.coast_scale[axis] * pulse * pulse))


@kernel
def dead_band(lead, noise, coast, pulse):
    """Return the dead band of s, m or rad. noise: what noise alone makes of s."""
    return max(noise, 0.5 * lead * pulse) + coast


@kernel
def rule_of(params, axis, sigma, sigma_rate, pulse):
    """Return lead, s, and noise, coast and dead band of s, m or rad, of an axis; arguments: see ``lead_time``."""
    lead = lead_time(params, axis, sigma, sigma_rate, pulse)
    noise = params.deadband_sigmas[axis] * math.sqrt(sigma**2 + (lead * sigma_rate) ** 2)
    if not noise > 0.0:
        noise = 0.0
    coast = coast_of(params, axis, pulse)
    return lead, noise, coast, dead_band(lead, noise, coast, pulse)


@kernel
def is_steady(params, axis, error, sustained, pulse):
    """Return whether a small error is corrected by the firings that a sustained acceleration, m/s^2 or rad/s^2, asks.

    pulse: d, m/s or rad/s. Between two of them, ``d / |a|``, at most the longest lead, the rate passes from -d/2 to d/2
    and the error by ``ripple``; neither error nor ripple may exceed half of the tolerance.
    """
    near = _SHARE / COAST_OF_TOLERANCE * params.coast_max[axis]
    often = pulse <= params.lead_bounds[axis, 1] * abs(sustained)
    return often and abs(error) <= near and ripple(sustained, pulse) <= near


@kernel
def is_busy(params, feed):
    """Return whether rotating axes ask so much torque that firings of it are seldom single. feed: FEED_FORWARD."""
    for axis in range(3, 6):
        pulse = params.acceleration[axis] * params.pulse_s
        if feed.rotates != 0 and pulse <= params.lead_bounds[axis, 1] * abs(feed.acceleration[axis]):
            return True
    return False


@kernel
def ripple(sustained, pulse):
    """Return the amplitude of the error, m or rad, if smallest firings give a sustained acceleration."""
    return 0.125 * pulse * pulse / abs(sustained) if sustained != 0.0 else np.inf


@kernel
def cut_error(params, axis, error, lead, band, pulse):
    """Return the error, m or rad, cut to what is worked off at the correction rate, but beyond the dead band.

    A vehicle with coarse firings has a dead band in which the correction rate alone would never fire. Arguments: see
    ``burn_time``, ``modulation``.
    """
    reach = max(lead * params.correction_rate[axis], band + _BEYOND * lead * pulse)
    return min(reach, max(-reach, error))


@kernel
def modulation(params, axis, error, rate, sigma, sigma_rate, sustained, pulse, pending, coming):
    """Return the correction, m/s or rad/s, that the firings against a sustained acceleration give in addition.

    The correction delays or advances these firings; at most it asks for one smallest firing in the direction of the
    acceleration. sustained: acceleration, m/s^2 or rad/s^2. pulse: smallest firing d, m/s or rad/s. pending: delta-v
    not yet given. coming: delta-v that the next period adds. Other arguments: see ``update_axis``.
    """
    lead = lead_time(params, axis, sigma, sigma_rate, pulse)
    lead = max(lead, min(2.0 * pulse / abs(sustained), params.lead_bounds[axis, 1]))
    noise = params.deadband_sigmas[axis] * math.sqrt(sigma**2 + (lead * sigma_rate) ** 2)
    band = (noise if noise > 0.0 else 0.0) + ripple(sustained, pulse)
    s = cut_error(params, axis, error, lead, band, pulse) + lead * (rate + pending)
    delta_v = -math.copysign(max(0.0, abs(s) - band), s) / lead
    sense = math.copysign(1.0, sustained)
    return sense * max(sense * delta_v, -max(0.0, _JUST_FIRED * pulse + sense * (pending + coming)))


@kernel
def burn_time(error, rate, acceleration, lead, band, shortest):
    """Return for how long to fire, s, negative against a positive s; 0 in the dead band.

    band: dead band of s, m or rad. shortest: least time of a firing, s.
    """
    s = error + lead * rate + rate * abs(rate) / (2.0 * acceleration)
    if abs(s) <= band:
        return 0.0
    time = (abs(s) - band) / (lead * acceleration) + shortest
    return -time if s > 0.0 else time


@kernel
def burn_cycles(time, least, extra, period, dt):
    """Return the cycles to command for a firing of ``time``, s of either sign: at least one, at most ``period``.

    least: s for which a valve opens at least. extra: s that each firing gives beyond that, as a tail does.
    """
    cycles = min(period, max(1, int((abs(time) - extra + 1e-9) / dt)))
    if cycles * dt <= least:
        cycles = 1
    return -cycles if time < 0.0 else cycles


@kernel
def firing_time(cycles, least, extra, dt):
    """Return for how long valves give thrust, s, that are commanded for ``cycles``, of either sign."""
    if cycles == 0:
        return 0.0
    time = max(least, abs(cycles) * dt) + extra
    return -time if cycles < 0 else time


@kernel
def yet_to_drift(params, axis, sustained, pulse, owed):
    """Return by how much the rate changes until a sustained acceleration is next fired, m/s or rad/s.

    It is fired once half a smallest firing of it is pending; no longer than half of the longest lead counts. Arguments
    as in ``modulation``.
    """
    sense = math.copysign(1.0, sustained)
    pending = max(0.0, _FIRED * pulse - sense * owed)
    return -sense * min(pending, 0.5 * params.lead_bounds[axis, 1] * abs(sustained))


@kernel
def slowed(params, axis, error, rate, sustained, pulse, owed, feedback, cycles, least, extra, acceleration):
    """Return the cycles to command for a firing so that the requirement on the rate is kept, of the same sign or 0.

    Where the smallest firing d is more of that rate than a limit cycle may take, an error within the tolerance is
    corrected no faster than docking is a go. A firing that is too much waits until the rate has grown against it, for
    the limit cycle has the rates +-d / 2 and a firing from rest d, or the error to what is no go.
    feedback: part of the firing that is none of the pending delta-v, m/s or rad/s. Other arguments: see ``modulation``.
    """
    tolerance, asked = params.coast_max[axis] / COAST_OF_TOLERANCE, cycles
    most = params.go_fraction * params.rate_max[axis]
    while cycles != 0 and pulse > COAST_OF_TOLERANCE * params.rate_max[axis] and abs(error) <= tolerance:
        gain = firing_time(cycles, least, extra, params.dt_s) * acceleration
        remaining = owed + feedback * cycles / asked - gain
        after = max(abs(rate + gain), abs(rate + gain + yet_to_drift(params, axis, sustained, pulse, remaining)))
        leaves = abs(error) > params.go_fraction * tolerance and error * rate >= 0.0
        if after <= max(abs(rate), most) or (leaves and abs(cycles) == 1):
            break
        cycles -= 1 if cycles > 0 else -1
    return cycles


@kernel
def held_error(params, axis, error, rate, sigma, sigma_rate, sustained, pulse):
    """Return the largest error of an axis over the time of a go, m or rad, on the estimate.

    If the axis coasts for that long without leaving its dead band, the largest error of the coast; else the edge of the
    dead band and what a smallest firing travels until the next decision. Arguments as in ``update_axis``.
    """
    lead, noise, _, band = rule_of(params, axis, sigma, sigma_rate, pulse)
    if is_steady(params, axis, error, sustained, pulse):
        band = noise + ripple(sustained, pulse)
    gained = params.drift[axis] * params.go_s
    coasted = max(abs(error), abs(error + rate * params.go_s) + 0.5 * gained * params.go_s)
    if coasted + lead * (abs(rate) + gained) <= band:
        return coasted
    return max(abs(error), band + pulse * params.period[axis] * params.dt_s)


@kernel
def update_axis(params, feed, axis, error, rate, sigma, sigma_rate, feed_forward, sustained, acceleration, command):
    """Update one of the six axes: continue its burn, or decide again when its period is over.

    feed: FEED_FORWARD, of which the firings are used. error, rate: m, m/s or rad, rad/s. sigma, sigma_rate: their
    standard deviations; nan counts as zero. feed_forward: acceleration of the
    reference and of rotating axes, m/s^2 or rad/s^2.
    sustained: what these ask.
    """
    dt = params.dt_s
    if command.until_decision[axis] <= 0:
        period, least, extra = params.period[axis], params.pulse_s, feed.extra_s
        shortest = least + extra
        pulse = acceleration * max(shortest, feed.pulse_s)
        lead, noise, coast, band = rule_of(params, axis, sigma, sigma_rate, pulse)
        if command.boost != 0:
            noise, band = 0.0, dead_band(lead, 0.0, coast, pulse)
        # while the filters converge, errors that the noise of the rate hides wait
        known = noise if _KNOWN * sigma_rate <= params.correction_rate[axis] else 0.0
        cut = cut_error(params, axis, error, lead, dead_band(lead, known, coast, pulse), pulse)
        if params.predicts != 0 and command.boost == 0 and abs(error) <= band:
            bands = stack.vector(STEPS)
            bands[0] = band
            for j in range(1, STEPS):
                ahead = (j + 1) * lead
                noise = params.deadband_sigmas[axis] * math.sqrt(sigma**2 + (ahead * sigma_rate) ** 2)
                bands[j] = dead_band(ahead, noise if noise > 0.0 else 0.0, coast, 2.0 * pulse)
            time = predicted_burn(error, rate + command.owed[axis], acceleration, lead, bands, shortest)
        else:
            time = burn_time(cut, rate + command.owed[axis], acceleration, lead, band, shortest)
        owed, coming, feedback = command.owed[axis], feed_forward * period * dt, 0.0
        if command.boost == 0 and is_steady(params, axis, error, sustained, pulse):
            feedback = modulation(
                params, axis, error, rate, sigma, sigma_rate, sustained, pulse, owed, coming
            ) / acceleration  # fmt: skip
        elif time != 0.0:
            feedback = firing_time(burn_cycles(time, least, extra, period, dt), least, extra, dt)
        time = feedback + (owed + coming) / acceleration
        cycles = 0
        if abs(time) >= _FIRED * shortest:
            cycles = burn_cycles(time + math.copysign(0.5 * dt, time), least, extra, period, dt)
        if command.boost == 0:
            fired = cycles
            cycles = slowed(
                params, axis, error, rate, sustained, pulse, owed + coming, feedback * acceleration, cycles, least,
                extra, acceleration,
            )  # fmt: skip
            if cycles != fired:
                feedback = 0.0 if cycles == 0 else feedback * cycles / fired
        command.owed[axis] -= (firing_time(cycles, least, extra, dt) - feedback) * acceleration
        command.cycles_left[axis] = cycles
        command.until_decision[axis] = period
    command.owed[axis] += feed_forward * dt
    command.until_decision[axis] -= 1
    remaining = command.cycles_left[axis]
    demand = 0
    if remaining > 0:
        demand = 1
    elif remaining < 0:
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
        ("rotates", "i8"),  # 1: the axes of H are those of a target that tumbles
        ("turned", "i8"),  # 1: rate or angular acceleration were not zero
        ("transit_C", "f8", 6),  # m/s, rad/s: what has been fired and is not felt yet, as valves are late
        ("pulse_s", "f8"),  # least time for which valves open, as the thruster monitor has measured it
        ("extra_s", "f8"),  # what each firing gives beyond that of the data sheet
    ],
    align=True,
)
"""What a reference that turns, axes of H that rotate, and late valves ask of control; zero without any of them."""


@entry
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
    sustained_c = stack.vector(3)
    for i in range(3):
        error_c[i] = navigation.r_CT_H[i] - reference.r_CT_H[i]
        rate_c[i] = navigation.v_CT_H[i] - reference.v_CT_H[i]
    quat.transform_into(navigation.q_CH, error_c, error_c)
    quat.transform_into(navigation.q_CH, rate_c, rate_c)
    for i in range(3):
        rate_c[i] += feed.transit_C[i]
        acceleration_c[i] = reference.a_CT_H[i] + feed.acceleration[i]
        sustained_c[i] = feed.acceleration[i] if feed.rotates != 0 else 0.0
    quat.transform_into(navigation.q_CH, acceleration_c, acceleration_c)
    quat.transform_into(navigation.q_CH, sustained_c, sustained_c)
    quat.rotation_between(navigation.q_CH, reference.q_CH, rotation)
    for i in range(3):
        acceleration = params.high_thrust_acceleration[i] if command.boost != 0 else params.acceleration[i]
        sigma, sigma_rate = navigation.sigma_r_m[i], navigation.sigma_v_mps[i]
        if params.held[i] == 0:
            update_axis(
                params, feed, i, error_c[i], rate_c[i], sigma, sigma_rate, acceleration_c[i], sustained_c[i],
                acceleration, command,
            )  # fmt: skip
        if params.held[3 + i] == 0:
            update_axis(
                params, feed, 3 + i, rotation[i], navigation.w_CH_C[i] - feed.rate_C[i] + feed.transit_C[3 + i],
                navigation.sigma_attitude_rad[i], 0.0, feed.acceleration[3 + i],
                feed.acceleration[3 + i] if feed.rotates != 0 else 0.0, params.acceleration[3 + i], command,
            )  # fmt: skip


@kernel
def predict_hold(params, navigation, reference, feed, hold):
    """Write ``held_error`` of each axis to ``hold`` (6,), m, rad, with c parallel to H, as within Table III.

    Other arguments: see ``control``.
    """
    rotation = stack.vector(3)
    quat.rotation_between(navigation.q_CH, reference.q_CH, rotation)
    shortest = max(params.pulse_s + feed.extra_s, feed.pulse_s)
    for i in range(3):
        hold[i] = held_error(
            params, i, navigation.r_CT_H[i] - reference.r_CT_H[i], navigation.v_CT_H[i] - reference.v_CT_H[i],
            navigation.sigma_r_m[i], navigation.sigma_v_mps[i], feed.acceleration[i] if feed.rotates != 0 else 0.0,
            params.acceleration[i] * shortest,
        )  # fmt: skip
        hold[3 + i] = held_error(
            params, 3 + i, rotation[i], navigation.w_CH_C[i] - feed.rate_C[i], navigation.sigma_attitude_rad[i], 0.0,
            feed.acceleration[3 + i] if feed.rotates != 0 else 0.0, params.acceleration[3 + i] * shortest,
        )  # fmt: skip
        if params.held[i] != 0:
            hold[i] = abs(navigation.r_CT_H[i] - reference.r_CT_H[i])
        if params.held[3 + i] != 0:
            hold[3 + i] = abs(rotation[i])
