"""Parameters of a target that rotates against its Hill frame, from user units to SI."""

from __future__ import annotations

import math

import numpy as np

from hil.config.scenario import Scenario
from hil.config.tables.target import MovingTarget
from hil.core.messages import Array, new
from hil.dynamics.target_attitude import (
    ALIGNED,
    LIMIT_CYCLE,
    TARGET_ATTITUDE,
    TUMBLE,
    add_limit_cycle,
)
from hil.maths import elementary, euler, linear, quat
from hil.maths.elementary import square
from hil.maths.special import first_kind, landen_moduli
from hil.models import rotating_frame
from hil.models.rotating_frame import euler_acceleration

MOTIONS = {"aligned": ALIGNED, "tumble": TUMBLE, "limit_cycle": LIMIT_CYCLE}
_STEADY = 1e-14  # rad/s^2: a body that rotates about a principal axis, or a sphere
_SEPARATRIX = 1.0 - 1e-12  # largest parameter of the elliptic functions


def target_attitude(scenario: Scenario) -> np.record:
    """Return TARGET_ATTITUDE: the true motion."""
    params, target = new(TARGET_ATTITUDE), scenario.target
    params.motion = MOTIONS[target.motion]
    params.moments, params.q_PB = target.moments_kg_m2, principal_axes(target)
    cycle = target.limit_cycle
    params.amplitude, params.rate = np.radians(cycle.amplitude_deg), np.radians(cycle.rate_degps)
    params.acceleration, params.phase = math.radians(cycle.acceleration_degps2), cycle.phase_cycles
    return params


def known_tumble(scenario: Scenario, mean_motion: float) -> np.record:
    """Return TUMBLE as the GNC is given it, with its errors; of a target that keeps its axes aligned all zero.

    mean_motion: rad/s, the rate that it takes the axes of a target with a limit cycle to have.
    """
    if scenario.target.motion != "tumble":
        params = new(rotating_frame.TUMBLE)
        if scenario.target.motion == "limit_cycle":
            params.rotates = 1
            params.amplitude[:, 2] = np.radians(scenario.gnc.target.rate_error_degps)
            params.amplitude[1, 2] -= mean_motion
        return params
    return tumble(scenario.target, known_rate(scenario))


def known_rate(scenario: Scenario) -> Array:
    """Return the rate (3,) of a target that tumbles at the start, rad/s, as the GNC is given it, with its error."""
    rate: Array = np.radians(np.array(scenario.target.rate_degps) + scenario.gnc.target.rate_error_degps)
    return rate


def inertia(target: MovingTarget) -> Array:
    """Return the inertia (3, 3) of the target's body, kg m^2, in its axes."""
    axes = quat.to_matrix(principal_axes(target))
    matrix: Array = linear.product(axes.T * np.array(target.moments_kg_m2), axes)
    return matrix


def tumble(target: MovingTarget, rate: Array) -> np.record:
    """Return TUMBLE of a free body with ``rate`` (3,), rad/s, in its body axes at the start.

    Closed solution of Euler's equations: Landau and Lifshitz, Mechanics, 37.
    """
    params, axes = new(rotating_frame.TUMBLE), quat.to_matrix(principal_axes(target))
    params.rotates = 1
    w, moments, change = linear.product(axes, rate), np.array(target.moments_kg_m2), np.empty(3)
    euler_acceleration(moments, w, change)
    if np.abs(change).max() < _STEADY:
        params.amplitude[:, 2] = rate
        return params
    order = np.argsort(moments)
    momentum_squared, energy = float(square(moments * w).sum()), float((moments * w * w).sum())  # twice the energy
    if momentum_squared < energy * moments[order[1]]:
        order = order[::-1]
    i1, i2, i3 = moments[order]
    w1, w2, w3 = w[order]
    low, high = energy * i3 - momentum_squared, momentum_squared - energy * i1
    a1 = math.sqrt(max(0.0, low / (i1 * (i3 - i1))))
    a2 = math.sqrt(max(0.0, low / (i2 * (i3 - i2))))
    a3 = math.sqrt(high / (i3 * (i3 - i1)))
    third = math.copysign(1.0, w3)
    # an odd order of the axes makes them left-handed
    second = third * math.copysign(1.0, i3 - i2) * (1.0 if (order[1] - order[0]) % 3 == 1 else -1.0)
    parameter = float(min(_SEPARATRIX, max(0.0, (i2 - i1) * low / ((i3 - i2) * high))))
    params.parameter, params.steps = parameter, landen_moduli(parameter, params.moduli)
    params.frequency = math.sqrt((i3 - i2) * high / (i1 * i2 * i3))
    params.phase = first_kind(elementary.atan2(second * w2 * a1, w1 * a2), parameter)
    amplitude = np.zeros((3, 3))
    amplitude[order[1], 0], amplitude[order[0], 1], amplitude[order[2], 2] = second * a2, a1, third * a3
    params.amplitude = linear.product(axes.T, amplitude)
    return params


def start_attitude(scenario: Scenario, q_HI: Array, w_HI_H: Array) -> tuple[Array, Array]:
    """Return attitude (4,) and rate (3,), rad/s, of the target's axes at the start; those given: of the Hill frame."""
    target = scenario.target
    if target.motion == "tumble":
        own = euler.to_quaternion(np.radians(target.attitude_deg), euler.YAW_PITCH_ROLL)
        return quat.multiply(own, q_HI), np.radians(target.rate_degps)
    q, w = q_HI.copy(), w_HI_H.copy()
    if target.motion == "limit_cycle":
        add_limit_cycle(target_attitude(scenario), 0.0, q, w)
    return q, w


def principal_axes(target: MovingTarget) -> Array:
    """Return the quaternion from the body axes of a target to its principal ones."""
    attitude: Array = euler.to_quaternion(np.radians(target.principal_axes_deg), euler.YAW_PITCH_ROLL)
    return attitude
