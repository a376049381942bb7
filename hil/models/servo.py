"""Model of a position-controlled axis with lag, speed and acceleration limits and end stops.

Shared by the mocks and the device emulators: a position loop of gain ``kp`` with velocity feed-forward, and a drive
that follows its speed command as a first-order lag ``tau``.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import stack
from hil.maths.limits import cut_to_range

_LANES: Final = 6
_ROWS: Final = 7


def servo_record(n: int) -> np.dtype:
    """Return the record of ``n`` axes: arguments of ``servo_step``, and what faults add to readings and setpoints."""
    return np.dtype(
        [
            ("t_s", "f8"),  # time of position and rate
            ("position", "f8", n),
            ("rate", "f8", n),
            ("setpoint", "f8", n),
            ("feedforward", "f8", n),
            ("kp", "f8", n),
            ("tau", "f8", n),
            ("rate_max", "f8", n),
            ("rate_min", "f8", n),
            ("acceleration_max", "f8", n),
            ("low", "f8", n),
            ("high", "f8", n),
            ("encoder_offset", "f8", n),  # reading minus position
            ("disturbance", "f8", n),  # added to each setpoint
            ("disturbance_rate", "f8", n),
        ],
        align=True,
    )


SERVO = servo_record(3)
"""Three axes of a device."""


@kernel
def _substeps(tau, dt):
    """Return the number of substeps of a step of ``dt``, s, for a lag of ``tau``, s."""
    return int(dt / (0.25 * tau)) + 1


@kernel
def _demand(position, setpoint, feedforward, kp):
    """Return the rate command of the position loop."""
    return feedforward + kp * (setpoint - position)


@kernel
def _is_free(position, rate, demand, kp, rate_max, low, high, dt):
    """Return whether an axis comes neither to its largest rate nor to an end stop within ``dt``, s; False if unsure.

    Below the largest rate the demand changes by at most ``kp rate_max dt``, and the rate stays between both.
    """
    reach = rate_max * dt
    return max(abs(demand), abs(rate)) <= rate_max - kp * reach and low + reach <= position <= high - reach


@kernel
def _free_substep(error, rate, share, gain, change_max):
    """Return demand minus rate, and rate, of a free axis after a substep.

    share: fraction of the error corrected, h / tau. gain: kp h. change_max: of the rate in a substep.
    """
    change = min(change_max, max(-change_max, error * share))
    return error - gain * rate - (1.0 + gain) * change, rate + change


@kernel
def _limited_step(position, rate, setpoint, feedforward, kp, tau, rate_max, acceleration_max, low, high, dt):
    """Return position and rate of one axis after a step at its limits; arguments: see ``servo_step``."""
    n = _substeps(tau, dt)
    h = dt / n
    share, change_max, goal = h / tau, acceleration_max * h, feedforward + kp * setpoint
    for _ in range(n):
        demand = min(rate_max, max(-rate_max, goal - kp * position))
        rate += min(change_max, max(-change_max, (demand - rate) * share))
        position += rate * h
        if position < low:
            position = low
            rate = 0.0
        elif position > high:
            position = high
            rate = 0.0
    return position, rate


@kernel
def servo_step(position, rate, setpoint, feedforward, kp, tau, rate_max, acceleration_max, low, high, dt):
    """Advance axes by ``dt``, s, in place. All arguments but ``dt`` are arrays of shape (n,).

    position, rate: state, m and m/s (or rad and rad/s). setpoint, feedforward: commanded position and
    its rate. kp: 1/s. tau: s. rate_max, acceleration_max: limits. low, high: end stops, at which the
    axis stops. The step is divided into substeps well below the lag.
    """
    for i in range(position.shape[0]):
        demand = _demand(position[i], setpoint[i], feedforward[i], kp[i])
        if _is_free(position[i], rate[i], demand, kp[i], rate_max[i], low[i], high[i], dt):
            n = _substeps(tau[i], dt)
            h = dt / n
            share, change_max, gain, error = h / tau[i], acceleration_max[i] * h, kp[i] * h, demand - rate[i]
            for _ in range(n):
                error, rate[i] = _free_substep(error, rate[i], share, gain, change_max)
                position[i] += rate[i] * h
        else:
            position[i], rate[i] = _limited_step(
                position[i], rate[i], setpoint[i], feedforward[i], kp[i], tau[i], rate_max[i], acceleration_max[i],
                low[i], high[i], dt,
            )  # fmt: skip


@kernel
def move_servo(axes, now_s):
    """Move three axes (SERVO) to ``now_s``, unless that is in the past."""
    left_s = now_s - axes.t_s
    if left_s <= 0.0:
        return
    axes.t_s = now_s
    servo_step(
        axes.position, axes.rate, axes.setpoint, axes.feedforward, axes.kp, axes.tau,
        axes.rate_max, axes.acceleration_max, axes.low, axes.high, left_s,
    )  # fmt: skip


@kernel
def send_to_servo(axes, position, rate, now_s, accepted):
    """Set the setpoint of three axes (SERVO) at ``now_s``, ``position`` and ``rate`` (3,), cut to their ranges.

    Writes the accepted positions into ``accepted`` (3,). Returns False, and sets nothing, if a number is not finite.
    """
    feedforward = stack.vector(3)
    if cut_to_range(position, axes.low, axes.high, accepted) >= 0:
        return False
    if cut_to_range(rate, axes.rate_min, axes.rate_max, feedforward) >= 0:
        return False
    move_servo(axes, now_s)
    for i in range(3):
        axes.setpoint[i] = accepted[i] - axes.encoder_offset[i] + axes.disturbance[i]
        axes.feedforward[i] = feedforward[i] + axes.disturbance_rate[i]
    return True


@kernel
def servo_step_of_two(one, other, dt):
    """``servo_step`` of two devices of three axes each, bit-identical: free axes are computed together for speed.

    one, other: records with the arguments of ``servo_step`` as fields; the three axes of each have the same lag.
    """
    lanes = stack.matrix(_ROWS, _LANES)
    n_one, n_other = _substeps(one.tau[0], dt), _substeps(other.tau[0], dt)
    _lay_out(one, dt / n_one, 0, lanes)
    _lay_out(other, dt / n_other, 3, lanes)
    both = min(n_one, n_other)
    _run_substeps(lanes, both)
    if n_one != n_other:
        done = 0 if n_one == both else 3
        for i in range(done, done + 3):  # substeps of zero duration
            lanes[3, i] = lanes[4, i] = lanes[6, i] = 0.0
        _run_substeps(lanes, max(n_one, n_other) - both)
    _take(one, dt, 0, lanes)
    _take(other, dt, 3, lanes)


@kernel
def _lay_out(axes, h, first, lanes):
    """Write position, rate and the arguments of ``_free_substep`` of three axes to columns from ``first`` on."""
    share = h / axes.tau[0]
    for i in range(3):
        j = first + i
        lanes[0, j], lanes[1, j] = axes.position[i], axes.rate[i]
        lanes[2, j] = _demand(axes.position[i], axes.setpoint[i], axes.feedforward[i], axes.kp[i]) - axes.rate[i]
        lanes[3, j], lanes[4, j], lanes[5, j], lanes[6, j] = share, axes.kp[i] * h, axes.acceleration_max[i] * h, h


@kernel
def _take(axes, dt, first, lanes):
    """Take what ``_run_substeps`` has computed of free axes; move the others by themselves."""
    for i in range(3):
        demand = _demand(axes.position[i], axes.setpoint[i], axes.feedforward[i], axes.kp[i])
        if _is_free(
            axes.position[i], axes.rate[i], demand, axes.kp[i], axes.rate_max[i], axes.low[i], axes.high[i], dt
        ):
            axes.position[i], axes.rate[i] = lanes[0, first + i], lanes[1, first + i]
        else:
            axes.position[i], axes.rate[i] = _limited_step(
                axes.position[i], axes.rate[i], axes.setpoint[i], axes.feedforward[i], axes.kp[i], axes.tau[i],
                axes.rate_max[i], axes.acceleration_max[i], axes.low[i], axes.high[i], dt,
            )  # fmt: skip


@kernel
def _run_substeps(lanes, n):
    """Advance all lanes by ``n`` substeps."""
    for _ in range(n):
        for i in range(_LANES):
            lanes[2, i], lanes[1, i] = _free_substep(lanes[2, i], lanes[1, i], lanes[3, i], lanes[4, i], lanes[5, i])
            lanes[0, i] += lanes[1, i] * lanes[6, i]
