"""Vision unit and docking monitor on images with the errors of real lenses, sensors, calibrations and scene files.

python sims/disturbances.py vmu|monitor [--count N] [--seeds N] [--row TEXT]

The images are those of renderers of their own. One line per row and seed: frames solved or portions measured, gross
errors (beyond 3 deg or 1 % of the range, and beyond 4 sigma), error over sigma, 2-sigma coverage, statuses; of the
vision unit also the processor time per pair. Its calibrations (1 sigma): very good is 0.05 px, 0.02 % of the focal
length, 0.003 deg, 0.03 mm, LEDs to 0.05 mm; usual is 0.2 px, 0.1 %, 0.02 deg, 0.1 mm, LEDs to 0.1 mm. The monitor's
portions are at 3 to 12 m, each of a new monitor.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from tests.support.monitor_disturbances import MONITOR_ROWS
from tests.support.vmu_disturbances import ROWS

TABLES = {"vmu": (ROWS, 40), "monitor": (MONITOR_ROWS, 20)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("unit", choices=TABLES)
    parser.add_argument("--count", type=int, help="frames (40) or portions (20) per row and seed")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--row", default="", help="rows whose name contains this text")
    chosen = parser.parse_args()
    rows, count = TABLES[chosen.unit]
    for row in rows:
        if chosen.row in row.name:
            for seed in range(chosen.seeds):
                print(f"{row.name:36} {seed} | {row.run(chosen.count or count, seed).line()}", flush=True)


if __name__ == "__main__":
    main()
