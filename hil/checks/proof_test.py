"""Record of the periodic test of emergency stop, safety chain and brakes, next to the rig file, with its due date."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from hil.checks.signed_record import read_signed, write_signed
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.core.operator_keys import OperatorKey
from hil.errors import BadInput

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
