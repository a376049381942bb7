"""Moves of the bench with late cycles: the move is delayed, no axis is sent faster than its move."""

from __future__ import annotations

import numpy as np
import pytest

from hil.core import alarm_table as table
from hil.core.clock import SimulatedClock
from hil.core.messages import AXES, new
from hil.errors import BenchError, LinkLost
from hil.loop.bench_stage import Move
from hil.loop.rate_keeper import SimulatedRate, Tick
from hil.loop.session_parts import SessionParts
from hil.session.build import in_memory
from tests.support.run_settings import make_job

LATE_CYCLE, LATE_S = 200, 0.1


class LateRate(SimulatedRate):
    """One cycle is late by ``LATE_S``."""

    pause_s = 0.0

    def wait(self) -> Tick:
        if self.executed == LATE_CYCLE:
            self._zero_s += LATE_S
        return super().wait()


def test_a_late_cycle_delays_a_move_and_does_not_hasten_it() -> None:
    job = make_job(2.0)
    runner = in_memory(job, LateRate(SimulatedClock(), job.scenario.value.step_s))
    bench, sent = runner.loop.bench, list[np.ndarray]()
    send = bench._send

    def record(now_s: float) -> None:
        send(now_s)
        sent.append(np.concatenate([bench.accepted.rail_m, bench.accepted.gimbal_rad]))

    bench._send = record  # type: ignore[method-assign]
    with runner.axes_only() as sequencer:
        target = new(AXES)
        target.rail_m, target.gimbal_rad = runner.loop.now.feedback.rail_m, 0.0
        target.rail_m[0] = 0.5
        sequencer.tick()
        sequencer.park(target)
    speeds = np.diff(sent, axis=0)[:, 0] / bench.params.dt_s
    limit = bench.safety.limits.parking_rate_fraction * bench.params.rate_max[0]
    assert len(sent) > LATE_CYCLE + 50
    assert np.abs(speeds).max() < limit * (1.0 + 1e-9)
    assert np.abs(speeds).max() > 0.99 * limit
    assert np.abs(np.diff(speeds)).max() <= Move.FRACTION_OF_LIMITS * bench.params.acceleration_max[0] * 0.02 * 1.001


@pytest.mark.parametrize(
    "fault",
    [
        LinkLost("rails", "stopped: the loop has been silent for 0.052 s"),
        table.SAFETY_CHAIN.trip("io", "open", "closed"),
        table.AGE_OF_SETPOINT.trip("bench", 0.52, 0.5),
    ],
)
def test_fault_that_a_pause_of_the_host_can_cause_names_the_pause(fault: BenchError) -> None:
    job = make_job(2.0)
    rate = LateRate(SimulatedClock(), job.scenario.value.step_s)
    rate.pause_s = 0.051
    runner = in_memory(job, rate)

    def fail(now_s: float) -> None:
        raise fault

    runner.loop.bench.rails.read = fail  # type: ignore[method-assign, assignment]
    outcome = runner.run()
    text = f"{fault} (the host paused the loop for 51 ms: end other programs, check with hil preflight)"
    assert outcome.stop == text
    assert [alarm.text for alarm in outcome.alarms] == [text]


@pytest.mark.parametrize(("process_s", "loop_s", "named"), [(0.08, 0.051, "the watchdog process"), (0.0, 0.02, "")])
def test_longest_pause_of_the_processes_is_named_and_a_short_one_is_not(
    process_s: float, loop_s: float, named: str
) -> None:
    job, fault = make_job(2.0), table.SAFETY_CHAIN.trip("io", "open", "closed")
    rate = LateRate(SimulatedClock(), job.scenario.value.step_s)
    rate.pause_s = loop_s
    runner = in_memory(job, rate, SessionParts(process_pauses=lambda: {"the watchdog process": process_s}))

    def fail(now_s: float) -> None:
        raise fault

    runner.loop.bench.rails.read = fail  # type: ignore[method-assign, assignment]
    assert (
        runner.run().stop.removeprefix(str(fault)).startswith(f" (the host paused {named} for 80 ms" if named else "")
    )
    assert ("paused" in runner.safety.alarms.all()[0].text) == bool(named)
