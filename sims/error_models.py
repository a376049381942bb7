"""Effect of each term of the error models, alone and together: the dispersion set data-sheet, term by term.

python sims/error_models.py                     200 cases per term of scheme 1, without and with its part of the budget
python sims/error_models.py 1000 scheme-2-paper
python sims/error_models.py 200 scheme-1-paper correlated bias
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.config.tables.dispersions import Dispersions
from hil.parts.campaigns.batch import Rows, Spec, run_batch

SET: Final = "data-sheet"
BUDGET: Final = {
    "bias_m": ("vision_bias_sigma_m",),
    "misalignment_deg": ("vision_misalignment_sigma_deg",),
    "scale_error": ("vision_scale_sigma",),
    "correlated_fraction": ("vision_correlated_fraction", "vision_correlation_time_s"),
    "gyro_scale_error": ("gyro_scale_sigma",),
    "gyro_misalignment_deg": ("gyro_misalignment_sigma_deg",),
    "gyro_instability_degps": ("gyro_instability_degps",),
    "accelerometer_scale_error": ("accelerometer_scale_sigma",),
    "accelerometer_misalignment_deg": ("accelerometer_misalignment_sigma_deg",),
    "accelerometer_instability_mps2": ("accelerometer_instability_mps2",),
}
"""Keys of the set's error budget by term; terms without an entry have none."""
MODELS: Final = (("vmu", "errors"), ("imu", "errors"), ("chaser", "thrusters", "errors"))


def terms(dispersions: Dispersions) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each term of the error models, and the dispersions that have it alone."""
    for path in MODELS:
        table = getattr(dispersions, path[0])
        for key in path[1:]:
            table = table[key]
        for key, spread in table.items():
            alone: dict[str, Any] = {key: spread}
            if key == "correlated_fraction":
                alone["correlation_time_s"] = table["correlation_time_s"]
            if key != "correlation_time_s":
                for parent in reversed(path):
                    alone = {parent: alone}
                yield ".".join((*path, key)), alone


def with_dispersions(scenario: Scenario, tables: dict[str, Any], budget: dict[str, Any] | None = None) -> Scenario:
    """Return ``scenario`` with these dispersions only. budget: of the keys of the error budget."""
    tables = tables | ({"gnc": {"navigation": {"budget": budget}}} if budget else {})
    return scenario.model_copy(update={"dispersions": Dispersions.model_validate(tables)})


def campaigns(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    """Yield the campaigns of a scenario that has the set: each term without and with the budget, then all."""
    whole: dict[str, Any] = scenario.dispersions.gnc["navigation"]["budget"]
    yield "none", with_dispersions(scenario, {})
    yield "none, whole budget", with_dispersions(scenario, {}, whole)
    for name, alone in terms(scenario.dispersions):
        yield name, with_dispersions(scenario, alone)
        if keys := BUDGET.get(name.rpartition(".")[2]):
            yield f"{name}, budget", with_dispersions(scenario, alone, {key: whole[key] for key in keys})
    untold = scenario.dispersions.model_copy(update={"gnc": {}})
    yield f"set {SET}, without budget", scenario.model_copy(update={"dispersions": untold})
    yield f"set {SET}", scenario


def flown(scenario: Scenario, cases: int) -> Rows:
    """Return the rows of a campaign of ``cases``."""
    return run_batch(Spec.of(scenario, load_rig("mock").value, 0, scenario.duration_s), 0, cases)


def numbers(rows: Rows) -> dict[str, float]:
    """Return the numbers of a campaign's rows; medians unless named otherwise."""

    def median(*names: str) -> float:
        values = [max(row[name] for name in names) for row in rows if all(row[name] is not None for name in names)]
        return float(np.median(values)) if values else float("nan")

    def mean(name: str) -> float:
        values = [row[name] for row in rows if row[name] is not None]
        return float(np.mean(values)) if values else float("nan")

    return {
        "passed": sum(row["passed"] for row in rows) / len(rows),
        "all parts": sum(row["passed_all_parts"] for row in rows) / len(rows),
        "position, mm": 1e3 * median("position_m_x", "position_m_y", "position_m_z"),
        "estimate, mm": 1e3 * median("position_rmse_m_x", "position_rmse_m_y", "position_rmse_m_z"),
        "attitude, deg": median("attitude_rmse_deg_x", "attitude_rmse_deg_y", "attitude_rmse_deg_z"),
        "NEES PKF": median("nees_pkf"),
        "mean": mean("nees_pkf"),
        "NEES AKF": median("nees_akf"),
        "its mean": mean("nees_akf"),
        "propellant, kg": median("propellant_kg"),
        "firings": median("firings"),
        "false alerts": sum(row["false_alerts"] or 0 for row in rows) / len(rows),
    }


def main() -> None:
    """Fly the campaigns and print one row per term."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("cases", type=int, nargs="?", default=200)
    parser.add_argument("scheme", nargs="?", default="scheme-1-paper")
    parser.add_argument("only", nargs="*", help="parts of the names of the terms")
    given = parser.parse_args()
    scenario = load_scenario(given.scheme, (f"dispersions={SET}",)).value
    table_rows = [
        (name, campaign)
        for name, campaign in campaigns(scenario)
        if not given.only or any(text in name for text in given.only)
    ]
    table = Table(title=f"{given.scheme}: {given.cases} cases per term")
    found = [(name, numbers(flown(campaign, given.cases))) for name, campaign in table_rows]
    for column in ("term", *found[0][1]):
        table.add_column(column, justify="left" if column == "term" else "right")
    for name, values in found:
        table.add_row(name, *(f"{value:.3g}" for value in values.values()))
    Console(width=190).print(table)


if __name__ == "__main__":
    main()
