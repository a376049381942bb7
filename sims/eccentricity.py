"""Consistency of the filters and pass rate of a scheme on eccentric orbits of the target.

python sims/eccentricity.py 2000 --workers 2    scheme 1, 2,000 cases per eccentricity
python sims/eccentricity.py 200 scheme-2 0.09

The filters assume the root mean square of the dispersed noise of the IMU; with --nominal the nominal one, as in hil
campaign. Each eccentricity is printed when it is done.
"""

from __future__ import annotations

import argparse
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.maths import chi_square
from hil.parts.campaigns.batch import Rows, Spec
from hil.parts.campaigns.engines import LocalEngine

ECCENTRICITIES: Final = (0.0, 0.001, 0.005, 0.01, 0.03, 0.09)
TAIL: Final = 0.0005  # of the 99.9 % band, on either side
BATCH: Final = 50


def with_known_noise(scenario: Scenario) -> Scenario:
    """Return ``scenario`` whose filters have the root mean square of the uniform spreads of the IMU's noise."""

    def rms(name: str) -> float:
        spread = scenario.dispersions.imu.get(name)
        if spread is None:
            return 1.0
        return float(np.sqrt((spread["low"] ** 2 + spread["low"] * spread["high"] + spread["high"] ** 2) / 3.0))

    gnc = scenario.gnc
    gyro, accelerometer = rms("gyro_noise_degps"), rms("accelerometer_noise_mps2")
    akf = gnc.akf.model_copy(update={"gyro_noise_degps": gyro * gnc.akf.gyro_noise_degps})
    pkf = gnc.pkf.model_copy(update={"accelerometer_noise_mps2": accelerometer * gnc.pkf.accelerometer_noise_mps2})
    return scenario.model_copy(update={"gnc": gnc.model_copy(update={"akf": akf, "pkf": pkf})})


def flown(scenario: Scenario, cases: int, workers: int) -> Rows:
    """Return the rows of a campaign of ``cases``."""
    spec = Spec.of(scenario, load_rig("mock").value, 0, scenario.duration_s)
    engine, rows = LocalEngine(workers), []
    try:
        for _, part in engine.run(spec, [(k, min(BATCH, cases - k)) for k in range(0, cases, BATCH)]):
            rows += part
    finally:
        engine.close()
    return rows


def main() -> None:
    """Fly the campaigns and print one row per eccentricity."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("cases", type=int, nargs="?", default=2000)
    parser.add_argument("scheme", nargs="?", default="scheme-1")
    parser.add_argument("eccentricity", type=float, nargs="*", default=ECCENTRICITIES)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--nominal", action="store_true", help="the filters assume the nominal noise of the IMU")
    given = parser.parse_args()
    console, table = Console(width=150), Table(title=f"{given.scheme}: {given.cases} cases per eccentricity")
    for column in ("e", "pass", "all parts", "NEES, 9", "band", "NEES, 6", "band"):
        table.add_column(column, justify="right")
    for e in given.eccentricity:
        scenario = load_scenario(given.scheme, (f"orbit.eccentricity={e!r}",)).value
        rows = flown(scenario if given.nominal else with_known_noise(scenario), given.cases, given.workers)
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
