"""Placement of recorded runs in the cases of a campaign: which outcomes are outside, and by how much.

If the simulation is true to the rig, a run is one more case: each of n + 1 ranks among the cases is equally probable,
and an outcome is outside all n cases with a probability of 2 / (n + 1).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from hil.core.files import CONFIG_BYTES, parse_json, read_text
from hil.core.messages import Array
from hil.errors import BadInput, one_line
from hil.params.ready import ROW_NAMES
from hil.parts.campaigns.explain import Cases
from hil.parts.campaigns.requirements_page import EvidenceRow, campaign_rows, run_row
from hil.parts.campaigns.stored_campaign import StoredCampaign

_AXES: Final = "xyz"
_NAVIGATION: Final = ("position_rmse_m", "velocity_rmse_mps", "attitude_rmse_deg")
_SECURITY: Final = ("corridor_margin_m", "closing_margin_mps", "nearest_m")
_CONSISTENCY: Final = ("nees_pkf", "nees_akf")
RUN_OUTCOMES: Final = (
    "accepted", "passed", "ready_time_s", "propellant_kg", "firings", *_CONSISTENCY, *_SECURITY,
    *(f"{name}_{axis}" for name in (*ROW_NAMES, *_NAVIGATION) for axis in _AXES),
)  # fmt: skip
"""Columns of a campaign that a recorded run has too, if it got far enough."""


def outcomes_of(summary: Mapping[str, Any]) -> dict[str, float]:
    """Return the outcomes of a run, by the columns of a campaign; summary: as in ``hil run --json``."""
    ready, navigation, thrusters = (summary.get(key) or {} for key in ("ready_phase", "navigation", "thrusters"))
    security = (summary.get("verdict") or {}).get("security") or {}
    outcomes = {
        "accepted": summary.get("accepted"),
        "passed": summary.get("passed"),
        "ready_time_s": summary.get("ready_time_s"),
        "propellant_kg": thrusters.get("propellant_kg"),
    }
    outcomes |= {name: navigation.get(name) for name in _CONSISTENCY}
    outcomes |= {name: security.get(name) for name in _SECURITY}
    if "thruster_firings" in thrusters:
        outcomes["firings"] = sum(thrusters["thruster_firings"])
    for names, table in ((ROW_NAMES, ready), (_NAVIGATION, navigation)):
        for name in names:
            outcomes |= {f"{name}_{axis}": value for axis, value in zip(_AXES, table.get(name) or (), strict=False)}
    return {name: float(value) for name, value in outcomes.items() if isinstance(value, int | float)}


def place(value: float, cases: Array) -> dict[str, Any]:
    """Return the place of a run's outcome among the ``cases`` (n,), nan without an outcome; None if there are none.

    percentile: of the cases below it. p_value: probability of a rank as extreme. outside: by how much it is beyond all
    cases, in widths of their range from 5 to 95 %; 0 inside.
    """
    finite = cases[np.isfinite(cases)]
    n = len(finite)
    if n == 0:
        return {"value": value, "cases": 0, "percentile": None, "p_value": None, "outside": None}
    below, equal = int(np.count_nonzero(finite < value)), int(np.count_nonzero(finite == value))
    tail = min(below + equal, n - below) + 1
    low, high = np.percentile(finite, (5.0, 95.0))
    beyond = max(0.0, value - float(finite.max()), float(finite.min()) - value)
    width = float(high - low)
    return {
        "value": value,
        "cases": n,
        "percentile": 100.0 * (below + 0.5 * equal) / n,
        "p_value": min(1.0, 2.0 * tail / (n + 1)),
        "outside": beyond / width if width > 0.0 else (0.0 if beyond == 0.0 else None),
    }


def place_run(summary: Mapping[str, Any], folder: Path) -> dict[str, dict[str, Any]]:
    """Return the place of each outcome of a run in the finished campaign of ``folder``. Raises BadInput."""
    campaign, cases, scenario = StoredCampaign(folder), Cases(folder, "--campaign"), summary.get("scenario")
    if not campaign.is_sample:
        raise BadInput.single("--campaign", "", f"{folder}: its cases are no sample of the scenario")
    if campaign.scenario != scenario:
        text = f"{folder}: is a campaign of {campaign.scenario}, the recording one of {scenario}"
        raise BadInput.single("--campaign", "", text)
    outcomes = outcomes_of(summary).items()
    shared = {name: value for name, value in outcomes if name in cases.table.column_names}
    return {name: place(value, np.asarray(cases.column(name), dtype=float)) for name, value in shared.items()}


class RecordedRun(NamedTuple):
    """Evidence of a recording: kind of the rig, summary, and digest of the scenario."""

    kind: str
    summary: Mapping[str, Any]
    scenario_digest: str


def evidence_of_runs(runs: Mapping[str, RecordedRun], folder: Path) -> tuple[str, dict[str, Any], list[EvidenceRow]]:
    """Return scenario, sources and evidence of a campaign with requirements in ``folder`` and of recorded runs.

    runs: by the names of the recordings. Raises BadInput, also for a run of another scenario than the campaign's.
    """
    campaign, path = StoredCampaign(folder), folder / "summary.json"
    try:
        summary: Any = parse_json(read_text(path, CONFIG_BYTES))
        requirements = list(summary["requirements"])
    except (BadInput, ValueError, TypeError, KeyError) as error:
        raise BadInput.single("--campaign", "", f"{path}: no requirements: {one_line(str(error), 200)}") from error
    if not requirements:
        raise BadInput.single("--campaign", "", f"{folder}: its scenario has no [[requirements]]")
    sources: dict[str, Any] = {"campaign": folder.name, "seed": campaign.seed, "digest": campaign.digest}
    rows = campaign_rows(requirements, sources)
    for name, (kind, run, digest) in runs.items():
        for what, own, expected in (
            ("scenario", run.get("scenario"), campaign.scenario),
            ("scenario digest", digest, campaign.scenario_digest or "of an earlier version"),
        ):
            if own != expected:
                text = f"{name}: {what} {own}, that of the campaign is {expected}"
                raise BadInput.single("--campaign", "", text)
        outcomes = outcomes_of(run)
        evidence = f"{name}, rig {run.get('rig', '-')}, seed {run.get('seed', '-')}"
        verdict = "accepted" if run.get("accepted") else "not accepted"
        sources[name] = f"rig {run.get('rig', '-')}, seed {run.get('seed', '-')}, {run.get('stop', '-')}, {verdict}"
        comparable = [each for each in requirements if each["column"] in RUN_OUTCOMES]
        rows += [run_row(each, kind, evidence, outcomes.get(each["column"])) for each in comparable]
    return campaign.scenario, sources, rows
