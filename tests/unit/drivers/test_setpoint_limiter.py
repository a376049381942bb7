"""Setpoints after a gap: an axis catches up within the limits of its move; regular setpoints pass unchanged."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.drivers.axes import ServoAxes
from hil.drivers.setpoint_limiter import SetpointLimiter

STEP_S = 0.02
SPEED, SPEED_MAX, ACCELERATION_MAX = 0.25, 0.275, 0.33

Path = Callable[[float], tuple[float, float]]


def ramp(t_s: float) -> tuple[float, float]:
    """Return position and rate of a move of 1 m from rest to rest, 0.3 m/s2, 0.25 m/s."""
    up_s, end_s = SPEED / 0.3, 1.0 / SPEED + SPEED / 0.3
    if t_s > 0.5 * end_s:
        position, rate = ramp(max(0.0, end_s - t_s)) if t_s < end_s else (0.0, 0.0)
        return 1.0 - position, rate
    return (0.15 * t_s * t_s, 0.3 * t_s) if t_s < up_s else (0.5 * SPEED * up_s + SPEED * (t_s - up_s), SPEED)


def deliver(path: Path, gaps: list[tuple[float, float]], end_s: float = 7.0) -> tuple[np.ndarray, np.ndarray]:
    """Return what is delivered, (n, 3) of time, position, rate, and the speed of an axis that follows it, (n,).

    gaps: from, to: no delivery in between. The axis is that of the rig file, in steps of 2 ms.
    """
    limiter, axes = SetpointLimiter(SPEED_MAX, ACCELERATION_MAX), ServoAxes(load_rig("mock").value.rails)
    axes.position[:] = 0.0
    axes.hold()
    limiter.restart(0.0, 0.0)
    rows, speeds = [], []
    for k in range(1, round(end_s / STEP_S)):
        t_s = k * STEP_S
        if not any(begin <= t_s < end for begin, end in gaps):
            position, rate = limiter.next(*path(t_s), t_s, t_s, (t_s, float(axes.position[0]), float(axes.rate[0])))
            axes.setpoint[0], axes.feedforward[0] = position, rate
            rows.append((t_s, position, rate))
        for _ in range(10):
            axes.step(0.1 * STEP_S)
            speeds.append(float(axes.rate[0]))
    return np.array(rows), np.array(speeds)


def test_regular_setpoints_pass_unchanged() -> None:
    rows, _ = deliver(ramp, [])
    assert [tuple(row) for row in rows] == [(t_s, *ramp(t_s)) for t_s in rows[:, 0]]


@pytest.mark.parametrize("gap_s", [0.04, 0.1, 0.19, 0.38])
@pytest.mark.parametrize("begin_s", [0.4, 2.0, 4.2])
def test_an_axis_catches_up_within_the_limits_of_its_move(begin_s: float, gap_s: float) -> None:
    rows, speeds = deliver(ramp, [(begin_s, begin_s + gap_s)])
    after = rows[rows[:, 0] >= begin_s - 1e-9]
    assert np.abs(after[:, 2]).max() <= SPEED_MAX + 1e-9
    steps = np.diff(after[:, 1]) / np.diff(after[:, 0])
    assert np.abs(steps).max() < 1.15 * SPEED_MAX  # the last of them may bring the axis up to its setpoint
    resumed = round((begin_s + gap_s) / STEP_S) * 10
    assert speeds[resumed:].max() < 1.1 * SPEED_MAX  # of which a tenth is the ripple of the servo in regular motion
    assert speeds[resumed + 100 :].min() > -0.03  # does not pass the goal
    assert rows[-1, 1:].tolist() == list(ramp(rows[-1, 0]))


def test_a_jump_of_the_setpoint_after_a_standstill_is_a_ramp() -> None:
    limiter = SetpointLimiter(SPEED_MAX, ACCELERATION_MAX)
    limiter.restart(0.0, 0.0)
    rates = [limiter.next(0.5, 0.0, 1.0, 1.0 + k * STEP_S, (1.0 + k * STEP_S, 0.0, 0.0)) for k in range(200)]
    assert rates[-1] == (0.5, 0.0)
    speeds = np.diff([position for position, _ in rates]) / STEP_S
    assert speeds.max() <= SPEED_MAX + 1e-9
    assert np.abs(np.diff(speeds)).max() <= ACCELERATION_MAX * STEP_S * 1.5
    assert math.isclose(max(position for position, _ in rates), 0.5)


def test_a_slow_wire_that_skips_setpoints_regularly_is_no_gap() -> None:
    limiter = SetpointLimiter(SPEED_MAX, ACCELERATION_MAX)
    limiter.restart(0.0, 0.0)
    lag = []
    for k in range(1, 120):
        t_s = k * 2.0 * STEP_S
        position, _ = limiter.next(*ramp(t_s), t_s, t_s, (t_s, *ramp(t_s)))
        lag.append(ramp(t_s)[0] - position)
    assert max(lag[20:]) == 0.0


def test_fast_setpoints_on_an_irregular_wire_are_followed() -> None:
    limiter = SetpointLimiter(SPEED_MAX, ACCELERATION_MAX)
    limiter.restart(0.0, 0.0)
    t_s, lag = 0.0, []
    for k in range(1000):  # of 1 kHz the wire takes every second or third, now and then a thread is late
        t_s += (0.002, 0.003, 0.002, 0.008, 0.002, 0.009)[k % 6]
        position, _ = limiter.next(*ramp(t_s), t_s, t_s, (t_s - 0.002, *ramp(t_s - 0.002)))
        lag.append(ramp(t_s)[0] - position)
    assert max(lag) == 0.0


def test_setpoints_without_an_answer_may_have_been_lost() -> None:
    limiter = SetpointLimiter(SPEED_MAX, ACCELERATION_MAX)
    limiter.restart(0.0, 0.0)
    for k in range(1, 11):
        assert limiter.next(0.002 * k, 0.1, 0.02 * k, 0.02 * k, (0.02, 0.001, 0.1)) == (0.002 * k, 0.1)
    position, rate = limiter.next(0.022, 0.1, 0.22, 0.22, (0.22, 0.005, 0.0))
    assert (position, rate) == pytest.approx((0.005 + 0.02 * ACCELERATION_MAX * 0.02, ACCELERATION_MAX * 0.02))
