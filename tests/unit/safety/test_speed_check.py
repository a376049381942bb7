"""Reported speed against the change of position: a second source for each axis."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from hil.core.messages import AxisFeedback
from hil.safety.packet_loss import SpeedCheck

STEP_S, MISMATCH_MAX = 0.02, 0.05
Rate = Callable[[float], float]


def found(moved: Rate, reported: Rate, jitter_s: float = 0.0, end_s: float = 3.0) -> tuple[float, int] | None:
    """Return time and axis of the mismatch of axis 1, None if there is none; positions by fine integration."""
    check, generator = SpeedCheck(MISMATCH_MAX), np.random.default_rng(1)
    t_s = position = 0.0
    for k in range(1, round(end_s / STEP_S)):
        next_s = k * STEP_S + jitter_s * generator.uniform(-1.0, 1.0)
        times = np.linspace(t_s, next_s, 21)
        position += float(np.mean([moved(0.5 * (a + b)) for a, b in pairwise(times)])) * (next_s - t_s)
        t_s = next_s
        feedback = AxisFeedback(t_s, np.array([0.0, position, 0.0]), np.array([0.0, reported(t_s), 0.0]))
        for _ in range(2):  # the newest sample may be read twice
            if mismatch := check.update(feedback):
                return t_s, mismatch[0]
    return None


def brisk(t_s: float) -> float:
    """Return a speed that changes at 0.6 m/s2 between -0.5 and 0.5 m/s."""
    return float(np.clip(0.6 * (abs(t_s % 3.0 - 1.5) - 0.75), -0.5, 0.5))


@pytest.mark.parametrize("jitter_s", [0.0, 0.004])
def test_an_axis_that_reports_its_speed_is_fine_however_it_moves(jitter_s: float) -> None:
    assert found(brisk, brisk, jitter_s) is None


@pytest.mark.parametrize(
    ("moved", "reported"),
    [
        pytest.param(lambda t_s: 0.2, lambda t_s: 0.0, id="reports a standstill"),
        pytest.param(lambda t_s: 0.0, lambda t_s: 0.2, id="reports a speed at rest"),
        pytest.param(lambda t_s: 0.2, lambda t_s: -0.2, id="reports the opposite"),
        pytest.param(lambda t_s: 0.5, lambda t_s: 0.35, id="reports less"),
    ],
)
def test_a_wrong_speed_is_found_within_0_3_s(moved: Rate, reported: Rate) -> None:
    mismatch = found(lambda t_s: moved(t_s) if t_s > 1.0 else 0.0, lambda t_s: reported(t_s) if t_s > 1.0 else 0.0)
    assert mismatch is not None
    assert mismatch[1] == 1
    assert 1.1 < mismatch[0] < 1.3


def test_a_single_wrong_sample_is_no_mismatch() -> None:
    assert found(lambda t_s: 0.1, lambda t_s: 0.4 if 1.0 < t_s < 1.015 else 0.1) is None
