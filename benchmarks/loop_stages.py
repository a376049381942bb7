"""Time of each call of the core in whole runs, in nanoseconds per cycle.

    python benchmarks/loop_stages.py [--scheme scheme-1] [--set KEY=VALUE ...]

The cycles of ``hil.loop.compiled.run_cycles`` with the processor's time stamp read between the calls: the flight is a
real one, whose rows are compared with those of the compiled shell, and the rows add up to its cycle. What the time
stamps themselves cost is the difference to a run without them. One run on one machine: compare the rows.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from hil.bench import guard as guards
from hil.config.load import load_rig, load_scenario
from hil.core.jit import kernel
from hil.core.messages import CYCLE
from hil.loop import core, mock_bench
from hil.loop.compiled import run_cycles as shell
from hil.loop.compiled.run_stats import count_cycle
from hil.models.camera_timing import TIME_SLACK_S
from hil.parts.campaigns.case_runner import CaseRunner
from hil.sensors.vision_unit.transit import forget_frames

ROWS = (
    "axes of the mock rig, encoders", "safety checks of the bench", "vision unit", "poses to the cycle",
    "GNC, cycles without a pose", "GNC, cycles with a pose", "lines, consistency, row", "statistics",
    "truth, IMU, axes", "setpoints",
)  # fmt: skip
READ, CHECK, EXPOSE, RECEIVE, PREDICT, FUSE, COMMAND, COUNT, ADVANCE, SEND = range(len(ROWS))
FLIGHTS = 15
HISTORY = 13  # number of the argument of ``run_cycles``


@intrinsic
def time_stamp(_typing: Any) -> Any:
    """Return the processor's time stamp."""

    def generate(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        read = builder.module.declare_intrinsic("llvm.readcyclecounter", (), ir.FunctionType(ir.IntType(64), ()))
        return builder.call(read, ())

    return types.int64(), generate


@kernel
def since(at, row, spent):
    """Add the time since ``at`` to ``spent[row]``; return the time."""
    now = time_stamp()
    spent[row] += now - at
    return now


@kernel
def timed_cycles(
    params, field, leds, imu_noise, vision_noise, travel_draws, state, samples, memory, poses, frames, delayed, stats,
    history, arrivals, spent,
):  # fmt: skip
    """Run the cycles of one setpoint each, without faults and further sensors, as ``run_cycles`` does."""
    transit, now = state.mock.transit, state.now
    shell._open(params, state)
    first = transit.next_exposure
    at = time_stamp()
    while state.cycle < state.end:
        k = state.cycle
        now_s = t_s = k * params.step_s
        mock_bench.read_axes(state, now_s)
        at = since(at, READ, spent)
        broken = core.check_axes(params, state) + core.guard_bench(params, state, now_s)
        at = since(at, CHECK, spent)
        if broken != guards.NOTHING:
            return broken
        mock_bench.expose(params, state, now_s + TIME_SLACK_S, first, vision_noise, travel_draws, leds, frames, stats)
        at = since(at, EXPOSE, spent)
        n = mock_bench.receive_frames(params, state, now_s, frames)
        arrived = core.receive_poses(params, state, now_s, frames, n, delayed, poses, arrivals)
        forget_frames(transit, n, frames)
        at = since(at, RECEIVE, spent)
        if not shell._run_gnc(params, state, memory, samples, poses, arrived, t_s):
            return shell.GNC_FAILED
        at = since(at, FUSE if arrived > 0 else PREDICT, spent)
        mock_bench.mirror_thrusters(params, state, now_s)
        core.isolate_thrusters(params, state)
        core.check_consistency(params, state)
        now.t_s, now.commanded_s = t_s, now_s
        at = since(at, COMMAND, spent)
        count_cycle(params.stats, stats, now)
        at = since(at, COUNT, spent)
        history[k] = now
        row = k * samples.shape[0]
        at = since(at, COMMAND, spent)
        core.advance(params, state, field, imu_noise[row : row + samples.shape[0]], samples)
        at = since(at, ADVANCE, spent)
        if not shell._send_setpoint(params, state, now_s):
            return shell.NOT_FINITE
        core.next_tick(params, state)
        state.cycle = k + 1
        at = since(at, SEND, spent)
    return shell.COMPLETED


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scheme", default="scheme-1")
    parser.add_argument("--set", action="append", default=[])
    options = parser.parse_args()
    scenario = load_scenario(options.scheme, options.set).value
    flight = CaseRunner(scenario, load_rig("mock", options.set).value, scenario.duration_s)
    history = np.zeros(flight.cycles, CYCLE)
    flight.run(scenario, 0, history)
    timed_history, best, plain_s = np.zeros_like(history), np.full(len(ROWS), np.inf), np.inf
    for _ in range(FLIGHTS):
        arguments = flight.prepared(scenario, 0)
        flight._params.counts = 1
        begun = time.thread_time()
        shell.run_cycles(*arguments[:HISTORY], history, *arguments[HISTORY + 1 :])
        plain_s = min(plain_s, time.thread_time() - begun)
        arguments = flight.prepared(scenario, 0)
        flight._params.counts = 1
        spent = np.zeros(len(ROWS), np.int64)
        stamped, begun = time_stamp_now(), time.perf_counter()
        code = timed_cycles(*arguments[:HISTORY], timed_history, arguments[HISTORY + 1], spent)
        ns_per_tick = (time.perf_counter() - begun) * 1e9 / (time_stamp_now() - stamped)
        assert code == shell.COMPLETED
        best = np.minimum(best, spent * ns_per_tick / flight.cycles)
    assert timed_history["truth"].tobytes() == history["truth"].tobytes(), "another flight than that of the shell"
    for name, ns in zip(ROWS, best, strict=True):
        print(f"  {name:34s} {ns:8.0f} ns")
    plain_ns = plain_s / flight.cycles * 1e9
    print(f"  {'sum of the calls':34s} {best.sum():8.0f} ns")
    print(f"  {'a cycle without time stamps':34s} {plain_ns:8.0f} ns  ({scenario.step_s / plain_ns * 1e9:.0f} x)")
    print(f"  {int(np.sum(history['pose']['fresh'] > 0))} of {flight.cycles} cycles fuse a pose")


@kernel
def time_stamp_now():
    """Return the time stamp, for Python."""
    return time_stamp()


if __name__ == "__main__":
    main()
