"""Integrity under faults: campaigns in which each case has one fault, or two, of the threat model, sims/threats.toml.

    python sims/integrity_campaign.py [CASES [SCHEME ...]] [--monitor] [--without-guard] [--pairs] [--workers N]

Prints, by kind of fault: cases, how many were detected and how fast, by whom, cases with misleading cycles, the nearest
distance to the target, and how many cases came nearer than the keep-out. CASES: of each scheme, 1000 unless given.
--monitor: with the docking monitor and its faults (sensor set A), otherwise without (B). --without-guard: without the
bench guard, whose safe stops end a case before the navigation can mislead for long. --pairs: two faults at once.
--picture FILE: draw the Stanford diagram of the cases.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from hil.config.load import Loaded, load_rig, load_scenario
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.faults import TimedFault
from hil.parts.campaigns.batch import Rows, Spec
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.dispersions import Design, case_seed, drawn_fault
from hil.parts.campaigns.engines import LocalEngine
from hil.parts.campaigns.figure import stanford_figure
from hil.parts.campaigns.outcome import row_of

THREATS: Final = Path(__file__).with_name("threats.toml")
WITHOUT_GUARD: Final = ("rig.guard.enabled=false", "rig.rails.following_error_max_m=0.5")
_BATCH: Final = 50
_SECOND: Final = 0x2FA  # key of the random stream of second faults


def with_threats(scheme: str, monitor: bool = False) -> Scenario:
    """Return the scenario ``scheme`` whose campaign draws one fault per case from the threat model.

    monitor: with the docking monitor, as a statistical model, and its faults.
    """
    scenario = load_scenario(scheme, ("monitor.source=model",) if monitor else ()).value
    table, threats = scenario.model_dump(mode="json"), tomllib.loads(THREATS.read_text())
    threats["draw"] = [draw for draw in threats["draw"] if monitor or draw["device"] != "monitor"]
    table["dispersions"]["faults"] = threats
    return Scenario.model_validate_json(json.dumps(table))


def flown(scheme: str, cases: int, workers: int, seed: int = 0, monitor: bool = False, guard: bool = True) -> Rows:
    """Return the rows of the campaign of ``scheme`` with the threat model."""
    scenario = with_threats(scheme, monitor)
    spec = Spec.of(scenario, _rig(guard), seed, scenario.duration_s)
    batches = [(first, min(_BATCH, cases - first)) for first in range(0, cases, _BATCH)]
    engine, rows = LocalEngine(workers), []
    try:
        for _, part in track(engine.run(spec, batches), scheme, len(batches), transient=True):
            rows += part
    finally:
        engine.close()
    return sorted(rows, key=lambda row: row["case"])


def _rig(guard: bool) -> Rig:
    return load_rig("mock", () if guard else WITHOUT_GUARD).value


@lru_cache(maxsize=1)
def _pairs_of(scheme: str, seed: int, monitor: bool, guard: bool) -> tuple[Design, CaseRunner]:
    scenario = with_threats(scheme, monitor)
    loaded = Loaded(scenario, scheme, {})
    return Design(loaded, seed), CaseRunner(scenario, _rig(guard), scenario.duration_s)


def pair(scheme: str, seed: int, monitor: bool, guard: bool, case: int) -> dict[str, Any]:
    """Return the row of ``case`` with its fault and a second one; its columns of a fault are those of the first."""
    design, runner = _pairs_of(scheme, seed, monitor, guard)
    truth, told = design.apply(design.values(case), design.fault(case))
    scenario = runner.scenario
    second = drawn_fault(
        scenario.dispersions.faults,
        len(scenario.chaser.thrusters.position_m),
        np.random.SeedSequence(seed, spawn_key=(_SECOND, case)),
    )
    truth = truth.model_copy(update={"faults": (*truth.faults, TimedFault.model_validate(second, strict=False))})
    if design.touches_gnc:
        runner.set_gnc_scenario(told)
    stats, stop = runner.run(truth, case_seed(seed, case))
    return {"case": case, **row_of(stats, stop, told, truth)}


def flown_in_pairs(
    scheme: str, cases: int, workers: int, seed: int = 0, monitor: bool = False, guard: bool = True
) -> Rows:
    """Return the rows of the campaign of ``scheme`` with two faults per case."""
    one = partial(pair, scheme, seed, monitor, guard)
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        return list(track(pool.map(one, range(cases), chunksize=10), scheme, cases, transient=True))


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
    table = Table(title=f"{scheme}: {len(rows)} cases")
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
    for name in ("--monitor", "--without-guard", "--pairs"):
        parser.add_argument(name, action="store_true")
    parser.add_argument("--picture")
    given = parser.parse_args()
    flown_cases: Rows = []
    for scheme in given.schemes:
        fly = flown_in_pairs if given.pairs else flown
        rows = fly(scheme, given.cases, given.workers, monitor=given.monitor, guard=not given.without_guard)
        flown_cases += rows
        Console(width=150).print(table_of(scheme, rows, load_scenario(scheme).value.keep_out.radius_m))
    if given.picture:
        stanford_figure(lambda name: [row[name] for row in flown_cases]).savefig(given.picture, dpi=80)


if __name__ == "__main__":
    main()
