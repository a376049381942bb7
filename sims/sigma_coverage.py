"""Coverage of the sigmas on the own renderers: docking monitor and vision unit, per column and mode.

python sims/sigma_coverage.py [--portions 400] [--poses 300] [--seed N] [--workers N]

The fraction of errors within two sigmas, in per cent; 90 to 98 are allowed. Continuous portions carry their motion
over, so that errors of neighbours are alike: their fractions are less certain than those of independent ones. Exit code
1 if a column with at least 100 values is outside.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor

import cv2
import monitor_study
import numpy as np
import vmu_study

from hil.config.load import load_scene
from hil.core.messages import Array
from hil.parts.monitor.results import FAR, NEAR, QUANTITIES

ALLOWED = (90.0, 98.0)
FEWEST = 100
CASES = (
    *(("monitor", study, scene) for study in ("independent", "continuous") for scene in ("atv", "bright-cross")),
    ("vmu", "spots", "raised"),
    ("vmu", "spots", "flat"),
    ("vmu", "images", "raised"),
)
Case = tuple[str, str, str]
Table = tuple[tuple[str, ...], dict[str, Array]]  # columns; ratios (n, columns) by mode


def of_monitor(study: str, name: str, portions: int, seed: int) -> Table:
    """Return the errors over sigmas of rendered portions."""
    cv2.setNumThreads(1)
    scene = load_scene(name).value
    found = (
        monitor_study.independent(scene, portions, seed, 0)
        if study == "independent"
        else monitor_study.continuous(scene, portions, seed)
    )
    ratios, modes = np.array(found.ratios), np.array(found.modes)
    return QUANTITIES, {mode: ratios[modes == mode] for mode in (NEAR, FAR)}


def of_vision_unit(study: str, ring: str, poses: int, seed: int) -> Table:
    """Return the errors over sigmas of poses by spots, or by rendered images."""
    raised_m = 0.06 if ring == "raised" else 0.0
    with contextlib.redirect_stdout(io.StringIO()):
        if study == "spots":
            found = vmu_study.coverage(poses, seed, raised_m, (None,))
        else:
            found = vmu_study.images(max(poses // len(vmu_study.RANGES_M), 1), seed, raised_m)
    return vmu_study.NAMES, {"": np.array(found)}


def solve(case: Case, count: int, seed: int) -> Table:
    """Return the results of one case."""
    unit, study, which = case
    return of_monitor(study, which, count, seed) if unit == "monitor" else of_vision_unit(study, which, count, seed)


def lines(case: Case, table: Table) -> tuple[list[str], bool]:
    """Return the printed lines of a case, and whether all columns are within what is allowed."""
    columns, by_mode = table
    out, passed = [], True
    for mode, ratios in by_mode.items():
        cells = []
        for k, name in enumerate(columns):
            column = ratios[np.isfinite(ratios[:, k]), k] if len(ratios) else ratios
            if not len(column):
                continue
            within = 100.0 * float(np.mean(np.abs(column) < 2.0))
            outside = not ALLOWED[0] <= within <= ALLOWED[1]
            passed = passed and not (outside and len(column) >= FEWEST)
            cells.append(f"{name} {within:.1f}{' !' if outside else ''}")
        out.append(f"{' '.join((*case, mode)):38} {len(ratios):5d} | " + "  ".join(cells))
    return out, passed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--portions", type=int, default=400)
    parser.add_argument("--poses", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    good = True
    with ProcessPoolExecutor(given.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        jobs = [
            (case, pool.submit(solve, case, given.portions if case[0] == "monitor" else given.poses, given.seed))
            for case in CASES
        ]
        for case, job in jobs:
            text, passed = lines(case, job.result())
            print("\n".join(text), flush=True)
            good = good and passed
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
