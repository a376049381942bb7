"""Times of exposure from a camera's own clock."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.drivers.cameras.camera_clock import CameraClock

PERIOD_S = 0.16
OFFSET_S = 1234.5  # bench time less camera time
DRIFT = 2e-5


def stamp(exposed_s: float) -> float:
    """Return the camera's time of an exposure at ``exposed_s`` of bench time."""
    return (exposed_s - OFFSET_S) * (1.0 + DRIFT)


def test_exposures_of_a_drifting_clock_are_found_from_software_triggers(rng: np.random.Generator) -> None:
    clock, triggers = CameraClock(0.0, triggered=True), []
    for k in range(200):
        triggers.append(k * PERIOD_S)
        exposed_s = triggers[-1] + 1e-4 + rng.exponential(2e-3)
        clock.add(stamp(exposed_s), exposed_s + 0.02 + rng.exponential(5e-3), triggers[-16:])
        found_s = clock.exposed_s(stamp(exposed_s))
        if k >= 20:
            assert found_s == pytest.approx(exposed_s, abs=1.2e-3)


def test_exposures_without_trigger_are_found_from_the_fastest_arrivals(rng: np.random.Generator) -> None:
    clock = CameraClock(0.02, triggered=False)
    for k in range(100):
        exposed_s = k * PERIOD_S
        clock.add(stamp(exposed_s), exposed_s + 0.02 + rng.exponential(5e-3))
    assert clock.exposed_s(stamp(exposed_s)) == pytest.approx(exposed_s, abs=1e-3)


def test_a_slow_first_frame_does_not_shift_the_times_by_a_period() -> None:
    clock, triggers = CameraClock(0.0, triggered=True), []
    for k in range(12):
        triggers.append(k * PERIOD_S)
        exposed_s = triggers[-1] + (0.09 if k == 0 else 2e-4)
        clock.add(stamp(exposed_s), exposed_s + 0.01, triggers)
    assert clock.exposed_s(stamp(exposed_s)) == pytest.approx(exposed_s, abs=1e-3)


def test_a_frame_that_arrives_after_the_next_trigger_is_not_taken_for_that_ones() -> None:
    clock, triggers = CameraClock(0.0, triggered=True), []
    for k in range(40):
        triggers.append(k * PERIOD_S)
        exposed_s = triggers[-1] + 2e-4
        late = k == 20
        if late:
            triggers.append((k + 1) * PERIOD_S)
        if k != 21:
            clock.add(stamp(exposed_s), exposed_s + (PERIOD_S + 0.01 if late else 0.01), triggers)
        if late:
            triggers.pop()
    assert clock.exposed_s(stamp(exposed_s)) == pytest.approx(exposed_s, abs=1e-3)
    assert clock.jumps == 0


def test_a_clock_that_jumps_is_followed_and_counted() -> None:
    clock = CameraClock(0.0, triggered=True)
    for k in range(30):
        t_s = k * PERIOD_S
        jumped = 7.0 if k >= 15 else 0.0
        clock.add(stamp(t_s) + jumped, t_s + 0.01, [t_s - PERIOD_S, t_s])
    assert clock.jumps == 1
    assert clock.exposed_s(stamp(t_s) + 7.0) == pytest.approx(t_s, abs=1e-3)


def test_no_time_is_given_before_the_clock_is_known() -> None:
    clock = CameraClock(0.0, triggered=True)
    clock.add(stamp(0.0), 0.01, [0.0])
    assert math.isnan(clock.exposed_s(stamp(0.0)))
