"""Figures 6 and 7 of the bench paper for a scheme: relative position, speed, attitude and rate over time.

python sims/scheme_pictures.py scheme-1 docs/pictures/scheme-1.png
"""

from __future__ import annotations

import sys

import hil


def main(name: str, path: str) -> None:
    run = hil.run(name)
    run.plot().savefig(path, dpi=110)
    print(f"{path}: ready at {run.ready_time_s} s")


if __name__ == "__main__":
    main(*sys.argv[1:3])
