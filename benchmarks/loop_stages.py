"""Cost of each stage of the compiled loop, in nanoseconds of processor time per cycle.

    python benchmarks/loop_stages.py [--scheme scheme-1]

Each stage is run repeatedly on the records of a run in its middle, as the loop calls it; the cost of a pose is
distributed over the cycles between two exposures. One run on one machine: compare the rows with each other.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from hil.bench import guard as guards
from hil.config.load import load_rig, load_scenario
from hil.core.jit import kernel
from hil.core.messages import ARRIVAL
from hil.dynamics import imu as imu_kernels
from hil.dynamics import truth as truth_kernels
from hil.gnc import navigation, step
from hil.loop.compiled import loop_kernel as loop
from hil.loop.compiled.run_stats import count_cycle
from hil.maths import stack
from hil.monte_carlo.case_runner import CaseRunner
from hil.params import dynamics as dynamics_params

REPEATS, TIMES, FLIGHTS = 100, 1_000, 30  # short ones: some are undisturbed


@kernel
def read_axes(params, state, n):
    """Run the stage ``n`` times, as all below."""
    for _ in range(n):
        loop._read_axes(state, state.rails.t_s + params.step_s)


@kernel
def supervise_bench(params, state, n):
    for _ in range(n):
        guards.first_breach(params.guard, state.before, state.now.feedback, state.breach)


@kernel
def expose(params, state, vision_noise, travel_draws, leds, frames, stats, n):
    for _ in range(n):
        state.in_transit, first = 0, state.next_exposure
        until_s = (state.next_exposure + 0.5) / params.vmu_rate_hz
        state.rails.t_s = state.turntable.t_s = until_s  # the axes move in a separate stage
        loop._expose(params, state, until_s, first, vision_noise, travel_draws, leds, frames, stats)


@kernel
def receive_poses(params, state, frames, delayed, poses, arrivals, n):
    for _ in range(n):
        state.in_transit = 1
        frames[0].received_s = 0.0
        loop._receive_poses(params, state, 0.01, frames, delayed, poses, arrivals)
        loop._record_pose(state, poses, 1)


@kernel
def predict(params, state, samples, memory, poses, n):
    for _ in range(n):
        navigation.navigate(
            params.gnc.navigation, state.gnc.navigation, memory, samples, poses, 0, state.now.navigation
        )


@kernel
def fuse(params, state, samples, memory, poses, n):
    for i in range(n):
        poses[0].t_s = state.gnc.navigation.fusion.cycle * params.step_s
        poses[0].z_TC_C[0] += 1e-9 * (1 - 2 * (i % 2))  # a pose that repeats the last one is refused
        navigation.navigate(
            params.gnc.navigation, state.gnc.navigation, memory, samples, poses, 1, state.now.navigation
        )


@kernel
def decide(params, state, n):
    now = state.now
    for _ in range(n):
        step.guide(params.gnc.approach, state.gnc.approach, now.t_s, now.supervision, now.reference)
        step.watch_approach(
            params.gnc.approach, state.gnc.approach, now.t_s, now.navigation, now.reference, now.supervision, False
        )
        step.actuate(params.gnc, state.gnc, now.navigation, now.reference, now.command)


@kernel
def errors(params, state, n):
    out = stack.vector(2)
    for _ in range(n):
        navigation.normalised_errors(
            state.gnc.navigation.fusion.filters,
            params.gnc.navigation.fusion.orbit,
            state.now.truth,
            state.now.imu,
            out,
        )


@kernel
def cycle_stats(params, state, stats, n):
    for _ in range(n):
        count_cycle(params, state, stats)


@kernel
def move_truth(params, field, state, n):
    for _ in range(n):
        truth_kernels.step(params.dss, field, state.truth_memory, state.now.truth, state.now.command.on)


@kernel
def sample_imu(params, state, noise, n):
    for i in range(n):
        imu_kernels.sample_with_errors(
            params.imu, state.now.truth, state.now.truth.w_CI_C, noise[i % noise.shape[0]], state.imu_memory,
            state.now.imu,
        )  # fmt: skip


@kernel
def follow(params, state, stats, n):
    for _ in range(n):
        loop._aim(params, state)
        loop._send_setpoints(params, state, stats, state.rails.t_s)


def best_ns(flight: CaseRunner, work: Callable[[int], object]) -> float:
    """Return the shortest time of one call, ns, each measurement from the same state."""
    kept = flight._state_block.copy(), flight._memory.copy()
    work(1)
    found = []
    for _ in range(REPEATS):
        flight._state_block[...], flight._memory[...] = kept
        begun = time.thread_time()
        work(TIMES)
        found.append((time.thread_time() - begun) / TIMES * 1e9)
    flight._state_block[...], flight._memory[...] = kept
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scheme", default="scheme-1")
    scenario = load_scenario(parser.parse_args().scheme).value
    whole = CaseRunner(scenario, load_rig("mock").value, scenario.duration_s)
    whole.run(scenario, 0)
    took = []
    for seed in range(FLIGHTS):
        begun = time.thread_time()
        whole.run(scenario, seed)
        took.append(time.thread_time() - begun)
    flight = CaseRunner(scenario, load_rig("mock").value, 0.5 * scenario.duration_s)
    flight.run(scenario, 0)
    p, s, samples = flight._params, flight._state, flight._samples
    memory, poses = flight._memory, flight._poses
    frames, stats, arrivals = flight._frames, flight._stats, np.zeros(0, ARRIVAL)
    field, leds = dynamics_params.field(scenario), flight._leds
    imu_noise, vision_noise, draws = flight._imu_noise, flight._vision_noise, flight._travel_draws
    a_pose = 1.0 / (p.vmu_rate_hz * p.step_s)  # cycles
    s.in_transit = 1
    found = {
        "axes of the mock rig, encoders": best_ns(flight, lambda n: read_axes(p, s, n)),
        "supervision of the bench": best_ns(flight, lambda n: supervise_bench(p, s, n)),
        "vision unit": best_ns(flight, lambda n: expose(p, s, vision_noise, draws, leds, frames, stats, n)) / a_pose
        + best_ns(flight, lambda n: receive_poses(p, s, frames, frames.copy(), poses, arrivals, n)) / a_pose,
        "filters, prediction": (alone := best_ns(flight, lambda n: predict(p, s, samples, memory, poses, n))),
        "filters, poses": (best_ns(flight, lambda n: fuse(p, s, samples, memory, poses, n)) - alone) / a_pose,
        "consistency of the filters": best_ns(flight, lambda n: errors(p, s, n)) / a_pose,
        "guidance, supervision, control": best_ns(flight, lambda n: decide(p, s, n)),
        "stats": best_ns(flight, lambda n: cycle_stats(p, s, stats, n)),
        "truth": best_ns(flight, lambda n: move_truth(p, field, s, n)),
        "virtual IMU": best_ns(flight, lambda n: sample_imu(p, s, imu_noise, n)),
        "setpoints": best_ns(flight, lambda n: follow(p, s, stats, n)),
    }
    cycle_ns = min(took) / whole.cycles * 1e9
    for name, ns in found.items():
        print(f"  {name:34s} {ns:8.0f} ns")
    total = sum(found.values())
    print(f"  {'sum of the stages':34s} {total:8.0f} ns")
    print(f"  {'a cycle of a run, set-up included':34s} {cycle_ns:8.0f} ns  ({scenario.step_s / cycle_ns * 1e9:.0f} x)")
    if not np.isfinite(total):
        raise SystemExit("a stage was measured on records that are not finite")


if __name__ == "__main__":
    main()
