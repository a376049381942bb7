"""Catalogue of runs: an embedded database in the folder of the recordings, safe with several writers."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hil.core.surroundings import temporary_folder
from hil.errors import BadInput

NAME: Final = "catalogue.sqlite"
VERSION: Final = 1
RUNNING, DONE, BROKEN_OFF = "running", "done", "broken off"
"""States of an entry."""

_LOCK_TIMEOUT_S: Final = 20.0  # wait for another writer
_RETRY_S: Final = 0.02
_TABLE: Final = """
CREATE TABLE IF NOT EXISTS runs (
    run TEXT PRIMARY KEY,
    state TEXT NOT NULL,
    started_utc TEXT NOT NULL,
    ended_utc TEXT,
    scenario TEXT NOT NULL,
    rig TEXT NOT NULL,
    seed INTEGER NOT NULL,
    duration_s REAL NOT NULL,
    passed INTEGER,
    passed_all_parts INTEGER,
    stop TEXT,
    ready_time_s REAL,
    propellant_kg REAL,
    position_rmse_mm REAL,
    attitude_rmse_deg REAL,
    cycles INTEGER,
    dropped INTEGER,
    file TEXT NOT NULL,
    hil TEXT NOT NULL,
    host TEXT NOT NULL,
    process TEXT NOT NULL,
    summary TEXT
)
"""
_AUDITS: Final = "CREATE TABLE IF NOT EXISTS audits (run TEXT PRIMARY KEY, entries INTEGER, digest TEXT)"
COLUMNS: Final = (
    "run",
    "state",
    "started_utc",
    "ended_utc",
    "scenario",
    "rig",
    "seed",
    "duration_s",
    "accepted",
    "passed",
    "passed_all_parts",
    "stop",
    "ready_time_s",
    "propellant_kg",
    "position_rmse_mm",
    "attitude_rmse_deg",
    "cycles",
    "dropped",
    "file",
    "hil",
)
"""Columns that are reported."""
_ENTRIES: Final = """
SELECT *, coalesce(json_extract(summary, '$.accepted'), passed_all_parts) AS accepted
FROM runs ORDER BY started_utc, run
"""
"""Whether a run was accepted is in its summary; of runs of earlier versions all parts were required."""


@dataclass(frozen=True)
class RecordingFilter:
    """Selection of runs. failed: not accepted, safe-stopped or broken off; since: ISO time or its start, UTC."""

    failed: bool = False
    passed: bool = False
    scenario: str | None = None
    since: str | None = None


class Catalogue:
    """Database in ``folder``. Raises BadInput if it cannot be used, sqlite3.Error if a write fails."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME

    @contextmanager
    def _connection(self, begin: str = "BEGIN IMMEDIATE") -> Iterator[sqlite3.Connection]:
        """Yield a connection with a transaction, by default with an exclusive writer; an exception rolls it back."""
        connection = sqlite3.connect(self.path, timeout=_LOCK_TIMEOUT_S, isolation_level=None)
        try:
            connection.row_factory = sqlite3.Row
            self._prepare(connection)
            connection.execute(begin)
            try:
                yield connection
            except BaseException:
                connection.execute("ROLLBACK")
                raise
            connection.execute("COMMIT")
        finally:
            connection.close()

    def _prepare(self, connection: sqlite3.Connection) -> None:
        try:
            version = connection.execute("PRAGMA user_version").fetchone()[0]
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                raise
            raise BadInput.single(str(self.path), "", f"not a catalogue of runs: {error}") from error
        if version == VERSION:
            return
        if version != 0:
            text = f"a catalogue of version {version}; this program reads version {VERSION}"
            raise BadInput.single(str(self.path), "", text)
        _enable_write_ahead_log(connection)
        connection.execute("BEGIN IMMEDIATE")
        connection.execute(_TABLE)
        connection.execute(f"PRAGMA user_version={VERSION}")
        connection.execute("COMMIT")

    def begin(self, entry: dict[str, Any]) -> None:
        """Enter the start of a run; ``entry``: run, started_utc, scenario, rig, seed, duration_s, file, hil."""
        whole = entry | {"state": RUNNING, "host": socket.gethostname(), "process": process_now()}
        names, places = ", ".join(whole), ", ".join(f":{name}" for name in whole)
        with self._connection() as connection:
            connection.execute(f"INSERT INTO runs ({names}) VALUES ({places})", whole)

    def end(
        self, run: str, ended_utc: str, state: str, cycles: int | None, dropped: int, summary: dict[str, Any]
    ) -> None:
        """Enter the end of ``run``; summary: as in ``hil run --json``, empty if there is none."""
        row = {
            "run": run,
            "state": state,
            "ended_utc": ended_utc,
            "cycles": cycles,
            "dropped": dropped,
            "summary": json.dumps(summary, allow_nan=False) if summary else None,
            **_key_numbers(summary),
        }
        changes = ", ".join(f"{name} = :{name}" for name in row if name != "run")
        with self._connection() as connection:
            connection.execute(f"UPDATE runs SET {changes} WHERE run = :run", row)

    def enter_audit(self, run: str, entries: int, digest: str) -> None:
        """Enter the length and the last digest of the audit of ``run``."""
        with self._connection() as connection:
            connection.execute(_AUDITS)
            connection.execute("INSERT OR IGNORE INTO audits VALUES (?, ?, ?)", (run, entries, digest))

    def audit(self, run: str) -> tuple[int, str] | None:
        """Return the length and the last digest of the audit of ``run``, None if there is no such entry."""
        if not self.path.is_file():
            return None
        try:
            with self._connection("BEGIN") as connection:
                row = connection.execute("SELECT entries, digest FROM audits WHERE run = ?", (run,)).fetchone()
        except sqlite3.OperationalError:  # of an earlier version
            return None
        return None if row is None else (row["entries"], row["digest"])

    def runs(self, selection: RecordingFilter = RecordingFilter()) -> list[dict[str, Any]]:
        """Return the selected entries, oldest first, by ``COLUMNS``, with the path of the file."""
        if not self.path.is_file():
            raise BadInput.single(str(self.path), "", "no such catalogue: hil run ... --record FOLDER creates one")
        try:
            rows = self._rows()
        except sqlite3.OperationalError:
            rows = self._rows_of_copy()
        entries = [self._entry(row) for row in rows]
        return [entry for entry in entries if _fits(entry, selection)]

    def _rows(self) -> list[sqlite3.Row]:
        with self._connection("BEGIN") as connection:
            return connection.execute(_ENTRIES).fetchall()

    def _rows_of_copy(self) -> list[sqlite3.Row]:
        """Return the rows from a copy elsewhere: SQLite reads none on a disk that is full or read-only."""
        with temporary_folder("catalogue", in_memory=True) as folder:
            for suffix in ("", "-wal"):  # the newest rows may be in the second one only
                source = self.path.with_name(f"{NAME}{suffix}")
                if source.is_file():
                    shutil.copyfile(source, Path(folder) / source.name)
            return Catalogue(Path(folder))._rows()

    def _entry(self, row: sqlite3.Row) -> dict[str, Any]:
        entry = {name: row[name] for name in COLUMNS}
        entry["file"] = str(self.path.parent / row["file"])
        for name in ("accepted", "passed", "passed_all_parts"):
            entry[name] = None if entry[name] is None else bool(entry[name])
        if entry["state"] == RUNNING and row["host"] == socket.gethostname() and not _lives(row["process"]):
            entry["state"] = BROKEN_OFF
        return entry


def _enable_write_ahead_log(connection: sqlite3.Connection) -> None:
    """Switch to write-ahead logging; SQLite ignores the timeout of the connection if two processes do so at once."""
    give_up_s = time.monotonic() + _LOCK_TIMEOUT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
            return
        except sqlite3.OperationalError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(_RETRY_S)


def _key_numbers(summary: dict[str, Any]) -> dict[str, Any]:
    if not summary:
        return {}
    navigation = summary["navigation"]
    rms = {}
    for name, scale, unit in (("position_rmse_m", 1e3, "mm"), ("attitude_rmse_deg", 1.0, "deg")):
        axes = navigation[name]
        key = f"{name.rpartition('_')[0]}_{unit}"
        rms[key] = None if axes is None else scale * sum(value**2 for value in axes) ** 0.5
    return {
        "passed": summary["passed"],
        "passed_all_parts": summary["passed_all_parts"],
        "stop": summary["stop"],
        "ready_time_s": summary["ready_time_s"],
        "propellant_kg": summary["thrusters"]["propellant_kg"],
        **rms,
    }


def _fits(entry: dict[str, Any], criteria: RecordingFilter) -> bool:
    failed = entry["accepted"] is False or entry["state"] == BROKEN_OFF
    return (
        (not criteria.failed or failed)
        and (not criteria.passed or entry["accepted"] is True)
        and (criteria.scenario is None or entry["scenario"] == criteria.scenario)
        and (criteria.since is None or entry["started_utc"] >= criteria.since)
    )


def process_now() -> str:
    """Return the identity of this process on this host: its number and start time."""
    return f"{os.getpid()} {_started(os.getpid())}"


def _lives(process: str) -> bool:
    number, _, started = process.partition(" ")
    return number.isdecimal() and _started(int(number)) == started


def _started(pid: int) -> str:
    """Return the kernel's start time of a process and its boot, "" if it has ended."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""
    fields = stat.rpartition(")")[2].split()
    return "" if fields[0] in "ZX" else f"{fields[19]} {boot}"
