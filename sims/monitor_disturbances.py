"""Docking monitor on images with the errors of real lenses, sensors and scene files, from a renderer of its own.

python sims/monitor_disturbances.py [--portions N] [--seeds N] [--row TEXT]

One line per row and seed: portions measured, gross errors (beyond 3 deg or 1 % of the range, and beyond 4 sigma), error
over sigma, 2-sigma coverage, portions marked consistent, statuses. Ranges of 3 to 12 m, a new monitor for each portion.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from tests.support.monitor_disturbances import MONITOR_ROWS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--portions", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--row", default="", help="rows whose name contains this text")
    chosen = parser.parse_args()
    for row in MONITOR_ROWS:
        if chosen.row in row.name:
            for seed in range(chosen.seeds):
                print(f"{row.name:32} {seed} | {row.run(chosen.portions, seed).line()}", flush=True)


if __name__ == "__main__":
    main()
