"""Course of the axes within a cycle: interpolated between its begin and its end."""

from __future__ import annotations

import numpy as np
import pytest

from hil.bench.kinematics import SPAN, extend_span, within_span
from hil.core.messages import AXES, new

CYCLE_S = 0.02


def axes_at(t_s: float) -> np.record:
    """Return axes on cubic courses, different for each axis, at ``t_s``."""
    axes, powers = new(AXES), t_s ** np.arange(4)
    slopes = np.arange(4) * t_s ** np.maximum(np.arange(4) - 1, 0)
    for i in range(3):
        k = np.array([0.3, -0.2, 1.5, -20.0]) * (1 + i)
        axes.rail_m[i], axes.rail_mps[i] = k @ powers, k @ slopes
        axes.gimbal_rad[i], axes.gimbal_radps[i] = -k @ powers, -k @ slopes
    return axes


@pytest.fixture
def span() -> np.record:
    """Return the span of the second cycle of a motion."""
    span = new(SPAN)
    extend_span(span, axes_at(CYCLE_S), CYCLE_S)
    extend_span(span, axes_at(2.0 * CYCLE_S), CYCLE_S)
    return span


@pytest.mark.parametrize("fraction", [0.05, 0.5, 0.95])
def test_cubic_course_is_interpolated_exactly(span: np.record, fraction: float) -> None:
    out = new(AXES)
    within_span(span, CYCLE_S, fraction, out)
    expected = axes_at((1.0 + fraction) * CYCLE_S)
    for name in AXES.names or ():
        np.testing.assert_allclose(out[name], expected[name], rtol=0.0, atol=1e-14)


def test_end_of_the_cycle_has_the_bits_of_the_target(span: np.record) -> None:
    out = new(AXES)
    within_span(span, CYCLE_S, 1.0, out)
    assert out.tobytes() == axes_at(2.0 * CYCLE_S).tobytes()


def test_first_cycle_begins_where_the_target_comes_from() -> None:
    span, target, out = new(SPAN), axes_at(0.5), new(AXES)
    extend_span(span, target, CYCLE_S)
    within_span(span, CYCLE_S, 0.25, out)
    np.testing.assert_allclose(out.rail_m, target.rail_m - 0.75 * CYCLE_S * target.rail_mps, rtol=0.0, atol=1e-4)
    assert span.known == 1
