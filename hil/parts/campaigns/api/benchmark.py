"""A fixed set of campaigns that any GNC can fly: scenarios, dispersion sets and single faults."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from hil.api.jobs import job_of
from hil.errors import BadInput
from hil.parts.campaigns.api.campaign_results import Campaign
from hil.parts.campaigns.api.campaigns import campaign
from hil.parts.campaigns.benchmark_page import above_table_v
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.explain import Cases
from hil.parts.campaigns.statistics import paired_rates, percentiles

CHASERS: Final = (
    "cubesat", "mango", "dart", "astro", "progress", "cygnus", "dragon", "htv", "orion", "station",
)  # fmt: skip
"""Vehicles of 6 kg to 400 t on the plan of scheme-1, by mass."""
SCENARIOS: Final = (
    "scheme-1", "scheme-2", "scheme-3", "scheme-1-printed", "leo-vbar", "geo", "inspection", "departure", "limit-cycle",
    "tumbling-1", "tumbling-3", "tumbling-5", "far-approach", "transfer",
    "shuttle-vbar", "torva", "ets-vii", "atv", "apollo", *CHASERS,
)  # fmt: skip
RESULT: Final = "benchmark.json"
_CYCLES: Final = 5000
_TIMED: Final = 3


class Row(NamedTuple):
    """A campaign of the set. name: also the name of its folder. faults: tables as in ``[[faults]]``."""

    name: str
    scenario: str
    dispersions: str | None = None
    faults: tuple[dict[str, Any], ...] = ()


class Ideal(NamedTuple):
    """Errors taken away from a row. settings: overrides. undispersed: tables of the dispersions that are left out."""

    settings: dict[str, Any]
    undispersed: tuple[str, ...]


_SENSORS: Final = Ideal(
    {
        "vmu.sigma_position_m": 1e-5,
        "vmu.sigma_angle_deg": 1e-4,
        "imu.gyro_noise_degps": 0.0,
        "imu.gyro_drift_noise_degps2": 0.0,
        "imu.accelerometer_noise_mps2": 0.0,
        "imu.accelerometer_bias_noise_mps3": 0.0,
        "gnc.navigation.budget.vision_bias_sigma_m": [0.0, 0.0, 0.0],
        "gnc.navigation.budget.vision_misalignment_sigma_deg": 0.0,
        "gnc.navigation.budget.vision_scale_sigma": 0.0,
        "gnc.navigation.budget.vision_noise_scale_sigma": 0.0,
        "gnc.navigation.budget.vision_correlated_fraction": 0.0,
    },
    ("vmu", "imu", "gnc"),
)
_ACTUATORS: Final = Ideal(
    {
        "truth.misalignment_sigma_deg": 0.0,
        "truth.force_scatter_sigma": 0.0,
        "truth.centre_of_mass_offset_m": [0.0, 0.0, 0.0],
    },
    ("chaser", "truth"),
)
IDEALS: Final = {
    "sensors": _SENSORS,
    "actuators": _ACTUATORS,
    "both": Ideal(_SENSORS.settings | _ACTUATORS.settings, _SENSORS.undispersed + _ACTUATORS.undispersed),
}
"""What physics leaves of a miss: perfect sensors, with the errors of the bench, and perfect thrusters and masses."""


def _fault(device: str, kind: str, at_s: float, **rest: Any) -> tuple[dict[str, Any], ...]:
    return ({"device": device, "kind": kind, "at_s": at_s, **rest},)


ROWS: Final = (
    *(Row(name, name) for name in SCENARIOS),
    *(Row(f"{name}-data-sheet", name, "data-sheet") for name in ("scheme-1", "scheme-2")),
    *(Row(f"{name}-stress", name, "stress") for name in ("scheme-1", "scheme-2", "leo-vbar", "geo")),
    *(Row(f"tumbling-{n}-stress", f"tumbling-{n}", "tumbling-stress") for n in (1, 3, 5)),
    Row("vision-lost", "scheme-1", faults=_fault("vmu", "no_pose", 100.0, until_s=105.0)),
    Row("vision-offset", "scheme-1", faults=_fault("vmu", "offset", 100.0, value=[0.0, 0.1, 0.0])),
    Row("imu-lost", "scheme-1", faults=_fault("imu", "dropout", 100.0, until_s=105.0)),
    Row("thruster-dead", "scheme-1", faults=_fault("thruster.3", "stuck_closed", 60.0)),
    Row("thruster-open", "scheme-1", faults=_fault("thruster.3", "stuck_open", 60.0)),
)
"""The set; with a single fault a GNC is to end without coming nearer than the keep-out and without misleading."""


def rows_of(only: str) -> list[Row]:
    """Return the rows whose name matches the pattern ``only``. Raises BadInput if there is none."""
    rows = [row for row in ROWS if fnmatchcase(row.name, only)]
    if not rows:
        names = ", ".join(row.name for row in ROWS)
        raise BadInput.single("--only", "", f"{only!r:.60}: matches no row, allowed: a pattern for {names}")
    return rows


def fly(
    rows: Iterable[Row],
    runs: int,
    out: str | Path,
    seed: int = 0,
    overrides: dict[str, Any] | None = None,
    workers: int = 0,
    progress: Callable[[str], object] = lambda _: None,
    ideal: bool = False,
) -> dict[str, Any]:
    """Return the numbers of the rows, each of ``runs`` cases, kept in folders under ``out``, where they are resumed.

    overrides: the GNC, by the keys of a scenario, as ``{"gnc.control.backend": "law.py:lqr"}``. progress: called with
    the name of each row. ideal: rows with cases that are not accepted, or a deviation above the paper's Table V, are
    flown again with each of ``IDEALS``. Raises BadInput.
    """
    table, given = [], overrides or {}
    for row in rows:
        progress(row.name)
        numbers = _fly_row(row, runs, Path(out) / row.name, seed, given, workers)
        if ideal and (numbers["accepted"]["passed"] < runs or above_table_v(numbers)):
            for name, without in IDEALS.items():
                label = f"{row.name}, perfect {name}"
                progress(label)
                again = _fly_row(row, runs, Path(out) / f"{row.name}-ideal-{name}", seed, given, workers, without)
                numbers.setdefault("ideal", {})[name] = again | {"row": label, "scenario": row.scenario}
        table.append({"row": row.name, "scenario": row.scenario} | numbers)
    progress("cost of a cycle")
    return {"gnc": given, "runs": runs, "seed": seed, "cycle_us": cycle_us(given), "rows": table}


def _fly_row(
    row: Row, runs: int, out: Path, seed: int, given: dict[str, Any], workers: int, without: Ideal | None = None
) -> dict[str, Any]:
    """Return the numbers of a row, flown with the GNC ``given``; ``without`` some errors."""
    overrides = given | ({"faults": list(row.faults)} if row.faults else {})
    if row.dispersions is not None:
        overrides["dispersions"] = row.dispersions
    if without is None:
        return numbers_of(campaign(row.scenario, runs, out, seed, overrides=overrides, workers=workers))
    scenario = job_of(row.scenario, "mock", overrides | without.settings, 0, None).scenario.value
    spread = scenario.dispersions.model_copy(update={table: {} for table in without.undispersed})
    return numbers_of(campaign(scenario.model_copy(update={"dispersions": spread}), runs, out, seed, workers=workers))


def numbers_of(flown: Campaign) -> dict[str, Any]:
    """Return the numbers of one campaign; shares with Wilson's 95 % interval."""
    flags = {key: flown.summary["pass_rate"][key] for key in ("accepted", "passed", "passed_all_parts")}
    propellant, share = flown.column("propellant_kg"), flown.column("propellant_share")
    return flags | {
        "propellant_kg": _spread(propellant),
        "propellant_over_least": _spread(share),
        "propellant_over_bound": _spread(flown.column("propellant_over_bound")),
        "control_margin": _spread(flown.column("control_margin")),
        "firings": _spread(flown.column("firings")),
        "decision_errors": int(np.count_nonzero(flown.column("decision_error"))),
        "misleading": int(np.count_nonzero(flown.column("hmi_cycles"))),
        "false_alerts": int(np.count_nonzero(flown.column("false_alerts"))),
        "aborts": int(np.count_nonzero(flown.column("abort") != "")),
        "nearest_m": float(np.nanmin(flown.column("nearest_m"))),
        "worst": flown.summary["worst"],
    }


def _spread(values: Any) -> dict[str, float | int | None]:
    cut = percentiles(values)
    return {"p5": cut.get("p5"), "median": cut.get("p50"), "p95": cut.get("p95")}


def cycle_us(overrides: dict[str, Any]) -> float:
    """Return the processor time of a cycle of scheme 1 with plant and mock devices, us: the least of three."""
    job = job_of("scheme-1", "mock", overrides, 0, None)
    scenario, rig = job.scenario.value, job.rig.value
    runner, times = CaseRunner(scenario, rig, _CYCLES * scenario.step_s), []
    for seed in range(_TIMED + 1):
        start = time.process_time()
        runner.run(scenario, seed)
        times.append(time.process_time() - start)
    return 1e6 * min(times[1:]) / _CYCLES


def compare(first: Path, second: Path, rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Return, for each row that both folders hold, the cases that only one of two GNCs has flown to acceptance.

    Cases of one number have the same dispersions and noise. Raises BadInput if no row is in both, or seed or number of
    cases differ.
    """
    table = []
    for row in rows:
        if not (second / row.name).is_dir():
            continue
        here, there = (Cases(folder / row.name, "--against") for folder in (first, second))
        for name, mine, theirs in (
            ("seed", here.identity["seed"], there.identity["seed"]),
            ("runs", here.table.num_rows, there.table.num_rows),
        ):
            if mine != theirs:
                text = f"{there.folder}: has {name} {theirs}, this one {mine}: cases can only be paired if equal"
                raise BadInput.single("--against", "", text)
        rates = paired_rates(here, there, "accepted")
        both = here.column("accepted") & there.column("accepted")
        saved = (there.column("propellant_kg") - here.column("propellant_kg"))[both]
        table.append(
            {
                "row": row.name,
                "cases": len(both),
                "only_first": rates["first_alone"],
                "only_second": rates["second_alone"],
                "saved_kg": float(np.median(saved)) if len(saved) else None,
            }
        )
    if not table:
        raise BadInput.single("--against", "", f"{second}: holds no row of this benchmark")
    return table
