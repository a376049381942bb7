"""Vision unit on images with the errors of real lenses, sensors and calibrations, from a renderer of its own.

python sims/vmu_disturbances.py [--frames N] [--seeds N] [--row TEXT]

One line per row and seed: frames solved, gross errors (beyond 3 deg or 1 % of the range, and beyond 4 sigma), error
over sigma, 2-sigma coverage, processor time per pair, other statuses. Calibrations (1 sigma): very good is 0.05 px,
0.02 % of the focal length, 0.003 deg, 0.03 mm, LEDs to 0.05 mm; usual is 0.2 px, 0.1 %, 0.02 deg, 0.1 mm, LEDs to
0.1 mm.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from tests.support.vmu_disturbances import ROWS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--row", default="", help="rows whose name contains this text")
    chosen = parser.parse_args()
    for row in ROWS:
        if chosen.row in row.name:
            for seed in range(chosen.seeds):
                print(f"{row.name:36} {seed} | {row.run(chosen.frames, seed).line()}", flush=True)


if __name__ == "__main__":
    main()
