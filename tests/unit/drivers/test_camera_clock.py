"""Times of exposure from a camera's own clock."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.drivers.cameras.camera_clock import CameraClock
from hil.drivers.cameras.pairing import Pairing, TimedFrame

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


def transit_s(rng: np.random.Generator) -> float:
    """Return the time of one image from its exposure to its arrival: read-out, and a network that is not alone."""
    return 0.018 + rng.exponential(3e-3)


@pytest.mark.parametrize("rate_hz", [6.25, 20.0, 30.0])
@pytest.mark.parametrize("seed", range(5))
def test_two_cameras_without_stamps_make_pairs_with_times_of_exposure(rate_hz: float, seed: int) -> None:
    """Software triggers: the times are those of the triggers; a frame that is not certain is left out."""
    rng, pairing = np.random.default_rng(seed), Pairing(0.005, 0.05, rate_hz)
    clocks = [CameraClock(0.0, triggered=True) for _ in range(2)]
    arrivals: list[tuple[float, int, int]] = []
    triggers: tuple[list[float], list[float]] = ([], [])
    true_s: list[list[float]] = [[], []]
    for k in range(600):
        for side in range(2):
            triggers[side].append(k / rate_hz + rng.exponential(2e-4))
            true_s[side].append(triggers[side][-1] + 1e-4 + rng.exponential(5e-4))
            arrivals.append((true_s[side][-1] + transit_s(rng), side, k))
    errors_s = []
    for arrived_s, side, k in sorted(arrivals):
        recent = [t_s for t_s in triggers[side][max(0, k - 3) : k + 4] if t_s <= arrived_s]
        exposed_s = clocks[side].unstamped_s(arrived_s, recent)
        if math.isfinite(exposed_s):
            errors_s.append(exposed_s - true_s[side][k])
            pairing.put(side, TimedFrame(exposed_s, arrived_s, k + 1, None))
        for _ in pairing.pairs(arrived_s):
            pass
    assert np.abs(errors_s).max() < 5e-3
    assert pairing.counters["pairs"] > 0.93 * 600
    assert pairing.counters["odd_numbers"] == 0


def test_frame_without_stamp_and_trigger_is_as_old_as_by_the_rig_file(rng: np.random.Generator) -> None:
    clock, errors_s = CameraClock(0.02, triggered=False), []
    for k in range(1000):
        exposed_s = k * PERIOD_S
        errors_s.append(clock.unstamped_s(exposed_s + 0.02 + rng.exponential(1e-3)) - exposed_s)
    assert np.percentile(errors_s, 99) < 5e-3
