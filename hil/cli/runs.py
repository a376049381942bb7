"""``hil runs``: the catalogue of recorded runs as people and programs read it."""

from __future__ import annotations

import sqlite3
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil.cli.output import check_json_path, write_json
from hil.cli.text_table import columns
from hil.errors import BadInput, Problem
from hil.recording.catalogue import NAME, Catalogue, RecordingFilter
from hil.recording.utc import utc_text

_FOLDER = "recordings"


def runs_command(
    folder: str | None, failed: bool, passed: bool, scenario: str | None, since: str | None, json_path: str | None
) -> int:
    """Do ``hil runs``; return its exit code. Raises BadInput."""
    problems = check_json_path("--json", json_path)
    if failed and passed:
        problems.append(Problem("--failed", "", "does not go together with --passed"))
    if problems:
        raise BadInput(problems)
    wanted = RecordingFilter(failed, passed, scenario, _begin(since))
    catalogue = Catalogue(_folder(folder))
    try:
        entries = catalogue.runs(wanted)
    except sqlite3.Error as error:
        raise BadInput.single(str(catalogue.path), "", f"cannot be read: {error}") from error
    if json_path is not None:
        write_json({"catalogue": str(catalogue.path), "runs": entries}, json_path)
    if json_path != "-":
        _print(entries, catalogue.path)
    return 0


def _folder(given: str | None) -> Path:
    if given is not None:
        return Path(given).parent if Path(given).name == NAME else Path(given)
    for folder in (Path(_FOLDER), Path()):
        if (folder / NAME).is_file():
            return folder
    text = f"neither {_FOLDER}/{NAME} nor ./{NAME} is there: give the folder that hil run --record wrote to"
    raise BadInput.single("hil runs", "", text)


def _begin(since: str | None) -> str | None:
    """Return ``since`` as the catalogue writes times."""
    if since is None:
        return None
    try:
        moment = datetime.fromisoformat(since)
    except ValueError as error:
        raise BadInput.single("--since", "", f"{since}: must be a date, 2026-11-01 or 2026-11-01T14:30") from error
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return utc_text(round(moment.timestamp() * 1e9))


_HEAD = ("begun, UTC", "scenario", "rig", "seed", "verdict", "ready", "propellant", "position rmse", "file")


def _print(entries: list[dict[str, Any]], path: Path) -> None:
    rows = [
        (
            entry["started_utc"][:19].replace("T", " "),
            entry["scenario"],
            Path(entry["rig"]).stem,
            str(entry["seed"]),
            _verdict(entry),
            _with_unit(entry["ready_time_s"], ".2f", "s"),
            _with_unit(entry["propellant_kg"], ".3f", "kg"),
            _with_unit(entry["position_rmse_mm"], ".2f", "mm"),
            Path(entry["file"]).name,
        )
        for entry in entries
    ]
    lines = columns(_HEAD, rows, frozenset({0, 1, 2, 4, 8})) if rows else []
    number = "1 run" if len(entries) == 1 else f"{len(entries)} runs"
    for line in (f"{number} in {path}", *lines):
        print(line)  # noqa: T201


def _verdict(entry: dict[str, Any]) -> str:
    if entry["passed"] is None:
        return str(entry["state"])
    if entry["passed"]:
        return "pass"
    return "fail" if entry["stop"] == "completed" else "safe stop"


def _with_unit(value: float | None, form: str, unit: str) -> str:
    return "-" if value is None else f"{value:{form}} {unit}"
