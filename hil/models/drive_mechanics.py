"""Mechanics of a driven axis: friction, backlash, torsional compliance, cogging and a quantised encoder.

Two masses, motor and load, behind a spring with a gap (G. Ellis, Control System Design Guide, 4th ed., ch. 16;
M. Nordin and P.-O. Gutman, Controlling mechanical systems with backlash, Automatica 38, 2002). Friction is the LuGre
model (C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, A new model for control of systems with friction,
IEEE Trans. Autom. Control 40(3), 1995). The drive closes its loop on the encoder of the motor: what backlash and
compliance add after it, no encoder shows. All forces are divided by the moved mass (torques by the inertia): m/s^2 or
rad/s^2.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary

SUBSTEP_S: Final = 1e-4
"""Longest step of the integration; frequencies of the model are far below 1 / SUBSTEP_S."""


def drive_mechanics_record(n: int) -> np.dtype:
    """Return the record of ``n`` axes: state and parameters in addition to SERVO; 0 switches an effect off."""
    return np.dtype(
        [
            ("motor", "f8", n),  # at the load's side of the gear
            ("motor_rate", "f8", n),
            ("counted", "f8", n),  # by the encoder, on the motor
            ("rate_reference", "f8", n),  # of the velocity loop
            ("integral", "f8", n),  # of the velocity loop
            ("bristle", "f8", n),  # mean deflection of the bristles, the state of LuGre friction
            ("velocity_gain", "f8", n),  # 1/s
            ("force_max", "f8", n),
            ("coulomb", "f8", n),
            ("breakaway", "f8", n),
            ("stribeck", "f8", n),  # speed
            ("viscous", "f8", n),  # 1/s
            ("presliding", "f8", n),  # deflection at break-away
            ("gap", "f8", n),
            ("stiffness", "f8", n),  # 1/s^2; 0: rigid
            ("damping", "f8", n),  # 1/s
            ("load_fraction", "f8", n),  # of the moved mass
            ("cogging", "f8", n),
            ("cogging_period", "f8", n),
            ("encoder_step", "f8", n),
        ],
        align=True,
    )


DRIVE_MECHANICS = drive_mechanics_record(3)
"""Three axes, in m or rad."""

_INTEGRAL_FRACTION: Final = 0.25  # corner of the velocity loop's integrator, of its gain


@kernel
def encoder_reading(position, step):
    """Return ``position`` as an encoder of resolution ``step`` counts it; 0: exact."""
    return step * math.floor(position / step + 0.5) if step > 0.0 else position


@kernel
def friction_step(bristle, rate, coulomb, breakaway, stribeck, viscous, presliding, mass, h):
    """Return the bristles' deflection after ``h``, s, and the friction, which opposes ``rate``.

    LuGre: dz/dt = v - sigma0 |v| z / g(v), F = sigma0 z + sigma1 dz/dt + sigma2 v, with sigma0 = breakaway / presliding
    and sigma1 = sqrt(sigma0 mass), as in the paper's example. Implicit in z, so that speed sets no limit to the step.
    """
    if breakaway <= 0.0:
        return 0.0, viscous * rate
    ratio = rate / stribeck
    level = coulomb + (breakaway - coulomb) * elementary.exp(-ratio * ratio)
    stiffness = breakaway / presliding
    after = (bristle + h * rate) / (1.0 + h * abs(rate) * stiffness / level)
    slip = (after - bristle) / h
    return after, stiffness * after + math.sqrt(stiffness * mass) * slip + viscous * rate


@kernel
def spring_force(twist, twist_rate, gap, stiffness, damping):
    """Return the force from motor to load; none within the gap, and a contact only pushes."""
    over = max(0.0, abs(twist) - 0.5 * gap)
    if over == 0.0:
        return 0.0
    side = 1.0 if twist > 0.0 else -1.0
    push = stiffness * over + damping * twist_rate * side
    return side * max(0.0, push) if gap > 0.0 else side * push


@kernel
def drive_mechanics_step(axes, m, dt):
    """Advance axes by ``dt``, s, in place. axes: SERVO, position and rate are the load's; m: DRIVE_MECHANICS.

    Without any effect the axis moves as in ``servo_step``: the velocity loop follows the same reference.
    """
    if dt <= 0.0:
        return
    n = int(dt / SUBSTEP_S) + 1
    h = dt / n
    for i in range(axes.position.shape[0]):
        load, rate = axes.position[i], axes.rate[i]
        motor, motor_rate = m.motor[i], m.motor_rate[i]
        reference, integral, bristle = m.rate_reference[i], m.integral[i], m.bristle[i]
        gain, load_mass = m.velocity_gain[i], m.load_fraction[i]
        rigid = m.stiffness[i] == 0.0
        for _ in range(n):
            error = axes.setpoint[i] - encoder_reading(motor, m.encoder_step[i])
            demand = axes.feedforward[i] + axes.kp[i] * error
            demand = min(axes.rate_max[i], max(-axes.rate_max[i], demand))
            acceleration = (demand - reference) / axes.tau[i]
            acceleration = min(axes.acceleration_max[i], max(-axes.acceleration_max[i], acceleration))
            reference += h * acceleration
            behind = reference - motor_rate
            asked = acceleration + gain * behind + integral
            force = min(m.force_max[i], max(-m.force_max[i], asked))
            if force == asked:
                integral += h * _INTEGRAL_FRACTION * gain * gain * behind
            if m.cogging[i] > 0.0:
                force += m.cogging[i] * elementary.sin(2.0 * math.pi * motor / m.cogging_period[i])
            moved = motor_rate if rigid else rate
            mass = 1.0 if rigid else load_mass
            bristle, friction = friction_step(
                bristle, moved, m.coulomb[i], m.breakaway[i], m.stribeck[i], m.viscous[i], m.presliding[i], mass, h
            )
            if rigid:  # the load lies against one side of the gap
                motor_rate += h * (force - friction)
                motor += h * motor_rate
                held = min(motor + 0.5 * m.gap[i], max(motor - 0.5 * m.gap[i], load))
                rate = (held - load) / h
                load = held
            else:
                push = spring_force(motor - load, motor_rate - rate, m.gap[i], m.stiffness[i], m.damping[i])
                motor_rate += h * (force - push) / (1.0 - load_mass)
                motor += h * motor_rate
                rate += h * (push - friction) / load_mass
                load += h * rate
            if load < axes.low[i] or load > axes.high[i]:
                load = min(axes.high[i], max(axes.low[i], load))
                motor = min(load + 0.5 * m.gap[i], max(load - 0.5 * m.gap[i], motor))
                rate = motor_rate = reference = integral = 0.0
        axes.position[i], axes.rate[i] = load, rate
        m.motor[i], m.motor_rate[i] = motor, motor_rate
        m.counted[i] = encoder_reading(motor, m.encoder_step[i])
        m.rate_reference[i], m.integral[i], m.bristle[i] = reference, integral, bristle
