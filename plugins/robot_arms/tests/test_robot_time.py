"""Bench time of a robot's cycles: delayed datagrams, pauses of the host, a clock that drifts or jumps."""

from __future__ import annotations

import numpy as np
import pytest

from hil_robot_arms.cycles import RobotTime

PERIOD_S = 0.004


@pytest.mark.parametrize("second_s", [1.0, 1.0001, 0.999, 1.15], ids=str)
def test_time_of_delayed_datagrams_follows_a_clock_that_drifts(second_s: float) -> None:
    time, draws = RobotTime(), np.random.default_rng(2)
    for number in range(5000):
        sent_s = second_s * PERIOD_S * number
        estimate_s = time.update(PERIOD_S * number, sent_s + 1e-4 + draws.exponential(3e-4))
        if number > 2000:
            assert -3e-4 < estimate_s - sent_s < 1e-3
    assert time.rate == pytest.approx(second_s, abs=2e-3)


def test_pause_of_the_host_does_not_turn_time_back() -> None:
    time, before_s, worst_s = RobotTime(), 0.0, 0.0
    for number in range(3000):
        sent_s = PERIOD_S * number
        arrived_s = max(sent_s, 4.08) if 4.0 < sent_s < 4.08 else sent_s  # 80 ms, then all at once
        estimate_s = time.update(sent_s, arrived_s + 1e-4)
        if number > 1:
            assert estimate_s - before_s > 0.5 * PERIOD_S
        before_s, worst_s = estimate_s, max(worst_s, abs(estimate_s - sent_s))
    assert worst_s < 0.08
    assert estimate_s == pytest.approx(sent_s, abs=5e-4)


def test_clock_that_has_stood_is_followed_again() -> None:
    time = RobotTime()
    for number in range(1000):
        sent_s = PERIOD_S * number + (0.06 if number > 500 else 0.0)
        estimate_s = time.update(PERIOD_S * number, sent_s)
    assert estimate_s == pytest.approx(sent_s, abs=2e-3)
    assert time.update(0.0, 100.0) == 100.0
