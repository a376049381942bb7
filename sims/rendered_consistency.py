"""Consistency of the filters on rendered images: NEES and NIS over runs of scheme 1 with cameras, as JSON.

    python sims/rendered_consistency.py [RUNS [DURATION_S]] [--start M] [--workers N] [--set KEY=VALUE ...]

The stereo pair of each exposure is rendered at the axis positions of the mock rig and solved by the vision unit, so
that the poses have the bench's error: what the compensation leaves of the delay of its axes. Each run has another
start, other attitude and other noise.
The bands contain the mean of a consistent filter in 999 of 1000 studies: of NEES, correlated within a run, that of as
many independent values as runs; of NIS that of all updates.
"""

from __future__ import annotations

import argparse
import json
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any, Final

import numpy as np

import hil
from hil.maths import chi_square

RIG: Final = "mock-compensated"
BUDGET: Final[dict[str, float]] = {
    "gnc.navigation.budget.bench_sigma_m": 1.2e-5,
    "gnc.navigation.budget.bench_sigma_deg": 2e-5,
    "gnc.navigation.budget.vision_correlation_time_s": 60.0,
}
"""Error of the bench, as docs/explanation/error-budget.md derives it."""
TAIL: Final = 0.0005  # of the 99.9 % band, on either side
SETTLED_S: Final = 5.0  # from the first pose on, until the filters have converged


def settings_of(run: int, start_m: float) -> dict[str, Any]:
    """Return the settings of ``run``: its start about the one of the study."""
    rng = np.random.default_rng(run)
    position = np.array([start_m, -0.05, 0.05]) + rng.normal(0.0, [0.05, 0.02, 0.02])
    return {
        "vmu.source": "rendered",
        "initial.position_m": position.tolist(),
        "initial.attitude_deg": rng.normal(0.0, 1.0, 3).tolist(),
    }


def fly(rig: str, duration_s: float, start_m: float, more: dict[str, Any], run: int) -> dict[str, Any]:
    """Return the mean NEES and NIS of ``run``, with the number of values, and the error of the camera's place."""
    begun_s = time.process_time()
    found = hil.run("scheme-1", rig=rig, seed=run, duration_s=duration_s, overrides=settings_of(run, start_m) | more)
    late = found.history[found.history["t_s"] >= SETTLED_S]
    values = {
        "nees_position": late["nees_position"],
        "nees_attitude": late["nees_attitude"],
        "nis_position": late["navigation"]["nis_position"],
        "nis_attitude": late["navigation"]["nis_attitude"],
    }
    finite = {name: column[np.isfinite(column)] for name, column in values.items()}
    return {
        "run": run,
        "stop": found.stop,
        **{name: float(column.mean()) for name, column in finite.items()},
        "updates": len(finite["nis_position"]),
        "camera_error_mm": found.summary["bench"]["pose_error_mm"]["rms"],
        "camera_error_deg": found.summary["bench"]["pose_error_deg"]["rms"],
        "cpu_s": time.process_time() - begun_s,
    }


def judged(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the means over ``runs`` with their bands."""
    updates, result = sum(run["updates"] for run in runs), {}
    for name, dimension, count in (
        ("nees_position", 9, len(runs)),
        ("nees_attitude", 6, len(runs)),
        ("nis_position", 3, updates),
        ("nis_attitude", 3, updates),
    ):
        low, high = chi_square.band_of_mean(count, dimension, TAIL)
        mean = float(np.mean([run[name] for run in runs]))
        result[name] = {"mean": mean, "low": low, "high": high, "inside": low <= mean <= high}
    return result


def _setting(text: str) -> tuple[str, Any]:
    key, _, value = text.partition("=")
    return key, tomllib.loads(f"value = {value}")["value"]


def main() -> None:
    """Fly the runs and print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("runs", type=int, nargs="?", default=20)
    parser.add_argument("duration_s", type=float, nargs="?", default=120.0)
    parser.add_argument("--start", type=float, default=2.5, help="range at the start, m")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--shipped", action="store_true", help="rig mock, without the budget of the bench's error")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    rig, budget = ("mock", {}) if given.shipped else (RIG, BUDGET)
    more = budget | dict(map(_setting, given.set))
    one = partial(fly, rig, given.duration_s, given.start, more)
    with ProcessPoolExecutor(given.workers, get_context("spawn")) as pool:
        runs = list(pool.map(one, range(given.runs)))
    print(
        json.dumps(
            {"rig": rig, "settings": more, "duration_s": given.duration_s, **judged(runs), "runs": runs}, indent=2
        )
    )


if __name__ == "__main__":
    main()
