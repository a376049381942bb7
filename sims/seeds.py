"""One scheme over many seeds on the mock rig: pass rate, the worst seed of each cell and Table V, propellant.

python sims/seeds.py scheme-1 200 vmu.latency_s=0.1
"""

from __future__ import annotations

import os
import sys
import tomllib
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
from rich.progress import track

import hil
from hil.params.ready import ROW_NAMES
from hil.report.verdict import TABLE_V


def run(scheme: str, seed: int, overrides: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers of one run."""
    return hil.run(scheme, seed=seed, overrides=overrides).summary


def main(scheme: str, seeds: int, settings: tuple[str, ...]) -> None:
    overrides = {key: tomllib.loads(f"value = {text}")["value"] for key, text in (s.split("=", 1) for s in settings)}
    workers = len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(workers, mp_context=get_context("forkserver")) as pool:
        waiting = [pool.submit(run, scheme, seed, overrides) for seed in range(seeds)]
        runs = [future.result() for future in track(waiting, scheme)]
    passed = [run for run in runs if run["passed"]]
    ready = [run["ready_time_s"] for run in runs if run["ready_time_s"] is not None]
    propellant = np.array([run["thrusters"]["propellant_kg"] for run in runs])
    firings = np.array([sum(run["thrusters"]["thruster_firings"]) for run in runs])
    torque = np.array([sum(run["thrusters"]["torque_on_time_360_400_s"]) for run in runs])
    print(f"{scheme}, seeds 0..{seeds - 1}, {' '.join(settings)}: {len(passed)} of {seeds} pass Table III")
    print(f"ready {min(ready):.2f} .. {max(ready):.2f} s" if ready else "never ready")
    for name, values, unit in (
        ("propellant", propellant, "kg"),
        ("firings", firings, ""),
        ("torque 360-400", torque, "s"),
    ):
        low, median, high = np.percentile(values, [5, 50, 95])
        print(f"{name}: 5 % {low:.4g}, median {median:.4g}, 95 % {high:.4g} {unit}")
    paper = TABLE_V.get(scheme)
    for row in ROW_NAMES:
        cells = np.array([run["ready_phase"][row] for run in runs if run["ready_phase"] is not None])
        if not len(cells):
            continue
        worst, seed = cells.max(axis=0), cells.argmax(axis=0)
        limit = getattr(paper, row) if paper else (np.inf,) * 3
        text = "  ".join(
            f"{w:.5f} (seed {s}, Table V {v:g}{'' if w < v else ' MISSED'})"
            for w, s, v in zip(worst, seed, limit, strict=True)
        )
        print(f"worst {row}: {text}")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), tuple(sys.argv[3:]))
