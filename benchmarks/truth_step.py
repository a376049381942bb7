"""Cost of a step of the truth, and of the same span in Basilisk if installed.

    python benchmarks/truth_step.py [--span-s 400]

One run on one machine: compare the rows with each other, not with those of another computer.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hil.config.load import load_scenario
from hil.core.jit import kernel
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import central_gravity
from hil.dynamics import truth as kernels
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import quat
from hil.params import dynamics as dynamics_params

GRAVITY_ALONE = (
    "truth.gravity_gradient=false",
    "truth.solar_pressure=false",
    "truth.flexible_array=false",
    "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
)
REPEATS = 5


@kernel
def steps(params, field, memory, truth, on, n):
    """Take ``n`` steps without leaving compiled code, as a campaign does."""
    for _ in range(n):
        kernels.step(params, field, memory, truth, on)


@kernel
def pulls(params, field, r, n):
    """Evaluate the harmonics ``n`` times at positions 1 m apart; return a sum, so that nothing is optimised away."""
    total = 0.0
    for i in range(n):
        x, _, _ = central_gravity.harmonics(params, field, r[0] + i, r[1], r[2])
        total += x
    return total


def best_s(work: Callable[[], object]) -> float:
    """Return the shortest of a few runs, s."""
    found = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        work()
        found.append(time.perf_counter() - started)
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--span-s", type=float, default=400.0)
    span_s = parser.parse_args().span_s
    quiet = np.zeros(MAX_THRUSTERS, dtype=np.int64)
    print(f"{span_s:g} s of flight at 50 Hz, best of {REPEATS}")
    for title, settings in (
        ("degree 8, all effects", ()),
        ("degree 8, gravity alone", GRAVITY_ALONE),
        ("point mass, gravity alone", (*GRAVITY_ALONE, "truth.gravity_degree=0")),
        ("Hill, no disturbance", (*GRAVITY_ALONE, "truth.relative_motion=hill")),
    ):
        scenario = load_scenario("scheme-2", settings).value
        params, field, truth = (
            dynamics_params.dss(scenario),
            dynamics_params.field(scenario),
            dynamics_params.initial_truth(scenario),
        )
        memory = new(TRUTH_MEMORY)
        n = round(span_s / params.dt_s)
        steps(params, field, memory, truth, quiet, 1)
        taken = best_s(lambda: steps(params, field, memory, truth, quiet, n))  # noqa: B023
        print(f"  {title:28s} {1e6 * taken / n:8.2f} us a step {taken:9.4f} s")
    scenario = load_scenario("scheme-2").value
    params, field, r = (
        dynamics_params.dss(scenario),
        dynamics_params.field(scenario),
        dynamics_params.initial_truth(scenario).r_T_I,
    )
    pulls(params.gravity, field, r, 1)
    taken = best_s(lambda: pulls(params.gravity, field, r, 100_000))
    print(f"  {'harmonics of degree 8':28s} {10.0 * taken:8.2f} us a call")
    _basilisk(span_s)


def _basilisk(span_s: float) -> None:
    """Propagate both in the same field, of a Moon without rotation, with Basilisk's Runge-Kutta 4 at the same step."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "oracle"))
    try:
        from tests.support.basilisk_pair import Pair, write_field
    except ImportError:
        print("  Basilisk is not installed (constraints-oracle.txt): no line for it")
        return
    scenario = load_scenario("scheme-2", GRAVITY_ALONE).value
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    a = quat.to_matrix(truth.q_HI)
    r, v = a.T @ truth.r_CT_H, a.T @ (truth.v_CT_H + np.cross(truth.w_HI_H, truth.r_CT_H))
    states = [(truth.r_T_I, truth.v_T_I), (truth.r_T_I + r, truth.v_T_I + v)]
    with tempfile.TemporaryDirectory() as folder:
        path = write_field(scenario, Path(folder) / "moon.txt")
        pair = Pair(params, states, path, step_s=scenario.step_s, turning=False)
        started = time.perf_counter()
        pair.run_to(span_s)
        taken = time.perf_counter() - started
    n = round(span_s / scenario.step_s)
    print(f"  {'Basilisk, gravity alone':28s} {1e6 * taken / n:8.2f} us a step {taken:9.4f} s")


if __name__ == "__main__":
    main()
