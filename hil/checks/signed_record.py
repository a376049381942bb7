"""Signed records of a rig: of its preflight, and of the proof test of its emergency stop."""

from __future__ import annotations

import datetime
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from hil.checks.compatibility import requires_sign_off
from hil.config.load import Loaded
from hil.config.motion_digest import motion_digest
from hil.config.rig import Rig
from hil.core.files import KIB, parse_json, read_text, write_text
from hil.core.operator_keys import OperatorKey, Signature
from hil.errors import BadInput, Problem

_SIGNATURE: Final = ("by", "key", "seal")
_BYTES: Final = 64 * KIB


def write_signed(record: Mapping[str, Any], path: Path, by: OperatorKey | str) -> None:
    """Write ``record`` with its signature to ``path``. by: key, or a name that nothing proves. Raises BadInput."""
    signed = {**record, **asdict(Signature.of(by, _sealed(record)))}
    write_text(json.dumps(signed, indent=1) + "\n", path)


def read_signed(path: Path) -> dict[str, Any]:
    """Return the record at ``path`` with its signature. Raises BadInput."""
    try:
        record = parse_json(read_text(path, _BYTES))
    except ValueError as error:
        raise BadInput.single(str(path), "", f"not JSON: {error}") from error
    if not isinstance(record, dict) or not all(isinstance(record.get(name), str) for name in _SIGNATURE):
        raise BadInput.single(str(path), "", "not a signed record: by, key and seal are missing")
    return record


def signature_of(record: Mapping[str, Any]) -> tuple[Signature, list[Any]]:
    """Return the signature of a record, and the values that it seals."""
    return Signature(*(record[name] for name in _SIGNATURE)), _sealed(record)


def _sealed(record: Mapping[str, Any]) -> list[Any]:
    return sorted([key, value] for key, value in record.items() if key not in _SIGNATURE)


VALID_S: Final = 3600.0
MEASURED_S: Final = 60.0
"""Shortest measurement of the lateness."""
_RATE_TOLERANCE: Final = 1e-6


def record_path(rig: Loaded[Rig]) -> Path:
    """Return the file of the record: ``lab.preflight.json`` next to ``lab.toml``."""
    return Path(rig.source).with_suffix(".preflight.json")


def write_record(rig: Loaded[Rig], rate_hz: float, measured_s: float, passed: bool, by: OperatorKey | str) -> None:
    """Write the record of a preflight of hardware. Raises BadInput if it cannot be written.

    rate_hz: of the loop. measured_s: duration of the measurement of the lateness, s. by: key of
    the operator, or a name that nothing proves.
    """
    record = {
        "unix_time_s": time.time(),
        "digest": motion_digest(rig.value),
        "rate_hz": rate_hz,
        "measured_s": measured_s,
        "passed": passed,
    }
    write_signed(record, record_path(rig), by)


def check_preflight(rig: Loaded[Rig], step_s: float, now_unix_s: float | None = None) -> list[Problem]:
    """Return a problem if hardware has no passed preflight of the last hour for this rig and period.

    A waived sign-off waives it too; rigs that are not hardware need none.
    """
    if not requires_sign_off(rig.value):
        return []
    reason = _gap(rig, step_s, time.time() if now_unix_s is None else now_unix_s)
    advice = f"run hil preflight --rig {rig.source} --devices"
    return [Problem(str(record_path(rig)), "preflight", f"{reason}: {advice}")] if reason else []


def _gap(rig: Loaded[Rig], step_s: float, now_unix_s: float) -> str:
    path = record_path(rig)
    if not path.exists():
        return "is missing"
    try:
        record = read_signed(path)
        age_s, measured_s = now_unix_s - float(record["unix_time_s"]), float(record["measured_s"])
        digest, passed, rate_hz = record["digest"], record["passed"], float(record["rate_hz"])
    except (BadInput, ValueError, LookupError, TypeError):
        return "cannot be read"
    if passed is not True:
        return "has failed"
    if not 0.0 <= age_s <= VALID_S:
        return f"is {age_s / 60.0:.0f} min old, allowed {VALID_S / 60.0:.0f} min"
    if not measured_s >= MEASURED_S:
        return f"measured the lateness for {measured_s:g} s, required {MEASURED_S:g} s"
    if digest != motion_digest(rig.value):
        return "is of another configuration of this rig"
    if abs(rate_hz * step_s - 1.0) > _RATE_TOLERANCE:
        return f"is for {rate_hz:g} Hz, the scenario has {1.0 / step_s:g} Hz"
    return ""


DUE_DAYS_MAX: Final = 366
"""Longest time between two tests, days."""
DUE_DAYS: Final = 90
"""Time until the next test unless it is chosen, days."""
_DAY_S: Final = 86_400.0


def proof_path(rig_file: str) -> Path:
    """Return the file of the record: ``lab.proof.json`` next to ``lab.toml``."""
    return Path(rig_file).with_suffix(".proof.json")


def write_proof(rig_file: str, now_unix_s: float, due_days: int, tested: Sequence[str], by: OperatorKey | str) -> Path:
    """Write the record of a passed test, and return its path. tested: its results. Raises BadInput."""
    path = proof_path(rig_file)
    record = {"unix_time_s": now_unix_s, "due_unix_s": now_unix_s + due_days * _DAY_S, "tested": list(tested)}
    write_signed(record, path, by)
    return path


def proof_gap(rig: Loaded[Rig], now_unix_s: float) -> tuple[str, str]:
    """Return why the bench needs a test now, "" if it does not, and the dates of its record."""
    path = proof_path(rig.source)
    if not path.exists():
        return "no record", f"{path.name} is missing"
    try:
        record = read_signed(path)
        made_s, due_s = float(record["unix_time_s"]), float(record["due_unix_s"])
        text = f"{_day(made_s)} by {record['by']}, due {_day(due_s)}"
    except (BadInput, ValueError, LookupError, TypeError, OverflowError, OSError):
        return "unreadable", f"{path.name} cannot be read"
    if not made_s <= now_unix_s <= made_s + DUE_DAYS_MAX * _DAY_S:
        return "not of the last year", text
    return ("overdue", text) if now_unix_s > due_s else ("", text)


def _day(unix_s: float) -> str:
    return datetime.datetime.fromtimestamp(unix_s, datetime.UTC).date().isoformat()
