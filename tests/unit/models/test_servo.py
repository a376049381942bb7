"""The servo axis of mocks and emulators against its linear closed form and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from hil.core.messages import new
from hil.models.servo import SERVO, servo_step, servo_step_of_two

KP, TAU = 25.0, 0.008


class Axis:
    """One axis with its limits."""

    def __init__(self, rate_max: float = 1e6, acceleration_max: float = 1e9, travel: float = 1e9) -> None:
        self.position, self.rate = np.zeros(1), np.zeros(1)
        self.limits = np.array([rate_max]), np.array([acceleration_max]), np.array([-travel]), np.array([travel])

    def step(self, setpoint: float, feedforward: float = 0.0, dt: float = 0.02) -> None:
        wanted = np.array([setpoint]), np.array([feedforward])
        servo_step(self.position, self.rate, *wanted, np.array([KP]), np.array([TAU]), *self.limits, dt)


def test_small_step_response_agrees_with_the_linear_closed_form() -> None:
    axis = Axis()
    dt = 0.0005
    f = np.array([[0.0, 1.0], [-KP / TAU, -1.0 / TAU]])
    for k in range(1, 401):
        axis.step(1.0, dt=dt)
        exact = np.array([1.0, 0.0]) - expm(f * k * dt) @ np.array([1.0, 0.0])
        assert axis.position[0] == pytest.approx(exact[0], abs=0.01)


def test_axis_settles_on_its_setpoint() -> None:
    axis = Axis(rate_max=0.5, acceleration_max=0.6)
    for _ in range(600):
        axis.step(0.3)
    assert axis.position[0] == pytest.approx(0.3, abs=1e-9)
    assert axis.rate[0] == pytest.approx(0.0, abs=1e-9)


def test_feedforward_takes_the_lag_out_of_a_ramp() -> None:
    led, late = Axis(), Axis()
    for k in range(200):
        led.step(0.1 * 0.02 * (k + 1), 0.1)
        late.step(0.1 * 0.02 * (k + 1))
    ramp = 0.1 * 0.02 * 200
    # the setpoint stands over the step, so the axis runs up to a period ahead of it with feed-forward
    assert abs(led.position[0] - ramp) <= 0.1 * 0.02
    assert ramp - late.position[0] == pytest.approx(0.1 / KP, abs=0.1 * 0.02)


def test_an_axis_that_may_come_to_a_limit_but_does_not_moves_like_a_free_one(rng: np.random.Generator) -> None:
    free, watched = Axis(acceleration_max=0.6), Axis(acceleration_max=0.6, travel=1e4)
    for setpoint, feedforward in rng.uniform(-5e-4, 5e-4, (100, 2)):
        for axis in free, watched:
            axis.step(setpoint, feedforward)
        np.testing.assert_allclose(watched.position, free.position, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(watched.rate, free.rate, rtol=0.0, atol=1e-13)


@given(st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0)), min_size=1, max_size=40))
def test_speed_acceleration_and_travel_keep_their_limits(commands: list[tuple[float, float]]) -> None:
    axis = Axis(rate_max=0.5, acceleration_max=0.6, travel=1e9)
    for setpoint, feedforward in commands:
        before, position = axis.rate[0], axis.position[0]
        axis.step(setpoint, feedforward)
        assert abs(axis.rate[0]) <= 0.5 + 1e-12
        assert abs(axis.rate[0] - before) <= 0.6 * 0.02 + 1e-12
        assert abs(axis.position[0] - position) <= 0.5 * 0.02 + 1e-12


def test_axis_stops_at_its_end_stop_and_leaves_it_again() -> None:
    axis = Axis(rate_max=0.5, travel=0.2)
    for _ in range(100):
        axis.step(5.0)
        assert axis.position[0] <= 0.2
    assert (axis.position[0], axis.rate[0]) == (0.2, 0.0)
    for _ in range(100):
        axis.step(-5.0)
        assert axis.position[0] >= -0.2
    assert (axis.position[0], axis.rate[0]) == (-0.2, 0.0)


def test_long_step_is_split_so_that_it_stays_stable() -> None:
    axis = Axis()
    for _ in range(50):
        axis.step(1.0, dt=0.05)
    assert axis.position[0] == pytest.approx(1.0, abs=1e-6)


def test_axes_do_not_touch_each_other() -> None:
    position, rate = np.zeros(3), np.zeros(3)
    n = np.ones(3)
    servo_step(position, rate, np.array([0.0, 1.0, 0.0]), 0 * n, KP * n, TAU * n, n, n, -n, n, 0.02)
    assert position[1] > 0.0
    np.testing.assert_array_equal(position[[0, 2]], 0.0)


@pytest.mark.parametrize("lags_s", [(0.008, 0.006), (0.004, 0.011), (0.005, 0.005)])
def test_two_devices_side_by_side_have_the_bits_of_each_alone(
    rng: np.random.Generator, lags_s: tuple[float, float]
) -> None:
    pair = [new(SERVO), new(SERVO)]
    for device, lag_s in zip(pair, lags_s, strict=True):
        device.kp, device.tau, device.rate_max, device.acceleration_max = KP, lag_s, 0.5, 0.6
        device.low, device.high = [-1.0, -1.0, -0.01], [1.0, 0.01, 1.0]
    alone = [device.copy() for device in pair]
    for _ in range(100):
        for one, other in zip(pair, alone, strict=True):
            one.setpoint = other.setpoint = rng.uniform(-0.02, 0.02, 3)
            one.feedforward = other.feedforward = rng.uniform(-0.1, 0.1, 3)
        servo_step_of_two(*pair, 0.02)
        for d in alone:
            limits = d.rate_max, d.acceleration_max, d.low, d.high
            servo_step(d.position, d.rate, d.setpoint, d.feedforward, d.kp, d.tau, *limits, 0.02)
    for one, other in zip(pair, alone, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.rate, other.rate)
        assert np.abs(one.rate).max() > 0.0
