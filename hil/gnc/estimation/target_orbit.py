"""Rate and gravity gradient of the target's Hill frame H, from the elements of its orbit in the ephemeris of the GNC.

On an ellipse the frame's rate ``w = d(nu)/dt`` and ``k = GM / r^3`` vary with the true anomaly nu:
``w = n (1 + e cos nu)^2 / (1 - e^2)^1.5``, ``k = n^2 (1 + e cos nu)^3 / (1 - e^2)^3``, and the relative motion is

    x'' =  2 w z' + w' z + (w^2 - k) x
    y'' = -k y
    z'' = -2 w x' - w' x + (w^2 + 2 k) z

(Yamanaka and Ankersen 2002, eq. (9), in the axes of H). The filters apply the exact transition of Hill's equations at
the mean motion n, and add the difference of the two accelerations. With harmonics w, k and the rate of H about z are
interpolated from a table that is computed before the run (``hil.models.ephemeris``); what the rate about z and the
gradient of the harmonics do to the relative motion, below 1e-2 n^2 r, is not modelled. H of a target that tumbles is
its body frame: see ``hil.gnc.estimation.body_frame``.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, quat, stack
from hil.maths.arrays import fill
from hil.maths.kepler import true_anomaly
from hil.models.ephemeris import EPHEMERIS, attitude_of_ephemeris, frame_of_ephemeris
from hil.models.rotating_frame import TUMBLE, tumble_rate

TARGET_ORBIT = np.dtype(
    [
        ("mean_motion", "f8"),  # rad/s
        ("eccentricity", "f8"),
        ("mean_anomaly", "f8"),  # rad, at the start of the run
        ("tumble", TUMBLE),  # motion, as known at the start, of a target whose axes are not the Hill frame
        ("estimated", "i8"),  # 1: the filters estimate the rate of a tumble, by Euler's equations
        ("moments", "f8", 3),  # kg m^2, principal, of the body as they are known
        ("q_PB", "f8", 4),  # from its body axes to the principal ones
        ("ephemeris", EPHEMERIS),
    ],
    align=True,
)

HILL_STEP = np.dtype(
    [
        ("turn", "f8"),  # rad, rotation of H over the step, about -y
        ("rate", "f8"),  # rad/s, of H at the end of the step
        ("is_elliptic", "i8"),
        # at mid-step, less than on a circle at the mean motion
        ("coriolis", "f8"),  # 1/s, 2 w
        ("euler", "f8"),  # 1/s^2, w'
        ("along", "f8"),  # 1/s^2, w^2 - k
        ("across", "f8"),  # 1/s^2, -k
        ("down", "f8"),  # 1/s^2, w^2 + 2 k
        # of a target that tumbles, in its axes, or of H with harmonics, beyond that about -y
        ("rotates", "i8"),  # 1: of a target that tumbles
        ("swings", "i8"),  # 1: there are rotation and rate_after
        ("rotation", "f8", 3),  # rad, over the step
        ("rate_before", "f8", 3),  # rad/s, at its start
        ("rate_after", "f8", 3),  # at its end
    ],
    align=True,
)
"""Motion of H over one step of the filters."""


@kernel
def _rate(orbit, nu):
    """Return the rate of H, rad/s, at the true anomaly ``nu``."""
    e = orbit.eccentricity
    rho = 1.0 + e * elementary.cos(nu)
    return orbit.mean_motion * rho * rho / math.sqrt((1.0 - e * e) ** 3)


@kernel
def frame_rate(orbit, t_s, out):
    """Write the rate of H (3,), rad/s, in H, at ``t_s`` of the run; orbit: TARGET_ORBIT."""
    if orbit.tumble.rotates != 0:
        aside = stack.vector(3)
        tumble_rate(orbit.tumble, t_s, out, aside)
        return
    if orbit.ephemeris.n != 0:
        frame_of_ephemeris(orbit.ephemeris, t_s, out)
        out[0], out[1], out[2] = 0.0, -out[0], out[1]
        return
    e, rate = orbit.eccentricity, orbit.mean_motion
    if e != 0.0:
        rate = _rate(orbit, true_anomaly(e, orbit.mean_anomaly + orbit.mean_motion * t_s))
    out[0], out[1], out[2] = 0.0, -rate, 0.0


@kernel
def frame_attitude(orbit, q_start, t_s, q_HI):
    """Write ``q_HI`` (4,) at ``t_s`` of the run, from that at its start; nan for a target that tumbles."""
    turn, rotation = stack.vector(3), stack.vector(4)
    if orbit.ephemeris.n != 0:
        attitude_of_ephemeris(orbit.ephemeris, t_s, q_HI)
        return
    e, first = orbit.eccentricity, orbit.mean_anomaly
    turn[0] = turn[2] = 0.0
    turn[1] = -orbit.mean_motion * t_s
    if e != 0.0:
        turn[1] = true_anomaly(e, first) - true_anomaly(e, first + orbit.mean_motion * t_s)
    quat.from_rotation_vector_into(turn, rotation)
    quat.multiply_into(rotation, q_start, q_HI)
    if orbit.tumble.rotates != 0:
        fill(q_HI, np.nan)


@kernel
def _follow_ephemeris(orbit, start_s, dt, out):
    """Write the motion of H with harmonics."""
    middle, last, n = stack.vector(3), stack.vector(3), orbit.mean_motion
    frame_of_ephemeris(orbit.ephemeris, start_s + 0.5 * dt, middle)
    frame_of_ephemeris(orbit.ephemeris, start_s + dt, last)
    out.swings, out.is_elliptic = 1, 1
    out.turn, out.rate = middle[0] * dt, last[0]
    fill(out.rotation, 0.0)
    fill(out.rate_after, 0.0)
    out.rotation[2], out.rate_after[2] = middle[1] * dt, last[1]
    out.euler = (last[0] - middle[0]) / (0.5 * dt)
    _beyond_circle(n, middle[0], middle[2], out)


@kernel
def _beyond_circle(n, w, k, out):
    """Write the accelerations beyond those on a circle at the mean motion ``n``."""
    out.coriolis = 2.0 * (w - n)
    out.along, out.across, out.down = w * w - k, n * n - k, w * w + 2.0 * k - 3.0 * n * n


@kernel
def move_hill_frame(orbit, start_s, dt, out):
    """Write the motion of H (HILL_STEP) over the step of ``dt`` that starts at ``start_s`` of the run."""
    n = orbit.mean_motion
    out.rotates = out.swings = orbit.tumble.rotates
    if out.rotates != 0:
        out.turn, out.rate, out.is_elliptic = 0.0, 0.0, 0
        if orbit.estimated == 0:  # otherwise the filters write it: ``target_motion.move``
            _tumble(orbit.tumble, start_s, dt, out)
        return
    if orbit.ephemeris.n != 0:
        _follow_ephemeris(orbit, start_s, dt, out)
        return
    if orbit.eccentricity == 0.0:
        out.turn, out.rate, out.is_elliptic = n * dt, n, 0
        return
    e, first = orbit.eccentricity, orbit.mean_anomaly + n * start_s
    nu_first, nu_last = true_anomaly(e, first), true_anomaly(e, first + n * dt)
    nu = 0.5 * (nu_first + nu_last)
    w = _rate(orbit, nu)
    rho = 1.0 + e * elementary.cos(nu)
    k = n * n * (rho / (1.0 - e * e)) ** 3
    out.turn, out.rate, out.is_elliptic = nu_last - nu_first, _rate(orbit, nu_last), 1
    out.euler = -2.0 * e * elementary.sin(nu) * w * w / rho
    _beyond_circle(n, w, k, out)


@kernel
def _tumble(tumble, start_s, dt, out):
    """Write the motion of a body that tumbles; its rotation is that at the rate in mid-step."""
    aside = stack.vector(3)
    tumble_rate(tumble, start_s, out.rate_before, aside)
    tumble_rate(tumble, start_s + dt, out.rate_after, aside)
    tumble_rate(tumble, start_s + 0.5 * dt, out.rotation, aside)
    for i in range(3):
        out.rotation[i] *= dt


@kernel
def add_ellipse(hill, dt, before, after):
    """Add to ``after`` (6,) what the ellipse changes over a step of ``dt`` from ``before`` (6,): [r, v], in H."""
    x, y, z = 0.5 * (before[0] + after[0]), 0.5 * (before[1] + after[1]), 0.5 * (before[2] + after[2])
    vx, vz = 0.5 * (before[3] + after[3]), 0.5 * (before[5] + after[5])
    ax = hill.coriolis * vz + hill.euler * z + hill.along * x
    ay = hill.across * y
    az = -hill.coriolis * vx - hill.euler * x + hill.down * z
    half = 0.5 * dt * dt
    after[0] += half * ax
    after[1] += half * ay
    after[2] += half * az
    after[3] += dt * ax
    after[4] += dt * ay
    after[5] += dt * az
