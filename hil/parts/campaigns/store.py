"""Folder of a campaign: its identity, the completed batches, and finally all cases in one Parquet file.

A batch is written to a temporary file that is renamed when it is complete, so a process killed at any moment neither
loses nor duplicates a case. Each batch carries its identity (campaign, first case, count) and a checksum of its rows:
one that is damaged, of another campaign or in the place of another one is run again.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Self

from hil.core.files import CONFIG_BYTES, MIB, check_regular, parse_json, read_text, replaced
from hil.core.surroundings import lock
from hil.errors import BadInput, CampaignStopped, one_line
from hil.parts.campaigns.outcome import COUNTS, FLAGS, MARGINS, NUMBERS, TEXTS

BATCH: Final = 50
"""Cases per batch: on fixed borders, so that the files do not depend on the engine."""
_GROUP: Final = 100 * BATCH  # cases per row group of the finished table
MANIFEST: Final = "campaign.json"
TABLE: Final = "cases.parquet"
PARTS: Final = "parts"
GIVEN: Final = "given"
"""Key of the manifest: names of scenario and rig, and settings."""
_LOCK: Final = "campaign.lock"
_IDENTITY: Final = b"hil.campaign"
"""Key of the metadata of a part (campaign, first case, count, checksum of the rows) and of the table (campaign)."""
_PART_BYTES: Final = 16 * MIB
_TABLE_BYTES: Final = 1 << 40
_REASON: Final = 200  # characters of the library's reason in a line
_DISK_FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)


def parquet() -> tuple[Any, Any]:
    """Return pyarrow and its parquet module."""
    import pyarrow as pa  # slow import
    import pyarrow.parquet as pq

    return pa, pq


def read_table(path: Path, columns: Sequence[str] | None = None) -> Any:
    """Return the table at ``path``, or ``columns`` of it. Raises OSError and what pyarrow raises.

    Read by this thread: pyarrow waits for ever for its own where the host has no memory for them.
    """
    with parquet()[1].ParquetFile(path) as file:
        return file.read(columns=columns, use_threads=False)


def given_in(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return names and settings in ``manifest``, {} for those of Python objects, of an earlier version, or damaged."""
    given = manifest.get(GIVEN)
    if not isinstance(given, dict) or not isinstance(given.get("settings"), list):
        return {}
    names = (given.get("scenario"), given.get("rig"), *given["settings"])
    return given if all(isinstance(name, str) for name in names) else {}


class Store:
    """Results of one campaign in ``folder``. identity: must be the same for a folder to be resumed.

    names: of the dispersions. warn: called with a line for each file that cannot be used. about: kept with the
    identity, and need not be the same. The folder is locked until the store is closed or its process ends. Raises
    BadInput for a folder with other results, or if another campaign is running in it.
    """

    def __init__(
        self,
        folder: Path,
        identity: dict[str, Any],
        names: list[str],
        warn: Callable[[str], None] = lambda _: None,
        about: Mapping[str, Any] | None = None,
    ) -> None:
        self._pa, self._pq = parquet()
        self._warn = warn
        self._digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        self.folder = folder
        self._parts = folder / PARTS
        self.schema = self._pa.schema(
            [
                ("case", self._pa.int64()),
                ("seed", self._pa.int64()),
                *((name, self._pa.float64()) for name in names),
                *((name, self._pa.bool_()) for name in FLAGS),
                *((name, self._pa.int64()) for name in COUNTS),
                *((name, self._pa.string()) for name in TEXTS),
                *((name, self._pa.float64()) for name in (*NUMBERS, *MARGINS)),
            ]
        )
        self._open(identity, about or {})

    @property
    def table_path(self) -> Path:
        return self.folder / TABLE

    def _open(self, identity: dict[str, Any], about: Mapping[str, Any]) -> None:
        manifest = self.folder / MANIFEST
        try:
            if not manifest.is_file() and self.folder.is_dir() and any(map(_is_unknown, self.folder.iterdir())):
                raise BadInput.single("--out", "", f"{self.folder}: is not empty and holds no campaign")
            self.folder.mkdir(parents=True, exist_ok=True)
            self.close = weakref.finalize(self, os.close, self._locked(self.folder / _LOCK))
            if manifest.is_file():
                self._check(manifest, identity, about)
            with atomic_write(manifest) as partial:
                partial.write_text(json.dumps({**identity, **about}, indent=2) + "\n", encoding="utf-8")
            self._parts.mkdir(exist_ok=True)
            for left_over in self._parts.glob("*.part"):
                left_over.unlink()
        except OSError as error:
            _stop_if_full(error, self.folder)
            text = "is no folder" if isinstance(error, FileExistsError) else error.strerror or str(error)
            raise BadInput.single("--out", "", f"{self.folder}: {text}") from error

    def _locked(self, path: Path) -> int:
        """Return the descriptor of the file at ``path``, locked until it is closed; raise BadInput if it is in use."""
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            if not lock(descriptor):
                self._warn(f"{path.parent}: its file system has no locks: start no other campaign in it")
        except OSError as error:
            os.close(descriptor)
            if not isinstance(error, BlockingIOError):
                raise
            text = f"{path.parent}: another campaign is running in it, give another folder or wait"
            raise BadInput.single("--out", "", text) from error
        return descriptor

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check(self, manifest: Path, identity: dict[str, Any], about: Mapping[str, Any]) -> None:
        try:
            stored = parse_json(read_text(manifest, CONFIG_BYTES))
        except (BadInput, ValueError) as error:
            raise BadInput.single("--out", "", f"{manifest}: cannot be read: {error}") from error
        held = stored if isinstance(stored, dict) else {}
        different = [key for key in {**identity, **held} if key != GIVEN and held.get(key) != identity.get(key)]
        if different:
            if GIVEN in held and held[GIVEN] != about.get(GIVEN):
                different = [GIVEN, *(key for key in different if not key.endswith("digest"))]
            text = f"{self.folder}: holds another campaign ({_listed(held, different)}; asked for: "
            text += f"{_listed({**identity, **about}, different)}), give a new folder"
            raise BadInput.single("--out", "", text)

    def missing(self, runs: int) -> list[tuple[int, int]]:
        """Return the batches, first case and count, that are missing for a campaign of ``runs`` cases."""
        self.restore()
        batches = [(first, min(BATCH, runs - first)) for first in range(0, runs, BATCH)]
        return [batch for batch in batches if not self._is_complete(*batch)]

    def _is_complete(self, first: int, count: int) -> bool:
        """Return whether the part of case ``first`` holds ``count`` cases or more; remove one that cannot be used."""
        path = self._part(first)
        if not path.is_file():
            return False
        try:
            return len(self._read_part(first)) >= count
        except (OSError, BadInput, ValueError, LookupError, self._pa.ArrowException) as error:
            self._warn(f"{path}: run again: {one_line(str(error), _REASON)}")
            path.unlink()
            return False

    def rows(self, first: int, count: int) -> list[dict[str, Any]] | None:
        """Return the rows of the batch of case ``first``, None unless it is complete."""
        if not self._is_complete(first, count):
            return None
        rows: list[dict[str, Any]] = self._read_part(first).slice(0, count).to_pylist()
        return rows

    def _part(self, first: int) -> Path:
        return self._parts / f"{first:010d}.parquet"

    def _read_part(self, first: int) -> Any:
        """Return a batch. Raises ValueError for any other rows."""
        path = self._part(first)
        check_regular(path, _PART_BYTES)
        table = read_table(path)
        carried = (table.schema.metadata or {}).get(_IDENTITY)
        if carried is None:
            raise ValueError("carries no identity")
        table = table.select(self.schema.names).cast(self.schema)
        if carried != self._identity_of(table, first):
            raise ValueError("its rows are not those of this campaign and place, or are damaged")
        return table

    def _identity_of(self, table: Any, first: int) -> bytes:
        """Return what a part with the rows of ``table`` carries."""
        cases = table.column("case").to_pylist()
        if cases != list(range(first, first + len(table))):
            raise ValueError(f"its cases are not {first} and following")
        values = [column.to_pylist() for column in table.columns]
        identity = (self._digest, first, len(table), hashlib.sha256(repr(values).encode()).hexdigest())
        return json.dumps(identity).encode()

    def put(self, first: int, rows: list[dict[str, Any]]) -> None:
        """Save a batch. Raises CampaignStopped if the disk is full."""
        columns = {field.name: [row[field.name] for row in rows] for field in self.schema}
        self._write_part(first, self._pa.table(columns, schema=self.schema))

    def _write_part(self, first: int, table: Any) -> None:
        with atomic_write(self._part(first)) as partial:
            carrying = table.replace_schema_metadata({_IDENTITY: self._identity_of(table, first)})
            self._pq.write_table(carrying, partial)

    def finish(self, runs: int) -> Path:
        """Write all ``runs`` cases into one file, in their order; return its path."""
        schema = self.schema.with_metadata({_IDENTITY: self._digest.encode()})
        try:
            with (
                atomic_write(self.table_path) as partial,
                self._pq.ParquetWriter(partial, schema, write_page_checksum=True) as writer,
            ):
                for group in range(0, runs, _GROUP):
                    end = min(runs, group + _GROUP)
                    parts = [self._read_part(first).slice(0, end - first) for first in range(group, end, BATCH)]
                    table = self._pa.concat_tables(parts).replace_schema_metadata(schema.metadata)
                    writer.write_table(table, row_group_size=_GROUP)
        except (BadInput, ValueError, LookupError, self._pa.ArrowException) as error:
            text = f"a part was changed while the campaign ran: run it again: {one_line(str(error), _REASON)}"
            raise CampaignStopped(f"{self.folder}: {text}") from error
        for path in self._parts.glob("*.parquet"):
            path.unlink()
        return self.table_path

    def restore(self) -> None:
        """Split a finished table into batches again: the number of cases may have changed."""
        if not self.table_path.is_file():
            return
        try:
            check_regular(self.table_path, _TABLE_BYTES)
            file = self._pq.ParquetFile(self.table_path, page_checksum_verification=True)
            if (file.schema_arrow.metadata or {}).get(_IDENTITY) != self._digest.encode():
                raise ValueError("does not carry the identity of this campaign")
            for group in range(file.num_row_groups):
                table = file.read_row_group(group, use_threads=False).select(self.schema.names).cast(self.schema)
                for first in range(0, len(table), BATCH):
                    if not self._part(group * _GROUP + first).is_file():
                        self._write_part(group * _GROUP + first, table.slice(first, BATCH))
        except (OSError, BadInput, ValueError, LookupError, self._pa.ArrowException) as error:
            self._warn(f"{self.table_path}: cases are run again: {one_line(str(error), _REASON)}")

    def table(self) -> Any:
        """Return the finished table, one row per case."""
        return read_table(self.table_path)

    def column(self, name: str) -> Any:
        """Return one column of the finished table as a numpy array; null numbers are nan."""
        return read_table(self.table_path, [name]).column(name).to_numpy()


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path that is renamed to ``path`` at the end, or removed on an error."""
    try:
        with replaced(path) as partial:
            yield partial
    except OSError as error:
        _stop_if_full(error, path.parent)
        raise


def _stop_if_full(error: OSError, folder: Path) -> None:
    """Raise CampaignStopped if ``error`` means that the disk is full."""
    if error.errno in _DISK_FULL or "No space" in str(error):
        reason = os.strerror(error.errno) if error.errno in _DISK_FULL else "No space left"
        raise CampaignStopped(f"{folder}: {reason}: completed cases are kept, run it again") from error


def _is_unknown(path: Path) -> bool:
    return path.suffix != ".part" and path.name != _LOCK


def _listed(identity: dict[str, Any], keys: Iterable[str]) -> str:
    """Return the keys that ``identity`` has, with their values."""
    return ", ".join(f"{key} {_short(identity[key])}" if key in identity else f"no {key}" for key in keys)


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 300 else f"{text[:297]}..."
