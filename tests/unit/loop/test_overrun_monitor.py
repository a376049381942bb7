"""Overrun policy: log, hold and safe stop; statistics of the lateness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import Rig
from hil.core.modes import Mode
from hil.errors import SafetyTrip
from hil.loop.overrun_monitor import OverrunMonitor, lateness_histogram, lateness_percentiles_us
from hil.loop.rate_keeper import Tick
from hil.report.limits import sentence
from hil.report.summary import summarise
from hil.session import build
from tests.support.run_settings import make_job


def late(now_s: float, skipped: int = 1) -> Tick:
    return Tick(now_s, 0.0, 0.0, skipped, 0.0451)


def test_burst_trips_and_names_lateness_and_limit() -> None:
    cycles = OverrunMonitor("safe_stop", 5, 1.0)
    cycles.check(late(10.0, 5))
    with pytest.raises(
        SafetyTrip,
        match=r"^loop: lost periods 6 \(last cycle ended 45\.1 ms .*\), allowed 5 in 1 s$",
    ):
        cycles.check(late(10.01))


def test_lost_tick_counts_as_its_part_of_a_cycle() -> None:
    ticks = OverrunMonitor("safe_stop", 5, 1.0, 20)
    ticks.check(late(10.0, 100))
    with pytest.raises(SafetyTrip):
        ticks.check(late(10.0))


def test_single_lost_periods_leak_away() -> None:
    cycles = OverrunMonitor("safe_stop", 5, 1.0)
    for k in range(1000):
        cycles.check(late(0.25 * k))
        cycles.check(Tick(0.25 * k + 0.02, 0.0, 0.0))


def test_more_than_the_bucket_leaks_trips_in_the_end() -> None:
    cycles = OverrunMonitor("hold", 5, 1.0)
    trips: list[SafetyTrip] = []
    cycles.on_hold = trips.append
    for k in range(200):
        cycles.check(late(0.1 * k))
    assert len(trips) == 1


def test_none_allowed_trips_at_the_first() -> None:
    with pytest.raises(SafetyTrip, match="allowed 0 in 1 s"):
        OverrunMonitor("safe_stop", 0, 1.0).check(late(0.02))


def test_log_never_trips() -> None:
    OverrunMonitor("log", 0, 1.0).check(late(1.0, 100))


def test_hold_without_anyone_who_holds_is_a_safe_stop() -> None:
    with pytest.raises(SafetyTrip):
        OverrunMonitor("hold", 0, 1.0).check(late(1.0))


def test_hold_is_asked_for_once_until_the_bucket_is_empty_again() -> None:
    cycles = OverrunMonitor("hold", 2, 1.0)
    asked: list[SafetyTrip] = []
    cycles.on_hold = asked.append
    for now_s in (1.0, 1.02, 1.04):
        cycles.check(late(now_s, 3))
    assert len(asked) == 1
    cycles.check(late(60.0, 3))
    assert len(asked) == 2


def test_margin_is_the_fullest_level_of_the_run_and_the_first_beyond_the_limit() -> None:
    cycles = OverrunMonitor("hold", 2, 1.0)
    cycles.on_hold = lambda _: None
    cycles.check(late(5.0, 2))
    cycles.restart()
    for now_s, skipped in ((100.0, 1), (102.0, 3), (102.02, 1), (110.0, 2)):
        cycles.check(Tick(now_s, 100.0, 0.0, skipped, 0.05))
    found = cycles.margin()
    assert found is not None
    assert (found["value"], found["at_s"]) == (pytest.approx(3.96), pytest.approx(2.02))
    assert (found["limit"], found["broken_s"], found["broken_value"]) == (2.0, 2.0, 3.0)
    assert OverrunMonitor("log", 2, 1.0).margin() is None


@pytest.mark.parametrize(("kind", "action"), [("hardware", "safe_stop"), ("emulated", "log")])
def test_hardware_stops_by_default(kind: str, action: str) -> None:
    emulated = load_rig("emulated").value
    rig = emulated.model_copy(update={"kind": kind})
    assert rig.on_overrun == action
    assert Rig.model_validate(rig.model_dump() | {"host": {"on_overrun": "hold"}}, strict=False).on_overrun == "hold"


def test_run_that_loses_too_many_periods_ends_as_a_safe_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    job = replace(make_job(2.0), compiled=False)
    with build.runner(job) as runner:
        runner.overrun_monitor = OverrunMonitor("safe_stop", 5, 1.0)
        rate = runner.rate
        wait = rate.wait

        def stumble() -> Tick:
            tick = wait()
            return late(tick.now_s, 6) if rate.executed == 50 else tick

        monkeypatch.setattr(rate, "wait", stumble)
        outcome = runner.run()
    assert outcome.stop.startswith("loop: lost periods 6")
    assert outcome.mode is Mode.SAFE_STOP
    assert len(outcome.history) < 50


@pytest.mark.parametrize("action", ["hold", "safe_stop"])
def test_late_cycles_are_named_as_the_first_violated_limit(monkeypatch: pytest.MonkeyPatch, action: str) -> None:
    job = replace(make_job(2.0), compiled=False)
    with build.runner(job) as runner:
        runner.overrun_monitor = OverrunMonitor(action, 5, 1.0)  # type: ignore[arg-type]
        runner.overrun_monitor.on_hold = lambda trip: runner.safety.request_hold(str(trip))
        runner.rate.paced = True
        wait = runner.rate.wait

        def stumble() -> Tick:
            tick = wait()
            skipped = {20: 2, 50: 6}.get(runner.rate.executed, 0)
            return replace(tick, skipped=skipped, overrun_s=0.045)

        monkeypatch.setattr(runner.rate, "wait", stumble)
        outcome = runner.run()
        found = summarise(outcome, job.scenario.value, job.rig.value, "mock", 0, 50.0)[0]
    assert (found["first_violated"], found["first_violated_limit"]) == ("lost_periods_of_loop", 5.0)
    assert found["first_violated_value"] == pytest.approx(6.0)
    assert found["first_violated_s"] == pytest.approx(0.97, abs=0.011)
    assert found["limits"]["lost_periods_of_loop"]["margin"] == pytest.approx(-1.0)
    assert found["limits"]["lost_packets_of_vmu"]["margin"] > 0.0
    assert sentence(found).startswith("the number of lost periods is 6, allowed 5, at 0.9")


def test_percentiles_are_in_microseconds_and_empty_is_zero() -> None:
    found = lateness_percentiles_us(np.arange(1001) * 1e-6)
    assert found == pytest.approx({"p50": 500.0, "p99": 990.0, "p999": 999.0, "max": 1000.0})
    assert set(lateness_percentiles_us(np.empty(0)).values()) == {0.0}


def test_histogram_counts_each_cycle_once_in_its_power_of_two() -> None:
    found = lateness_histogram(np.array([0.0, 0.9, 1.0, 3.0, 4.0, 70_000.0]) * 1e-6)
    counts = {entry["below_us"]: entry["cycles"] for entry in found if entry["cycles"]}
    assert counts == {1: 2, 2: 1, 4: 1, 8: 1, None: 1}
    assert sum(entry["cycles"] or 0 for entry in lateness_histogram(np.empty(0))) == 0
