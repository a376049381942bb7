"""Integrity under single faults: campaigns in which each case has one fault of the threat model, sims/threats.toml.

    python sims/integrity_campaign.py [CASES [SCHEME ...]] [--workers N]

Prints, by kind of fault: cases, how many were detected and how fast, by whom, cases with misleading cycles, the nearest
distance to the target, and how many cases came nearer than the keep-out. CASES: of each scheme, 1000 unless given.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from collections import defaultdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.monte_carlo.batch import Rows, Spec
from hil.monte_carlo.engines import LocalEngine

THREATS: Final = Path(__file__).with_name("threats.toml")
_BATCH: Final = 50


def with_threats(scheme: str) -> Scenario:
    """Return the scenario ``scheme`` whose campaign draws one fault per case from the threat model."""
    scenario = load_scenario(scheme).value
    table = scenario.model_dump(mode="json")
    table["dispersions"]["faults"] = tomllib.loads(THREATS.read_text())
    return Scenario.model_validate_json(json.dumps(table))


def flown(scheme: str, cases: int, workers: int, seed: int = 0) -> Rows:
    """Return the rows of the campaign of ``scheme`` with the threat model."""
    scenario = with_threats(scheme)
    spec = Spec.of(scenario, load_rig("mock").value, seed, scenario.duration_s)
    batches = [(first, min(_BATCH, cases - first)) for first in range(0, cases, _BATCH)]
    engine, rows = LocalEngine(workers), []
    try:
        for _, part in track(engine.run(spec, batches), scheme, len(batches), transient=True):
            rows += part
    finally:
        engine.close()
    return sorted(rows, key=lambda row: row["case"])


def by_kind(rows: Rows) -> dict[str, Rows]:
    """Return the rows of each kind of fault."""
    found: dict[str, Rows] = defaultdict(list)
    for row in rows:
        device = row["fault_device"]
        family = "axis" if device.startswith(("rails", "turntable")) else device.partition(".")[0]
        found[f"{family} {row['fault_kind']}"].append(row)
    return dict(sorted(found.items()))


def numbers(rows: Rows, keep_out_m: float) -> dict[str, Any]:
    """Return the numbers of one kind of fault, or of all."""
    took = [row["detected_s"] - row["fault_at_s"] for row in rows if row["detected_s"] is not None]
    by = [row["detected_by"] for row in rows if row["detected_by"]]
    nearest = [row["nearest_m"] for row in rows if row["nearest_m"] is not None]
    return {
        "cases": len(rows),
        "detected": len(took),
        "median_s": float(np.median(took)) if took else None,
        "by": ", ".join(f"{name} {by.count(name)}" for name in sorted(set(by))),
        "misleading": sum(bool(row["hmi_cycles"]) for row in rows),
        "hmi_cycles": int(sum(row["hmi_cycles"] or 0 for row in rows)),
        "nearest_m": min(nearest, default=None),
        "inside": sum(value < keep_out_m for value in nearest),
        "passed": sum(row["passed"] for row in rows),
    }


def table_of(scheme: str, rows: Rows, keep_out_m: float) -> Table:
    """Return the table of ``rows``."""
    table = Table(title=f"{scheme}: {len(rows)} cases with one fault each")
    for name in ("fault", "cases", "detected", "median, s", "by", "misleading", "HMI cycles", "nearest, m", "inside",
                 "passed"):  # fmt: skip
        table.add_column(name, justify="left" if name in ("fault", "by") else "right")
    for name, part in {**by_kind(rows), "all": rows}.items():
        found = numbers(part, keep_out_m)
        texts = (f"{found[key]:.2f}" if found[key] is not None else "" for key in ("median_s", "nearest_m"))
        median, nearest = texts
        table.add_row(
            name, str(found["cases"]), str(found["detected"]), median, found["by"], str(found["misleading"]),
            str(found["hmi_cycles"]), nearest, str(found["inside"]), str(found["passed"]),
        )  # fmt: skip
    return table


def main() -> None:
    """Fly the campaigns and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("cases", type=int, nargs="?", default=1000)
    parser.add_argument("schemes", nargs="*", default=["scheme-1", "scheme-2"])
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    for scheme in given.schemes:
        rows = flown(scheme, given.cases, given.workers)
        Console(width=150).print(table_of(scheme, rows, load_scenario(scheme).value.keep_out.radius_m))


if __name__ == "__main__":
    main()
