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


def smooth(path: Path, span_s: float) -> Path:
    """Return ``path`` with its jerk limited by a mean over ``span_s``, as the bench sends it."""

    def mean(t_s: float) -> tuple[float, float]:
        n = round(span_s / 0.004)
        position, rate = np.mean([path(max(0.0, t_s - 0.004 * k)) for k in range(n)], axis=0)
        return float(position), float(rate)

    return mean


def deliver(
    path: Path, gaps: list[tuple[float, float]], end_s: float = 7.0, averaging_s: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return what is delivered, (n, 3) of time, position, rate, and the speed of an axis that follows it, (n,).

    gaps: from, to: no delivery in between. The axis is that of the rig file, in steps of 2 ms.
    """
    limiter = SetpointLimiter(SPEED_MAX, ACCELERATION_MAX, averaging_s)
    axes = ServoAxes(load_rig("mock").value.rails)
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


@pytest.mark.parametrize("second_s", [0.1, 0.19, 0.38])
@pytest.mark.parametrize("averaging_s", [0.0, 0.1])
def test_a_gap_while_an_axis_catches_up_is_caught_up_as_well(second_s: float, averaging_s: float) -> None:
    path = smooth(ramp, averaging_s) if averaging_s else ramp
    rows, speeds = deliver(path, [(2.0, 2.1), (2.3, 2.3 + second_s)], averaging_s=averaging_s)
    assert speeds[round((2.3 + second_s) / STEP_S) * 10 :].max() < 1.1 * SPEED_MAX
    assert rows[-1, 1:] == pytest.approx(ramp(rows[-1, 0]), abs=1e-9)


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


@pytest.mark.parametrize("step_s", [STEP_S, 0.004])
@pytest.mark.parametrize(("begin_s", "gap_s"), [(0.4, 0.38), (2.0, 0.19), (4.2, 0.19)])
def test_an_axis_with_a_limit_of_the_jerk_catches_up_within_it(begin_s: float, gap_s: float, step_s: float) -> None:
    span_s = 0.2
    limiter, path = SetpointLimiter(SPEED_MAX, ACCELERATION_MAX, span_s), smooth(ramp, span_s)
    limiter.restart(0.0, 0.0)
    found: list[tuple[float, float]] = []
    measured = 0.0, 0.0, 0.0
    for k in range(1, round(6.0 / step_s)):
        t_s = k * step_s
        if begin_s <= t_s < begin_s + gap_s:
            position, rate = path(begin_s)
            measured = t_s + step_s, position + 0.05 * rate, 0.5 * rate  # the drive has begun to brake
            found.clear()
        else:
            now = measured if not found and t_s > begin_s else (t_s, *path(t_s))
            found.append(limiter.next(*path(t_s), t_s, t_s, now))
    positions, rate = [position for position, _ in found], found[0][1]
    positions = [positions[0] + rate * k * step_s for k in (-3, -2, -1)] + positions
    jerk = np.abs(np.diff(positions, 3)).max() / step_s**3
    assert jerk <= 1.02 * 2.0 * ACCELERATION_MAX / span_s
    assert np.abs(np.diff(positions, 2)).max() / step_s**2 <= 1.01 * ACCELERATION_MAX
    assert max(abs(rate) for _, rate in found) <= SPEED_MAX + 1e-9
    assert max(positions) < 1.002
    assert found[-1] == path(round(6.0 / step_s - 1) * step_s) == (1.0, 0.0)
