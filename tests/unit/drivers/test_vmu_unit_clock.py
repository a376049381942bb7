"""Estimate of the vision unit's clock from the ages of its frames."""

from __future__ import annotations

import numpy as np
import pytest

from hil.drivers.vmu.unit_clock import WINDOW, UnitClock

TRANSMISSION_S, PERIOD_S = 0.024, 0.16


def estimate(ahead_s: float = 0.0, drift: float = 0.0, frames: int = 8 * WINDOW) -> dict[str, int]:
    """Return the numbers of a unit whose clock is ahead by ``ahead_s`` and gains ``drift``; delays are exponential."""
    delays = TRANSMISSION_S + np.random.default_rng(1).exponential(0.004, frames)
    clock = UnitClock(TRANSMISSION_S)
    for k, delay_s in enumerate(delays):
        t_s = k * PERIOD_S
        clock.add(delay_s - ahead_s - drift * t_s, t_s + delay_s)
    return clock.numbers()


@pytest.mark.parametrize("ahead_s", [0.002, 0.0, 0.4])
def test_a_clock_that_is_ahead_by_milliseconds_is_measured(ahead_s: float) -> None:
    found = estimate(ahead_s)["clock_ahead_us"]
    assert 1e6 * ahead_s - 400 < found <= 1e6 * ahead_s + 1  # never more than it is


def test_a_clock_that_is_behind_is_never_taken_for_one_ahead() -> None:
    assert estimate(-0.003)["clock_ahead_us"] == pytest.approx(-3000, abs=400)


def test_drift_is_measured_whatever_the_offset() -> None:
    assert estimate(0.1, 20e-6)["clock_drift_ppb"] == pytest.approx(20_000, abs=6000)
    assert abs(estimate(0.1)["clock_drift_ppb"]) < 6000


def test_step_far_below_the_rejection_of_frames_is_reported() -> None:
    clock = UnitClock(TRANSMISSION_S)
    for k in range(4 * WINDOW):
        clock.add(TRANSMISSION_S - (0.005 if k >= 2 * WINDOW else 0.0), k * PERIOD_S)
    assert clock.numbers()["clock_step_us"] == pytest.approx(5000, abs=1)


def test_the_first_frames_already_give_an_offset() -> None:
    assert UnitClock(TRANSMISSION_S).numbers()["clock_ahead_us"] == 0
    assert estimate(0.002, frames=10)["clock_ahead_us"] == pytest.approx(2000, abs=1500)
