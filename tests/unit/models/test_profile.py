"""Speed profiles from rest to rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.models.profile import along_line, duration

lengths = st.floats(1e-4, 100.0)
speeds = st.floats(1e-3, 10.0)
accelerations = st.floats(1e-3, 10.0)


def at(length: float, speed: float, up: float, down: float, t_s: float) -> np.ndarray:
    out = np.empty(3)
    along_line(length, speed, up, down, t_s, out)
    return out


def test_trapezoid_has_the_textbook_corners() -> None:
    # 0.5 m up at 1 m/s^2, 1 m down at 0.5 m/s^2, 8.5 m at 1 m/s
    np.testing.assert_allclose(at(10.0, 1.0, 1.0, 0.5, 1.0), [0.5, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(at(10.0, 1.0, 1.0, 0.5, 5.0), [4.5, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(at(10.0, 1.0, 1.0, 0.5, 10.5), [9.75, 0.5, -0.5], atol=1e-15)
    assert duration(10.0, 1.0, 1.0, 0.5) == pytest.approx(11.5)


def test_short_line_has_a_triangle_with_a_lower_peak() -> None:
    assert duration(1.0, 100.0, 1.0, 1.0) == pytest.approx(2.0)
    np.testing.assert_allclose(at(1.0, 100.0, 1.0, 1.0, 1.0)[:2], [0.5, 1.0], atol=1e-12)


@given(lengths, speeds, accelerations, accelerations)
def test_line_ends_at_rest_at_its_length_after_its_duration(
    length: float, speed: float, up: float, down: float
) -> None:
    end = duration(length, speed, up, down)
    np.testing.assert_allclose(at(length, speed, up, down, 0.0), 0.0)
    np.testing.assert_allclose(at(length, speed, up, down, end * (1 + 1e-9)), [length, 0.0, 0.0], rtol=1e-12)
    almost = at(length, speed, up, down, end * (1 - 1e-9))
    assert almost[0] == pytest.approx(length, rel=1e-6)
    assert almost[1] == pytest.approx(0.0, abs=1e-6 * speed + 1e-6 * down * end)


@given(lengths, speeds, accelerations, accelerations, st.floats(0.0, 1.2))
def test_speed_and_acceleration_stay_within_their_limits(
    length: float, speed: float, up: float, down: float, part: float
) -> None:
    path, rate, second = at(length, speed, up, down, part * duration(length, speed, up, down))
    assert 0.0 <= path <= length * (1.0 + 1e-12)
    assert 0.0 <= rate <= speed * (1.0 + 1e-12)
    assert second in (0.0, up, -down)


@given(lengths, speeds, accelerations, accelerations, st.floats(0.01, 0.99))
def test_rate_is_the_derivative_of_the_path(length: float, speed: float, up: float, down: float, part: float) -> None:
    whole = duration(length, speed, up, down)
    t, h = part * whole, 1e-5 * whole
    slope = (at(length, speed, up, down, t + h)[0] - at(length, speed, up, down, t - h)[0]) / (2.0 * h)
    # a corner inside +-h moves the slope by at most the acceleration times h
    assert slope == pytest.approx(at(length, speed, up, down, t)[1], abs=(up + down) * h + 1e-9 * length / h)


def test_line_of_zero_length_has_no_motion() -> None:
    assert duration(0.0, 1.0, 1.0, 1.0) == 0.0
    np.testing.assert_array_equal(at(0.0, 1.0, 1.0, 1.0, 3.0), 0.0)
