"""A bench that runs free with its GNC behind a bad network: counted, coasted, held or stopped, and never a jump."""

from __future__ import annotations

import math
import threading

import numpy as np
import pytest

from hil.core.messages import MAX_THRUSTERS
from hil.core.modes import Mode
from hil.core.operator_commands import AutoResumeOperator
from tests.support.split_bench import Split, gnc_thread, split_bench
from tests.support.udp_relay import Relay

pytestmark = pytest.mark.wires

STEP_S = 0.02
PATIENT = ("rig.gnc_link.timeout_cycles=500",)
"""On a busy computer a cycle's answer may be late by more than a network makes it."""
RAIL_LIMIT, GIMBAL_LIMIT = 0.6, math.radians(80.0)  # of the mock rig, m/s^2 and rad/s^2
SMOOTH_MPS2, SMOOTH_RADPS2 = 0.1, 0.1  # five times what the thrusters make of the chaser


def assert_smooth(bench: Split) -> None:
    """No setpoint was sent that the thrusters alone would not have made."""
    rails, gimbals = bench.largest_jerks()
    assert rails < SMOOTH_MPS2
    assert gimbals < SMOOTH_RADPS2


def at_cycle(bench: Split, events: dict[int, object]) -> None:
    """Let each of ``events`` (callables) happen after the cycle that is its key."""

    def look(cycle: int) -> None:
        happens = events.get(cycle)
        if happens is not None:
            happens()  # type: ignore[operator]

    bench.each_cycle = look


def test_loss_delay_reorder_and_duplicates_are_counted_and_flown_through() -> None:
    with (
        split_bench("scheme-1", 3.0, PATIENT, lock_step=False) as bench,
        Relay(bench.link.address, loss=0.06, delay_s=0.005, jitter_s=0.03, duplicate=0.05) as relay,
        gnc_thread("scheme-1", relay.address) as gnc,
    ):
        outcome = bench.fly()
    account = bench.account()
    assert outcome.faults == []
    assert len(outcome.history) == 151
    assert account["lost"] > 0
    assert account["reordered"] > 0
    assert account["duplicates"] > 0
    assert relay.lost > 0
    assert gnc.stats.bridged > 0
    assert account["coasted_cycles"] > 0
    assert account["delay_cycles_max"] >= 1
    assert account["round_trip_us"]["p50"] > 10_000.0
    assert_smooth(bench)


def test_partition_stops_the_bench_within_the_cycles_that_are_configured() -> None:
    settings = ("rig.gnc_link.timeout_cycles=20", "rig.gnc_link.coast_cycles=2")
    with (
        split_bench("scheme-1", 5.0, settings, lock_step=False) as bench,
        Relay(bench.link.address) as relay,
        gnc_thread("scheme-1", relay.address, patience_s=3.0),
    ):
        cut_at: list[int] = []

        def cut_in_a_burn(cycle: int) -> None:
            assert bench.loop is not None
            if cycle >= 40 and not cut_at and np.abs(bench.loop.now.command.cycles_left).max() > 3:
                cut_at.append(cycle)
                relay.cut()
            elif not cut_at:
                bench.link.wait(10.0)  # for the reply: a busy computer is no partition

        bench.each_cycle = cut_in_a_burn
        outcome = bench.fly()
        relay.mend()
    assert outcome.mode is Mode.SAFE_STOP
    assert outcome.stop.startswith("gnc: test gnc at 127.0.0.1:")
    assert outcome.stop.partition(" (the host paused")[0].endswith("has not answered for 20 cycles")
    assert cut_at[0] + 20 <= len(outcome.history) <= cut_at[0] + 22
    on = outcome.history["command"]["on"].any(axis=1)
    assert on[cut_at[0] : cut_at[0] + 3].all()  # the last command stands for two cycles ...
    assert not on[-17:].any()  # ... then all thrusters are closed
    assert not outcome.history["navigation"]["valid"][-17:].any()
    assert bench.account()["losses"] == 1
    assert_smooth(bench)


@pytest.mark.slow
def test_run_held_during_a_partition_resumes_without_a_step() -> None:
    settings = ("rig.gnc_link.timeout_cycles=20", 'rig.gnc_link.on_loss="hold"')
    with (
        split_bench("scheme-1", 4.0, settings, lock_step=False, operator=AutoResumeOperator()) as bench,
        Relay(bench.link.address) as relay,
        gnc_thread("scheme-1", relay.address) as gnc,
    ):
        at_cycle(bench, {60: relay.cut, 79: lambda: threading.Timer(2.0, relay.mend).start()})
        outcome = bench.fly()
    assert outcome.faults == []
    assert len(outcome.history) == 201
    texts = [event.text for event in outcome.events]
    assert any(text.startswith("hold: test gnc at 127.0.0.1:") for text in texts)
    assert any(text.startswith("resumed after 2.") for text in texts)
    assert gnc.stats.setups == 1
    assert gnc.stats.bridged >= 15
    assert outcome.history["navigation"]["valid"][-50:].all()
    rails, gimbals = bench.largest_jerks()
    assert rails < RAIL_LIMIT * 1.001
    assert gimbals < GIMBAL_LIMIT * 1.001


@pytest.mark.slow
def test_coasting_through_a_partition_closes_the_thrusters_and_restarts_the_filters() -> None:
    with (
        split_bench("scheme-1", 8.0, ("rig.gnc_link.timeout_cycles=200",), lock_step=False) as bench,
        Relay(bench.link.address) as relay,
        gnc_thread("scheme-1", relay.address) as gnc,
    ):
        at_cycle(bench, {100: relay.cut, 200: relay.mend})
        outcome = bench.fly()
    assert outcome.faults == []
    assert len(outcome.history) == 401
    assert gnc.stats.restarts == 1
    assert bench.account()["closed_cycles"] >= 95
    assert not outcome.history["command"]["on"][110:195, :MAX_THRUSTERS].any()
    assert outcome.history["navigation"]["valid"][-50:].all()
    assert_smooth(bench)
