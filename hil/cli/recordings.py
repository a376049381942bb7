"""``hil recordings list``: the catalogue of recorded runs."""

from __future__ import annotations

import sqlite3
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from hil.cli.options import File, Flag
from hil.cli.output import deliver, print_columns, write_json
from hil.core.part import commands_of, provided
from hil.errors import BadInput

_FOLDER = "recordings"
_ACTS = ("operator", "setting", "fault", "order")
"""Kinds of the log's lines that are acts of people."""

_UNCHANGED = "rewritten, content unchanged: "
_UNKNOWN = "rewritten, log unchanged, its other messages state no digest: "

app = App(name="recordings")


@app.command(name="list", help="List the recorded runs of a folder.")
def list_recordings(
    folder: Annotated[str | None, Parameter(name=("--record", "--folder"))] = None,
    *,
    failed: Flag = False,
    passed: Flag = False,
    scenario: str | None = None,
    since: str | None = None,
    json: File = None,
) -> int:
    """List the recorded runs of a folder.

    Parameters
    ----------
    folder
        Recordings folder (default: ./recordings, else .).
    failed
        Only runs that were not accepted: verdict fail, safe-stopped, truncated.
    passed
        Only runs that were accepted: verdict pass.
    scenario
        Only runs of the scenario of this name.
    since
        Only runs started then or later: 2026-11-01, or 2026-11-01T14:30, UTC.
    json
        File for the entries, - for standard output.
    """
    if failed and passed:
        raise BadInput.single("--failed", "", "does not go together with --passed")

    from hil.recording.catalogue import Catalogue, RecordingFilter

    catalogue = Catalogue(_folder(folder))
    try:
        entries = catalogue.runs(RecordingFilter(failed, passed, scenario, _begin(since)))
    except sqlite3.Error as error:
        raise BadInput.single(str(catalogue.path), "", f"cannot be read: {error}") from error
    deliver({"catalogue": str(catalogue.path), "runs": entries}, json, lambda: _print(entries, catalogue.path))
    return 0


def _folder(given: str | None) -> Path:
    from hil.recording.catalogue import NAME

    if given is not None:
        return Path(given).parent if Path(given).name == NAME else Path(given)
    for folder in (Path(_FOLDER), Path()):
        if (folder / NAME).is_file():
            return folder
    text = f"neither {_FOLDER}/{NAME} nor ./{NAME} exists: give the folder of hil run --record"
    raise BadInput.single("hil recordings list", "", text)


def _begin(since: str | None) -> str | None:
    """Return ``since`` in the catalogue's time format."""
    if since is None:
        return None
    from hil.core.clock import utc_text

    try:
        moment = datetime.fromisoformat(since)
    except ValueError as error:
        raise BadInput.single("--since", "", f"{since}: must be a date, 2026-11-01 or 2026-11-01T14:30") from error
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return utc_text(round(moment.timestamp() * 1e9))


_HEAD = ("started, UTC", "scenario", "rig", "seed", "verdict", "ready", "propellant", "position rmse", "file")


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
    number = "1 run" if len(entries) == 1 else f"{len(entries)} runs"
    print(f"{number} in {path}")  # noqa: T201
    if rows:
        print_columns(_HEAD, rows, left=(0, 1, 2, 4, 8))


def _verdict(entry: dict[str, Any]) -> str:
    if entry["accepted"] is None:
        return str(entry["state"])
    if entry["accepted"]:
        return "pass"
    return "fail" if entry["stop"] == "completed" else "safe stop"


def _with_unit(value: float | None, form: str, unit: str) -> str:
    return "-" if value is None else f"{value:{form}} {unit}"


@app.command(name="verify", help="Verify the audits of recorded runs, and add them to a campaign's evidence.")
def verify_recordings(
    recordings: Annotated[list[str], Parameter(negative=())],
    /,
    *,
    campaign: str | None = None,
    out: str | None = None,
    json: File = None,
) -> int:
    """Verify the audits of recorded runs: who did what, with what rights, in which configuration, and no change since.

    Exit code 1 if an audit was changed, shortened or reordered, or is absent. With --campaign and sound audits, write
    requirements.html, .xml and .json with the evidence of the campaign and of the runs, step by step. The verdict is
    FAIL, with exit code 1, if a requirement is not verified by the campaign or violated in a run. It is OPEN, with exit
    code 0, as long as a step has no evidence, and PASS if all steps are verified.

    Parameters
    ----------
    recordings
        Files of hil run --record, on the mock, emulated or hardware rig.
    campaign
        Results folder of a campaign of the same scenario, which has [[requirements]].
    out
        Folder for the files, instead of the campaign's.
    json
        File for the audits, or for the evidence, - for standard output.
    """
    if out is not None and campaign is None:
        raise BadInput.single("--out", "", "requires --campaign")

    audits = [_audit(Path(name), json == "-") for name in recordings]
    if campaign is None or any(audit["problems"] for audit in audits):
        write_json({"audits": audits}, json)
        return int(any(audit["problems"] for audit in audits))
    status: int = provided("evidence of recordings", "--campaign")(recordings, campaign, out, json)
    return status


def _audit(path: Path, quiet: bool) -> dict[str, Any]:
    """Verify and print the audit of the recording at ``path``; return it for JSON."""
    from hil.core.arithmetic import why_bits_may_differ
    from hil.recording.audit import audit_problems
    from hil.recording.foxglove import LOG_TOPIC
    from hil.recording.parts import later_parts
    from hil.recording.read import contents, ordered_log
    from hil.recording.verify import content_problems
    from hil.recording.writer import SUMMARY

    recording = contents(path, frozenset({LOG_TOPIC}))
    log = ordered_log(recording)
    files = {name: text for name, text in recording.files.items() if name != SUMMARY}
    content = content_problems((path, *later_parts(path)))
    problems = audit_problems(path, recording.run, recording.end, files, log) + (content or [])
    problems += [recording.problem] if recording.problem else []
    origin = "" if not recording.rewritten else _UNKNOWN if content is None else _UNCHANGED
    acts = [
        {key: line.get(key) for key in ("bench_s", "name", "key", "rights", "message", "configuration")}
        for line in log
        if line.get("kind") in _ACTS
    ]
    if not quiet:
        head = ("bench time", "who", "key", "rights", "what")
        keys = ("name", "key", "rights", "message")
        cells = [(_with_unit(act["bench_s"], ".2f", "s"), *(str(act[key] or "") for key in keys)) for act in acts]
        print_columns(head, cells, left=(1, 2, 3, 4))
        for problem in problems:
            print(f"{path}: {problem}")  # noqa: T201
        if note := why_bits_may_differ(recording.run):
            print(f"{path}: {note}")  # noqa: T201
        digest = log[-1].get("digest", "") if log else ""
        verdict = f"FAIL audit of {path.name}: " if problems else f"PASS audit of {path.name}: {origin}"
        print(f"{verdict}{len(log)} entries, last digest {digest}")  # noqa: T201
    return {
        "recording": str(path),
        "entries": len(log),
        "problems": problems,
        "rewritten": recording.rewritten,
        "acts": acts,
    }


for _name, _command in commands_of("recordings").items():
    app.command(_command.path, name=_name, help=_command.summary)
