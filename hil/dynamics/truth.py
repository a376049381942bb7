"""Truth of a step: relative motion, attitude of the chaser and bending of its array.

Two models of relative motion. NONLINEAR: target and relative vector in inertial axes I under the whole
gravity field, its difference free of cancellation. HILL: the linear motion in the Hill frame H of a
circular orbit (bench paper eq. (11)). The axes in which a step is integrated are called F: I or H, and
the attitude during the step is that of c against F. H is the instantaneous frame of the target's own
position and velocity, or the body frame of a target that rotates against it; the relative state is transformed back
into it at the end of each step.

Thrust, sunlight and the torque of the gravity gradient are constant over the step, the latter two those of mid-step;
everything else is integrated with the classical fourth-order Runge-Kutta method, gravity evaluated beforehand
(docs/explanation/truth.md).
Effects are switched in the parameters; each has its file.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_MODES, MAX_THRUSTERS
from hil.dynamics import cached_gravity, orbit
from hil.dynamics.cached_gravity import CACHED_GRAVITY
from hil.dynamics.central_gravity import GRAVITY_PARAMS
from hil.dynamics.hill import hill_acceleration
from hil.dynamics.mass_properties import (
    BENDING,
    MASS_MODEL,
    MASS_PROPERTIES,
    MODES,
    add_bending,
    add_bending_force,
    bending,
    bending_of_translation,
    set_mass_properties,
)
from hil.dynamics.orbit_forces import ORBIT_FORCES
from hil.dynamics.rigid_body import add_gravity_gradient, add_lever_terms, angular_acceleration, shift
from hil.dynamics.sunlight import PLATE_PARAMS, pressure_force, visible_sun
from hil.dynamics.target_attitude import ALIGNED, TARGET_ATTITUDE, move_target_axes
from hil.dynamics.target_faults import TARGET_MEMORY, move_target, pushed_radius
from hil.dynamics.thruster_faults import THRUST_MEMORY, THRUSTER_ERRORS, step_real_valves
from hil.dynamics.thrusters import ISOLATION, close_isolated, propellant_flow, wrench
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill, fill_matrix
from hil.models.faults import FAULTS
from hil.models.plume import PLUME_MEMORY, PLUME_PARAMS, keep_share, push_of_plumes
from hil.models.valves import step_valves

HILL, NONLINEAR = 0, 1

DSS_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("relative_motion", "i8"),  # HILL or NONLINEAR
        ("held", "i8"),  # axis of H along which a planar chaser is held, about which it turns: 1 x, 2 y, 3 z; 0: none
        ("orbit_rate", "f8"),  # rad/s, mean; the rate of H where the motion is Hill's
        ("inertia", "f8", (3, 3)),  # kg m^2, in c, about the centre of mass
        ("inertia_inverse", "f8", (3, 3)),
        ("mass_centre", "f8", 3),  # m, from the reference point to the centre of mass, in c
        ("n_thrusters", "i8"),
        ("thruster_position", "f8", (MAX_THRUSTERS, 3)),  # m, from the centre of mass, in c
        ("thruster_direction", "f8", (MAX_THRUSTERS, 3)),  # unit force on the vehicle, in c
        ("thruster_force", "f8", MAX_THRUSTERS),  # N
        ("minimum_on_s", "f8"),
        ("exhaust_speed", "f8"),  # m/s
        ("mass_loss", "i8"),  # switches: 0 or 1
        ("gravity_gradient", "i8"),
        ("solar_pressure", "i8"),
        ("eclipse", "i8"),
        ("flexible_array", "i8"),
        ("gravity", GRAVITY_PARAMS),
        ("forces", ORBIT_FORCES),
        ("plate", PLATE_PARAMS),
        ("modes", MODES),
        ("sun_I", "f8", 3),  # unit vector to the Sun, inertial
        ("sun_angle", "f8"),  # rad, its apparent radius
        ("shadow_radius", "f8"),  # m, of the central body
        ("thruster_errors", THRUSTER_ERRORS),
        ("thruster_faults", FAULTS),
        ("isolation_closing_s", "f8"),
        ("target_faults", FAULTS),
        ("target_attitude", TARGET_ATTITUDE),
        ("mass", MASS_MODEL),
        ("plume", PLUME_PARAMS),
    ],
    align=True,
)

TRUTH_MEMORY = np.dtype(
    [
        ("gravity", CACHED_GRAVITY),
        ("thrust", THRUST_MEMORY),
        ("isolation", ISOLATION),
        ("target", TARGET_MEMORY),
        ("bending", BENDING),
        ("mass", MASS_PROPERTIES),
        ("plume", PLUME_MEMORY),
    ],
    align=True,
)
"""What a step keeps for the next ones, zeroed before the first."""

# the integrated state, in axes F: r 0:3, v 3:6, q_CF 6:10, w_CI_C 10:13, integral of w 13:16, integral in c of the
# specific force beyond that of the load 16:19, eta of the first mode 19, its rate 20, in the nonlinear model
# r_T_I 21:24, v_T_I 24:27, and eta and rate of each further mode
_N = 27
_STATES = _N + 2 * (MAX_MODES - 1)
_SCRATCH = 4  # scratch vectors of a derivative


@kernel
def _translate(params, gravity, y, dy):
    """Write the free motion into ``dy``. gravity: (10,), a row of ``cached_gravity.gravity_over_step``."""
    for i in range(3):
        dy[i] = y[3 + i]
        dy[21 + i] = y[24 + i]
    if params.relative_motion == HILL:
        hill_acceleration(y[0:3], y[3:6], params.orbit_rate, dy[3:6])
        for i in range(6):
            dy[21 + i] = 0.0  # the target's circle is rotated exactly, once per step
        return
    for i in range(3):
        dy[24 + i] = gravity[i]
        dy[3 + i] = gravity[3 + i]


@kernel
def _add_outer_load(params, inertia, gravity, sun_F, y, load):
    """Add what sunlight and the gravity gradient give in mid-step to ``load``.

    The attitude is as the rate at the start takes it there: the torques are good to the square of the angle turned in
    half a step. gravity: as for ``_translate``, in mid-step. sun_F: (3,), unit vector. y: the state at the start.
    """
    q, out, transformed = stack.vector(4), stack.vector(3), stack.vector(3)
    _rate_against_f(params, y, transformed)
    quat.rate_of_change(y[6:10], transformed, q)
    for i in range(4):
        q[i] = y[6 + i] + 0.5 * params.dt_s * q[i]
    quat.normalise(q)
    if params.gravity_gradient != 0:
        out[0], out[1], out[2] = 0.0, 0.0, 1.0
        rate_squared = params.orbit_rate * params.orbit_rate
        if params.relative_motion != HILL:
            copy_into(out, gravity[6:9])
            rate_squared = gravity[9]
        quat.transform_into(q, out, transformed)
        add_gravity_gradient(inertia, transformed, rate_squared, load[3:6])
    if params.solar_pressure != 0:
        quat.transform_into(q, sun_F, transformed)
        pressure_force(params.plate, load[7], transformed, out)
        arm = params.plate.arm
        load[3] += arm[1] * out[2] - arm[2] * out[1]
        load[4] += arm[2] * out[0] - arm[0] * out[2]
        load[5] += arm[0] * out[1] - arm[1] * out[0]
        for i in range(3):
            load[i] += out[i] * load[6]


@kernel
def _place_of_mode(mode):
    """Return where the state has eta of ``mode``; its rate is the next."""
    return 19 if mode == 0 else _N + 2 * (mode - 1)


@kernel
def _rate_against_f(params, y, out):
    """Write the rate of c against F (3,), rad/s, in c: ``w_CF = w_CI - A(q) w_FI`` (bench paper eq. (3))."""
    copy_into(out, y[10:13])
    if params.relative_motion == HILL:  # H rotates with [0, -w0, 0]
        y_C = stack.vector(3)
        quat.second_column_into(y[6:10], y_C)
        for i in range(3):
            out[i] += y_C[i] * params.orbit_rate


@kernel
def _derivative(params, mass, gravity, y, load, scratch, dy):
    """Write dy/dt.

    mass: MASS_PROPERTIES. gravity: see ``_translate``. load: specific force (3,), m/s^2, and torque (3,), N m, of the
    step, both in c, one over the mass, 1/kg, and the pressure of sunlight, Pa. scratch: (_SCRATCH, 3).
    """
    force, torque, direction, transformed = scratch[0], scratch[1], scratch[2], scratch[3]
    modes = params.modes
    n_modes = modes.n if params.flexible_array != 0 else 0
    moves = n_modes > 0 and modes.moves != 0
    inertia, inverse = params.inertia, params.inertia_inverse
    if n_modes > 0:
        inverse = modes.inertia_inverse
    if params.mass.varies != 0:
        inertia, inverse = mass.inertia, mass.inertia_inverse
    for i in range(3):
        force[i], torque[i] = load[i], load[3 + i]
        dy[16 + i] = 0.0
    _translate(params, gravity, y, dy)
    q = y[6:10]
    dy[19], dy[20] = 0.0, 0.0
    if moves:
        for i in range(3):
            force[i] /= load[6]
    for k in range(n_modes):
        at = _place_of_mode(k)
        # the spring, until the accelerations are known
        dy[at + 1] = add_bending(modes, k, y[10:13], y[at], y[at + 1], torque)
        if moves:
            add_bending_force(modes, k, y[10:13], dy[at + 1], y[at + 1], force)
    if moves:
        for i in range(3):
            torque[i] += mass.lever[i, 0] * force[0] + mass.lever[i, 1] * force[1] + mass.lever[i, 2] * force[2]
    angular_acceleration(inertia, inverse, y[10:13], torque, dy[10:13])
    if moves:
        for i in range(3):
            transformed[i] = 0.0
            for j in range(3):
                transformed[i] += mass.mass_inverse[i, j] * force[j] + mass.lever[j, i] * dy[10 + j]
            dy[16 + i] = transformed[i] - load[i]
        copy_into(force, transformed)
    for k in range(n_modes):
        at = _place_of_mode(k)
        dy[at] = y[at + 1]
        dy[at + 1] = bending(modes, k, dy[at + 1], dy[10:13])
        if moves:
            dy[at + 1] += bending_of_translation(modes, k, force)
    quat.transform_back_into(q, force, transformed)
    for i in range(3):
        dy[3 + i] += transformed[i]
        dy[13 + i] = y[10 + i]
    _rate_against_f(params, y, direction)
    quat.rate_of_change(q, direction, dy[6:10])


@kernel
def _integrate(params, mass, gravity, y, load, dt):
    """Move ``y`` on by ``dt`` with one classical Runge-Kutta step, in place.

    mass: MASS_PROPERTIES. gravity: (3, 10) of ``cached_gravity.gravity_over_step``.
    """
    if params.flexible_array != 0 and params.modes.n > 1:
        _runge_kutta(params, mass, gravity, y, load, dt, _N + 2 * (params.modes.n - 1))
    else:
        _runge_kutta(params, mass, gravity, y, load, dt, _N)


@kernel
def _runge_kutta(params, mass, gravity, y, load, dt, n):
    """``_integrate`` the first ``n`` of ``y``; a constant makes the sums vector instructions."""
    k = stack.matrix(4, _STATES)
    trial = stack.vector(_STATES)
    scratch = stack.matrix(_SCRATCH, 3)
    copy_into(trial[:n], y[:n])
    for stage in range(4):
        if stage > 0:
            part = dt if stage == 3 else 0.5 * dt
            for i in range(n):
                trial[i] = y[i] + part * k[stage - 1, i]
        _derivative(params, mass, gravity[(stage + 1) // 2], trial, load, scratch, k[stage])
    for i in range(n):
        y[i] += dt / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@kernel
def _enter(params, bent, truth, y):
    """Write the integrated state for ``truth``: from H into F, from the reference point to the centre of mass.

    bent: BENDING.
    """
    r = y[0:3]
    v = y[3:6]
    w, a = stack.vector(3), stack.matrix(3, 3)
    q_ch, q_hi = stack.vector(4), stack.vector(4)
    copy_into(q_ch, truth.q_CH)
    quat.to_matrix_into(q_ch, a)
    for i in range(3):
        r[i] = truth.r_CT_H[i]
        v[i] = truth.v_CT_H[i]
        y[10 + i] = truth.w_CI_C[i]
        y[13 + i], y[16 + i] = 0.0, 0.0
        y[21 + i] = truth.r_T_I[i]
        y[24 + i] = truth.v_T_I[i]
        w[i] = truth.w_CI_C[i]
        for j in range(3):
            w[i] -= a[i, j] * truth.w_HI_H[j]
    shift(q_ch, params.mass_centre, w, 1.0, r, v)
    copy_into(y[6:10], q_ch)
    y[19], y[20] = truth.eta, truth.eta_rate
    for k in range(1, params.modes.n):
        at = _place_of_mode(k)
        y[at], y[at + 1] = bent.eta[k], bent.eta_rate[k]
    if params.relative_motion != HILL:
        copy_into(q_hi, truth.q_HI)
        w_HI = truth.w_HI_H
        v[0] += w_HI[1] * r[2] - w_HI[2] * r[1]
        v[1] += w_HI[2] * r[0] - w_HI[0] * r[2]
        v[2] += w_HI[0] * r[1] - w_HI[1] * r[0]
        quat.transform_back_into(q_hi, v, v)
        quat.transform_back_into(q_hi, r, r)
        quat.multiply_into(q_ch, q_hi, y[6:10])


@kernel
def _move_frame(params, acceleration, y, truth):
    """Bring target and Hill frame of ``truth`` to the end of the step; acceleration: (3,), m/s^2, the target's."""
    a = stack.matrix(3, 3)
    r = y[21:24]
    v = y[24:27]
    rate, q_hi = stack.vector(3), stack.vector(4)
    fill(rate, 0.0)
    if params.relative_motion == HILL:
        orbit.rotate_on_circle(r, v, params.orbit_rate * params.dt_s)
        orbit.hill_frame(r, v, a)
        rate[1] = -params.orbit_rate
    else:
        orbit.hill_frame(r, v, a)
        orbit.hill_rate(r, v, acceleration, a, rate)
    orbit.quaternion_near(a, truth.q_HI, q_hi)
    if params.target_attitude.motion != ALIGNED:
        move_target_axes(params.target_attitude, params.dt_s, truth.t_s, truth, q_hi, rate)
    copy_into(truth.r_T_I, r)
    copy_into(truth.v_T_I, v)
    copy_into(truth.q_HI, q_hi)
    copy_into(truth.w_HI_H, rate)


@kernel
def _leave(params, y, bent, truth):
    """Write the relative state of ``truth`` from the integrated one; the frame H is already that of the end.

    bent: BENDING.
    """
    r = y[0:3]
    v = y[3:6]
    q_ch = y[6:10]
    q_hi, q_cf, w = stack.vector(4), stack.vector(4), stack.vector(3)
    quat.normalise(q_ch)
    if params.relative_motion != HILL:
        copy_into(q_hi, truth.q_HI)
        w_HI = truth.w_HI_H
        quat.transform_into(q_hi, r, r)
        quat.transform_into(q_hi, v, v)
        v[0] -= w_HI[1] * r[2] - w_HI[2] * r[1]
        v[1] -= w_HI[2] * r[0] - w_HI[0] * r[2]
        v[2] -= w_HI[0] * r[1] - w_HI[1] * r[0]
        copy_into(q_cf, q_ch)
        quat.conjugate_into(q_hi, q_hi)
        quat.multiply_into(q_cf, q_hi, q_ch)
    for i in range(3):
        truth.w_CI_C[i] = y[10 + i]
    for i in range(4):
        truth.q_CH[i] = q_ch[i]
    rate_against_hill(truth, w)
    shift(q_ch, params.mass_centre, w, -1.0, r, v)
    for i in range(3):
        truth.r_CT_H[i] = r[i]
        truth.v_CT_H[i] = v[i]
    truth.eta, truth.eta_rate = y[19], y[20]
    for k in range(1, params.modes.n):
        at = _place_of_mode(k)
        bent.eta[k], bent.eta_rate[k] = y[at], y[at + 1]


@kernel
def _push_target(params, radius, fraction, memory, truth, gravity, y):
    """Add the change of a step by the plumes of the thrusters to ``y`` and to the target's acceleration in ``gravity``.

    The push is constant in F over the step. radius: m, of the target. fraction: (n,), thrust over nominal thrust.
    memory: PLUME_MEMORY. truth: TRUTH at the start of the step. gravity: see ``_integrate``.
    """
    dt = params.dt_s
    push = stack.vector(3)
    keep_share(params.plume, memory, truth.t_s, push_of_plumes(params, radius, fraction, truth, push))
    if params.relative_motion != HILL:
        quat.transform_back_into(truth.q_HI, push, push)
    for i in range(3):
        gained = dt * push[i]
        y[i] -= 0.5 * dt * gained
        y[3 + i] -= gained
        if params.relative_motion != HILL:
            y[21 + i] += 0.5 * dt * gained
            y[24 + i] += gained
            gravity[2, i] += push[i]


@kernel
def hold_in_plane(held, truth):
    """Project the relative state of ``truth`` on a plane of H and the rotation in it, with the means of a step.

    held: 1, 2, 3: the plane across x, y or z. What holds the chaser, a floor, takes whatever acts out of the plane.
    """
    rate, w = stack.vector(3), stack.vector(3)
    rate_against_hill(truth, rate)
    k = held - 1
    truth.r_CT_H[k] = truth.v_CT_H[k] = 0.0
    quat.keep_turn(k, truth.q_CH)
    quat.transform_into(truth.q_CH, truth.w_HI_H, w)
    w[k] += rate[k]
    for i in range(3):
        if i != k:
            truth.mean_rate_C[i] = w[i]
    truth.mean_force_C[k] = 0.0
    copy_into(truth.w_CI_C, w)


@kernel
def step(params, field, memory, truth, on):
    """Move ``truth`` (TRUTH) on by one step, in place, with the thruster commands ``on`` (n,), 0 or 1.

    field: the harmonics, (N + 1, N + 1, 6), as ``central_gravity.field_table`` gives them. memory: TRUTH_MEMORY.
    """
    dt = params.dt_s
    n = params.n_thrusters
    fraction = truth.thrust_fraction
    if params.thruster_faults.n == 0 and params.thruster_errors.enabled == 0:
        step_valves(on[:n], truth.open_s[:n], params.minimum_on_s, dt, fraction[:n])
    else:
        step_real_valves(
            params.thruster_faults, params.thruster_errors, memory.thrust, truth, on[:n], params.minimum_on_s, dt,
            fraction[:n],
        )  # fmt: skip
    if memory.isolation.acts != 0:
        close_isolated(memory.isolation, params.isolation_closing_s, dt, fraction[:n])
    radius = params.plume.radius
    if params.target_faults.n != 0:
        move_target(params.target_faults, memory.target, truth)
        radius = pushed_radius(params.target_faults, truth.t_s, radius)
    if params.mass.varies != 0:
        set_mass_properties(params, truth.mass_kg, memory.mass)
    load, y, sun_f, w_before = stack.vector(8), stack.vector(_STATES), stack.vector(3), stack.vector(3)
    held, gravity, drag = stack.matrix(4, 3), stack.matrix(3, 10), stack.vector(3)
    wrench(
        fraction,
        params.thruster_position,
        params.thruster_direction,
        params.thruster_force,
        n,
        load[0:3],
        load[3:6],
    )
    load[6] = 1.0 / truth.mass_kg
    load[7] = params.plate.pressure * truth.sunlight
    for i in range(3):
        load[i] /= truth.mass_kg
    _enter(params, memory.bending, truth, y)
    copy_into(sun_f, params.sun_I)
    if params.relative_motion == HILL:
        quat.transform_into(truth.q_HI, sun_f, sun_f)
    fill_matrix(held, 0.0)
    fill(drag, 0.0)
    if params.relative_motion != HILL:
        if params.gravity.degree >= 2 or params.forces.acts != 0:
            cached_gravity.interpolate_perturbation(
                params.gravity, params.forces, field, truth.t_s, y[21:24], y[24:27], y[0:3], y[3:6], dt,
                memory.gravity, held,
            )  # fmt: skip
        if params.forces.acts != 0:
            quat.transform_into(y[6:10], memory.gravity.drag, drag)
        cached_gravity.gravity_over_step(params.gravity.gm, held, y, load, dt, gravity)
    _add_outer_load(
        params, memory.mass.inertia if params.mass.varies != 0 else params.inertia, gravity[1], sun_f, y, load
    )
    _integrate(params, memory.mass, gravity, y, load, dt)
    if radius > 0.0:
        _push_target(params, radius, fraction, memory.plume, truth, gravity, y)
    truth.t_s += dt
    _move_frame(params, gravity[2], y, truth)
    copy_into(w_before, truth.w_CI_C)
    _leave(params, y, memory.bending, truth)
    for i in range(3):
        truth.mean_rate_C[i] = y[13 + i] / dt
        truth.mean_force_C[i] = load[i] + y[16 + i] / dt
    if params.forces.acts != 0:
        for i in range(3):
            truth.mean_force_C[i] += drag[i]
    if params.eclipse != 0:
        truth.sunlight = visible_sun(params.shadow_radius, params.sun_angle, truth.r_T_I, params.sun_I)
    add_lever_terms(params.mass_centre, w_before, truth.w_CI_C, truth.mean_rate_C, dt, truth.mean_force_C)
    if params.held != 0:
        hold_in_plane(params.held, truth)
    if params.mass_loss != 0:
        truth.mass_kg -= dt * propellant_flow(fraction, params.thruster_force, params.exhaust_speed, n)


@kernel
def rate_against_hill(truth, out):
    """Write w_CH_C (3,), rad/s: the chaser's rate against H, ``w_CI_C - A(q_CH) w_HI_H``, in c."""
    a = stack.matrix(3, 3)
    quat.to_matrix_into(truth.q_CH, a)
    w = truth.w_HI_H
    for i in range(3):
        out[i] = truth.w_CI_C[i] - (a[i, 0] * w[0] + a[i, 1] * w[1] + a[i, 2] * w[2])
