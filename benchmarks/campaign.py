"""Cost of a campaign: closed-loop seconds per second, over workers, and of other implementations.

    python benchmarks/campaign.py [--seconds 10] [--rounds 3] [--scaling]

One run on one machine, nothing else running: compare the rows with each other.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.parts.campaigns.batch import Spec, run_batch
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.engines import LocalEngine

sys.path.insert(0, str(Path(__file__).resolve().parent))
GOAL, LEAST = 10_000.0, 2_000.0
SCALING_GOAL = 0.9


def spec(scheme: str = "scheme-1") -> Spec:
    """Return the campaign of ``scheme`` with its dispersions."""
    scenario = load_scenario(scheme).value
    return Spec.of(scenario, load_rig("mock").value, 0, scenario.duration_s)


def loop_speed(scheme: str, repeats: int = 15) -> float:
    """Return the best simulated seconds per second of one run without dispersions, including set-up."""
    scenario = load_scenario(scheme).value
    flight = CaseRunner(scenario, load_rig("mock").value, scenario.duration_s)
    taken = []
    for seed in range(repeats + 1):
        begun = time.perf_counter()
        flight.run(scenario, seed)
        taken.append(time.perf_counter() - begun)
    return scenario.duration_s / min(taken[1:])


def copy(seconds: float) -> None:
    """Run one independent copy: report that it is warm, wait for the start, then count cases for ``seconds``."""
    chosen = spec()
    run_batch(chosen, 0, 3)
    print("ready", flush=True)
    sys.stdin.readline()
    begun, cases = time.perf_counter(), 0
    while time.perf_counter() - begun < seconds:
        run_batch(chosen, cases, 5)
        cases += 5
    print(cases / (time.perf_counter() - begun), flush=True)


def copies_rate(number: int, seconds: float) -> float:
    """Return the cases per second of ``number`` independent copies that run at once."""
    command = [sys.executable, __file__, "--copy", str(seconds)]
    running = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(number)
    ]
    for child in running:
        assert child.stdout is not None
        child.stdout.readline()
    for child in running:
        assert child.stdin is not None
        child.stdin.write("go\n")
        child.stdin.flush()
    return sum(float(child.communicate()[0]) for child in running)


def workers_rate(workers: int, seconds: float, speed: float) -> float:
    """Return the cases per second of a campaign with ``workers`` processes once all are warm, to its last batch."""
    chosen = spec()
    settled = 3 * workers
    batches = settled + max(4 * workers, round(workers * seconds * speed / 20.0))
    times, cases = [], []
    for first, rows in LocalEngine(workers).run(chosen, [(20 * k, 20) for k in range(batches)]):
        times.append(time.perf_counter())
        cases.append(len(rows))
        del first
    return sum(cases[settled:]) / (times[-1] - times[settled - 1])


def plain_speed(span_s: float = 20.0) -> float:
    """Return the simulated seconds per second of the numpy and filterpy loop."""
    from plain_loop import PlainLoop

    PlainLoop().run(1.0)
    loop = PlainLoop()
    begun = time.perf_counter()
    loop.run(span_s)
    return span_s / (time.perf_counter() - begun)


def basilisk_speed(span_s: float = 400.0) -> float | None:
    """Return the simulated seconds per second of two spacecraft in Basilisk in the same field, without a GNC."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "oracle"))
    try:
        from tests.support.basilisk_pair import Pair, write_field
    except ImportError:
        return None
    from hil.maths import quat
    from hil.params import dynamics as dynamics_params

    scenario = load_scenario("scheme-1").value
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    a = quat.to_matrix(truth.q_HI)
    r, v = a.T @ truth.r_CT_H, a.T @ (truth.v_CT_H + np.cross(truth.w_HI_H, truth.r_CT_H))
    states = [(truth.r_T_I, truth.v_T_I), (truth.r_T_I + r, truth.v_T_I + v)]
    with tempfile.TemporaryDirectory() as folder:
        path = write_field(scenario, Path(folder) / "moon.txt")
        pair = Pair(params, states, path, step_s=scenario.step_s, turning=False)
        begun = time.perf_counter()
        pair.run_to(span_s)
        return span_s / (time.perf_counter() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement over workers")
    parser.add_argument("--rounds", type=int, default=3, help="of workers and copies")
    parser.add_argument("--scaling", action="store_true", help="measure only workers and copies")
    parser.add_argument("--copy", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.copy is not None:
        copy(options.copy)
        return
    if not options.scaling:
        speeds_of_one_core()
    print(f"cases of scheme-1 a second with dispersions, {len(os.sched_getaffinity(0))} cores")
    scaling(options.seconds, options.rounds)


def speeds_of_one_core() -> None:
    """Print the speed of the compiled loop and of other implementations."""
    print("closed-loop seconds simulated a second, one core, best run of 400 s")
    speeds = {scheme: loop_speed(scheme) for scheme in ("scheme-1", "scheme-2", "scheme-3")}
    for scheme, speed in speeds.items():
        print(f"  {scheme:34s} {speed:10.0f} x  {400e3 / speed:7.1f} ms a run (at least {LEAST:g} x, goal {GOAL:g} x)")
    plain = plain_speed()
    ratio = speeds["scheme-1"] / plain
    print(f"  {'numpy and filterpy, the same loop':34s} {plain:10.2f} x  (scheme-1 is {ratio:.0f} times it, goal 20)")
    basilisk = basilisk_speed()
    if basilisk is None:
        print("  Basilisk is not installed (constraints-oracle.txt): no line for it")
    else:
        ratio = speeds["scheme-1"] / basilisk
        print(f"  {'Basilisk, two craft, no GNC':34s} {basilisk:10.0f} x  (scheme-1 is {ratio:.1f} times it)")


def scaling(seconds: float, rounds: int) -> None:
    """Print the rate of two workers and of two independent copies."""
    one = copies_rate(1, seconds)
    print(f"  one copy {one:.2f}, one worker {workers_rate(1, seconds, one):.2f}")
    shares = []
    for turn in range(rounds):
        # alternating, either of them first: other load then affects both alike
        if turn % 2 == 0:
            copies, workers = copies_rate(2, seconds), workers_rate(2, seconds, one)
        else:
            workers, copies = workers_rate(2, seconds, one), copies_rate(2, seconds)
        shares.append(workers / copies)
        print(f"  two independent copies at once {copies:.2f}, two workers {workers:.2f}: {100 * shares[-1]:.0f} %")
    print(f"  median {100 * np.median(shares):.0f} % (goal {100 * SCALING_GOAL:.0f} %)")


if __name__ == "__main__":
    main()
