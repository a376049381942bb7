"""The rate of the loop on a made-up monotonic clock, so that the machine's own delays do not matter."""

from __future__ import annotations

from itertools import zip_longest

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.clock import SimulatedClock, WallClock
from hil.loop import rate_keeper as rate_module
from hil.loop.rate_keeper import SimulatedRate, WallClockRate

STEP_S = 0.02
MS = 1_000_000
STEP_MS = 20 * MS


class FakeTime:
    """A monotonic clock that moves on by 1 us at each look and by what is slept."""

    def __init__(self) -> None:
        self.ns = 5_000 * MS
        self.slept_ns: list[int] = []
        self.oversleeps_ns = 0

    def monotonic_ns(self) -> int:
        self.ns += 1_000
        return self.ns

    def sleep(self, seconds: float) -> None:
        self.slept_ns.append(round(seconds * 1e9))
        self.ns += self.slept_ns[-1] + self.oversleeps_ns

    def wait_until(self, deadline_ns: int, spin_ns: int, _: np.ndarray) -> int:
        left_ns = deadline_ns - spin_ns - self.monotonic_ns()
        if left_ns > 0:
            self.sleep(left_ns * 1e-9)
        while (now_ns := self.monotonic_ns()) < deadline_ns:
            pass
        return now_ns


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    """Put a made-up clock in the place of the machine's."""
    fake = FakeTime()
    monkeypatch.setattr(rate_module, "time", fake)
    monkeypatch.setattr(rate_module, "wait_until", fake.wait_until)
    return fake


def wall_rate(fake: FakeTime, speed: float = 1.0) -> WallClockRate:
    return WallClockRate(WallClock(epoch_ns=fake.ns, speed=speed), STEP_S)


def test_cycles_come_at_absolute_deadlines_that_do_not_drift(fake: FakeTime) -> None:
    rate = wall_rate(fake)
    first = rate.wait()
    for k in range(1, 200):
        fake.ns += (k % 15) * MS  # work of changing length, always shorter than the period
        tick = rate.wait()
        assert tick.now_s - first.now_s == pytest.approx(k * STEP_S, abs=5e-6)
        assert 0.0 <= tick.lateness_s < 5e-6
    assert rate.overruns == rate.skipped_periods == 0


def test_a_late_wake_up_is_a_pause_of_the_host_for_a_second(fake: FakeTime) -> None:
    rate = wall_rate(fake)
    fake.ns += 5 * STEP_MS  # a long cycle is none
    rate.wait()
    assert rate.pause_s == 0.0
    fake.oversleeps_ns = 31 * MS
    rate.wait()
    fake.oversleeps_ns = 7 * MS
    rate.wait()
    assert rate.pause_s == pytest.approx(0.031, abs=0.001)
    fake.ns += 1000 * MS
    assert rate.pause_s == 0.0


def test_first_cycle_is_one_period_after_the_restart_and_is_the_runs_zero(fake: FakeTime) -> None:
    opened_ns = fake.ns
    rate = wall_rate(fake)
    tick = rate.wait()
    assert tick.now_s == pytest.approx(STEP_S, abs=5e-6)
    assert tick.run_zero_s == pytest.approx(STEP_S, abs=5e-6)
    fake.ns += 300 * MS
    restarted_s = (fake.ns - opened_ns) * 1e-9
    rate.restart()
    assert rate.wait().run_zero_s == pytest.approx(restarted_s + STEP_S, abs=5e-6)
    assert rate.overruns == 0


def test_late_cycle_is_counted_and_not_made_up(fake: FakeTime) -> None:
    rate = wall_rate(fake)
    before = rate.wait()
    fake.ns += 50 * MS  # two deadlines pass
    late = rate.wait()
    assert (rate.overruns, rate.skipped_periods) == (1, 2)
    assert late.now_s - before.now_s == pytest.approx(3 * STEP_S, abs=5e-6)
    # the next cycle comes a whole period later: nothing is caught up
    assert rate.wait().now_s - late.now_s == pytest.approx(STEP_S, abs=5e-6)
    assert rate.overruns == 1


def test_time_of_the_run_lags_by_the_skipped_periods(fake: FakeTime) -> None:
    rate = wall_rate(fake)
    rate.wait()
    fake.ns += 50 * MS
    for cycle in range(1, 4):
        tick = rate.wait()
        assert tick.now_s - tick.run_zero_s == pytest.approx(cycle * STEP_S, abs=5e-6)


def test_cycle_that_ends_just_before_its_deadline_is_no_overrun(fake: FakeTime) -> None:
    rate = wall_rate(fake)
    rate.wait()
    fake.ns += 19_990_000
    assert rate.wait().lateness_s < 5e-6
    assert rate.overruns == 0


def test_wait_sleeps_and_spins_only_for_the_last_part(fake: FakeTime) -> None:
    rate = wall_rate(fake)
    rate.wait()
    assert fake.slept_ns == [pytest.approx(20 * MS - 200_000, abs=10_000)]


def test_faster_clock_shortens_the_real_time_period_and_keeps_bench_time(fake: FakeTime) -> None:
    rate = wall_rate(fake, speed=10.0)
    first, wall_ns = rate.wait(), fake.ns
    for _ in range(10):
        tick = rate.wait()
    assert tick.now_s - first.now_s == pytest.approx(10 * STEP_S, abs=5e-5)
    assert fake.ns - wall_ns == pytest.approx(20 * MS, abs=10_000)


def test_simulated_cycle_k_is_exactly_at_k_steps() -> None:
    clock = SimulatedClock(3.0)
    rate = SimulatedRate(clock, STEP_S)
    for k in range(1000):
        tick = rate.wait()
        assert tick.now_s == 3.0 + k * STEP_S == clock.t_s
        assert (tick.run_zero_s, tick.lateness_s) == (3.0, 0.0)
    rate.restart()
    assert rate.wait().run_zero_s == clock.t_s
    assert rate.overruns == 0


@given(st.lists(st.integers(0, 3 * 20 * MS), max_size=60), st.lists(st.integers(0, 50 * MS), max_size=60))
def test_executed_and_skipped_periods_are_all_that_elapsed(work_ns: list[int], oversleep_ns: list[int]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        fake = FakeTime()
        patch.setattr(rate_module, "time", fake)
        rate = wall_rate(fake)
        zero_ns = fake.ns
        skipped = overruns = 0
        for work, oversleep in zip_longest(work_ns, oversleep_ns, fillvalue=0):
            fake.oversleeps_ns = oversleep
            tick = rate.wait()
            skipped += tick.skipped
            overruns += tick.skipped > 0
            assert (tick.overrun_s > 0.0) == (tick.skipped > 0)
            deadline_ns = fake.ns - tick.lateness_s * 1e9
            assert rate.executed + rate.skipped_periods == round((deadline_ns - zero_ns) / (20 * MS))
            # the time of the run is that of the cycles that were executed
            assert tick.now_s - tick.run_zero_s - tick.lateness_s == pytest.approx((rate.executed - 1) * STEP_S)
            fake.ns += work
        assert (rate.skipped_periods, rate.overruns) == (skipped, overruns)


def test_restart_begins_a_new_count(fake: FakeTime) -> None:
    rate = wall_rate(fake)
    rate.wait()
    fake.ns += 100 * MS
    rate.wait()
    assert rate.overruns == 1
    rate.restart()
    assert (rate.executed, rate.overruns, rate.skipped_periods) == (0, 0, 0)


def test_wait_never_spins_through_a_whole_period(fake: FakeTime) -> None:
    rate = WallClockRate(WallClock(epoch_ns=fake.ns), 0.0002)
    rate.wait()
    assert fake.slept_ns == [pytest.approx(100_000, abs=5_000)]
