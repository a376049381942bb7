"""Audit of a recording: its log is numbered, names who did what with what rights, and is chained by SHA-256.

The chain begins with the header and the configuration of the recording. Its length and last digest are in the end of
the file and in the catalogue. ``audit_problems`` finds an entry that was changed, removed, inserted or moved, a changed
configuration, and a shortened log. A user who may write file and catalogue can write another chain: only a copy of the
last digest elsewhere finds that.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from hil.errors import BadInput
from hil.recording.catalogue import Catalogue

AUDIT, VERSION = "audit", "1"
"""Key of the header of a recording whose log is an audit, and its value."""
ENTRIES, DIGEST = "audit_entries", "audit_digest"
"""Keys of the end of a recording."""
CHAINED: Final = ("number", "t_s", "bench_s", "cycle", "kind", "name", "key", "rights", "configuration", "message")
"""Keys of a line of the log that its digest covers."""


class Actor(NamedTuple):
    """Who acts. key: of ``OperatorKey``, "" for a name that nothing proves; rights: with which."""

    name: str
    key: str = ""
    rights: str = ""


class AuditSummary(NamedTuple):
    """Number of entries, and last digest."""

    entries: int
    digest: str


@dataclass
class AuditChain:
    """Chain of one recording. configuration: digest of the one in force."""

    configuration: str = ""
    digest: str = ""
    entries: int = 0

    @classmethod
    def begin(cls, run: Mapping[str, str], files: Mapping[str, str]) -> AuditChain:
        """Return the chain of a recording with the header ``run`` and the attachments ``files``."""
        configuration = _sha256(sorted(files.items()))
        return cls(configuration, _sha256([sorted(run.items()), configuration]))

    def change(self, setting: str) -> None:
        """Take over a changed setting, ``key=value``."""
        self.configuration = _sha256([self.configuration, setting])

    def link(self, line: Mapping[str, Any]) -> str:
        """Return the digest of the next line of the log, which has all of ``CHAINED``."""
        self.digest = _sha256([self.digest, [line[key] for key in CHAINED]])
        self.entries += 1
        return self.digest

    @property
    def summary(self) -> AuditSummary:
        return AuditSummary(self.entries, self.digest)


def audit_problems(
    path: Path,
    run: Mapping[str, str],
    end: Mapping[str, str] | None,
    files: Mapping[str, str],
    log: list[dict[str, Any]],
) -> list[str]:
    """Return what is wrong with the audit of the recording at ``path``: a line each, none for a complete chain.

    run, end, files: its header, end and attachments, without those of the end. log: its lines, as recorded.
    """
    if run.get(AUDIT) != VERSION:
        return ["has no audit: recorded by an earlier version, or removed"]
    chain = AuditChain.begin(run, files)
    problems: list[str] = []
    for index, line in enumerate(log):
        if line.get("kind") == "setting":
            chain.change(str(line.get("message")))
        problem = _entry_problem(chain, line, index)
        if problem:
            problems.append(problem)
            break  # all later digests differ as well
    return problems or _end_problems(path, run, end, chain)


def _entry_problem(chain: AuditChain, line: Mapping[str, Any], index: int) -> str:
    if any(key not in line for key in (*CHAINED, "digest")):
        return f"entry {index}: is no entry of an audit"
    if line["number"] != index:
        return f"entry {index}: is number {line['number']}: entries were removed, inserted, moved or lost"
    text = str(line["message"])
    if line["configuration"] != chain.configuration:
        return f"entry {index}, {text!r}: is of another configuration than the recorded one"
    if chain.link(line) != line["digest"]:
        content = "header, configuration or entry" if index == 0 else "entry"
        return f"entry {index}, {text!r}: the {content} was changed"
    return ""


def _end_problems(path: Path, run: Mapping[str, str], end: Mapping[str, str] | None, chain: AuditChain) -> list[str]:
    if end is None or ENTRIES not in end:
        return [f"ends after entry {chain.entries - 1} without an end of the audit: broken off, or shortened"]
    stated = AuditSummary(int(end[ENTRIES]) if end[ENTRIES].isdecimal() else -1, end.get(DIGEST, ""))
    if stated != chain.summary:
        return [f"has {chain.entries} entries, its end states {end[ENTRIES]}: shortened, or its end was changed"]
    try:
        listed = Catalogue(path.parent).audit(run.get("run", ""))
    except BadInput as error:
        return [f"cannot be compared with the catalogue: {error}"]
    if listed is not None and listed != chain.summary:
        return [f"is another audit than the catalogue's, which has {listed[0]} entries and the digest {listed[1]}"]
    return []


def _sha256(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, separators=(",", ":"), allow_nan=False).encode()).hexdigest()
