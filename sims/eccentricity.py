"""Consistency of the filters and pass rate of a scheme on eccentric orbits of the target.

python sims/eccentricity.py 2000                scheme 1, 2,000 cases per eccentricity, one worker
python sims/eccentricity.py 200 scheme-2 0.09
"""

from __future__ import annotations

import argparse
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.config.load import load_rig, load_scenario
from hil.maths import chi_square
from hil.monte_carlo.batch import Spec, run_batch

ECCENTRICITIES: Final = (0.0, 0.001, 0.005, 0.01, 0.03, 0.09)
TAIL: Final = 0.0005  # of the 99.9 % band, on either side


def main() -> None:
    """Fly the campaigns and print one row per eccentricity."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("cases", type=int, nargs="?", default=2000)
    parser.add_argument("scheme", nargs="?", default="scheme-1")
    parser.add_argument("eccentricity", type=float, nargs="*", default=ECCENTRICITIES)
    given = parser.parse_args()
    console, table = Console(width=150), Table(title=f"{given.scheme}: {given.cases} cases per eccentricity")
    for column in ("e", "pass", "all parts", "NEES, 9", "band", "NEES, 6", "band"):
        table.add_column(column, justify="right")
    for e in given.eccentricity:
        scenario = load_scenario(given.scheme, (f"orbit.eccentricity={e!r}",)).value
        rows = run_batch(Spec.of(scenario, load_rig("mock").value, 0, scenario.duration_s), 0, given.cases)
        cells = [f"{e:g}"]
        cells += [f"{100.0 * np.mean([row[name] for row in rows]):.2f} %" for name in ("passed", "passed_all_parts")]
        for name, states in (("nees_pkf", 9), ("nees_akf", 6)):
            values = [row[name] for row in rows if row[name] is not None]
            low, high = chi_square.band_of_mean(len(values), states, TAIL)
            cells += [f"{np.mean(values):.2f}", f"{low:.2f} .. {high:.2f}"]
        table.add_row(*cells)
        console.print(" ".join(cells))
    console.print(table)


if __name__ == "__main__":
    main()
