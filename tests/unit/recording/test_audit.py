"""Audit of a recording: each change of log, header, configuration or end is found."""

from __future__ import annotations

import copy
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.recording.audit import DIGEST, ENTRIES, AuditChain, audit_problems
from hil.recording.catalogue import Catalogue

RUN = {"run": "20260301T000000Z-scheme-1", "audit": "1", "seed": "7"}
FILES = {"scenario.json": '{"a":1}', "rig.json": '{"b":2}'}
TEXTS = ("started this run", "arm", "gnc.control.deadband_m=0.004", "start", "stop: rejected", "stop", "abort")


class Evidence:
    """A recording with an audit, as ``audit_problems`` gets it."""

    def __init__(self) -> None:
        self.run, self.files, chain = dict(RUN), dict(FILES), AuditChain.begin(RUN, FILES)
        self.log: list[dict[str, Any]] = []
        for number, text in enumerate(TEXTS):
            kind = "setting" if "=" in text else "operator"
            if kind == "setting":
                chain.change(text)
            line = {"number": number, "t_s": None, "bench_s": 0.1 + number, "cycle": -1, "kind": kind, "name": "ann"}
            line |= {"key": "ab" * 8, "rights": "command", "configuration": chain.configuration, "message": text}
            self.log.append({**line, "digest": chain.link(line), "level": 2})
        self.end: dict[str, str] | None = {"stop": "x", ENTRIES: str(chain.entries), DIGEST: chain.digest}

    def problems(self, folder: Path = Path("/nonexistent")) -> list[str]:
        return audit_problems(folder / "run.mcap", self.run, self.end, self.files, self.log)

    def relink(self) -> None:
        """Write another chain over the changed log, and its end, with full knowledge of the format."""
        chain = AuditChain.begin(self.run, self.files)
        for number, line in enumerate(self.log):
            if line["kind"] == "setting":
                chain.change(line["message"])
            line |= {"number": number, "configuration": chain.configuration}
            line["digest"] = chain.link(line)
        self.end = {**(self.end or {}), ENTRIES: str(chain.entries), DIGEST: chain.digest}


def test_untouched_audit_is_sound() -> None:
    assert Evidence().problems() == []


@pytest.mark.parametrize("key", ["number", "t_s", "bench_s", "cycle", "kind", "name", "key", "rights", "configuration",
                                 "message", "digest"])  # fmt: skip
def test_edited_entry_is_found_whatever_was_edited(key: str) -> None:
    for place in range(len(TEXTS)):
        evidence = Evidence()
        was = evidence.log[place][key]
        evidence.log[place][key] = f"{was}x" if isinstance(was, str) else 77
        (problem,) = evidence.problems()
        assert problem.startswith(f"entry {place}"), problem


def test_missing_additional_moved_and_inserted_entries_are_detected() -> None:
    dice = random.Random(3)
    for _ in range(200):
        evidence = Evidence()
        log, (i, j) = evidence.log, sorted(dice.sample(range(len(TEXTS)), 2))
        match dice.choice(("remove", "double", "swap", "shorten", "begin", "foreign")):
            case "remove":
                del log[i]
            case "double":
                log.insert(j, copy.deepcopy(log[i]))
            case "swap":
                log[i], log[j] = log[j], log[i]
            case "shorten":
                del log[j:]
            case "begin":
                del log[:j]
            case "foreign":
                log.insert(i, {"kind": "event", "message": "x"})
        assert len(evidence.problems()) == 1


def test_changed_header_configuration_or_end_is_found() -> None:
    evidence = Evidence()
    evidence.run["seed"] = "8"
    assert evidence.problems() == ["entry 0, 'started this run': the header, configuration or entry was changed"]
    evidence = Evidence()
    evidence.files["rig.json"] = '{"b":3}'
    assert "another configuration" in evidence.problems()[0]
    evidence = Evidence()
    assert evidence.end is not None
    evidence.end[ENTRIES] = "6"
    assert evidence.problems() == ["has 7 entries, its end states 6: shortened, or its end was changed"]
    evidence.end = None
    assert "without an end of the audit: broken off, or shortened" in evidence.problems()[0]
    del evidence.run["audit"]
    assert evidence.problems() == ["has no audit: recorded by an earlier version, or removed"]


def test_rewritten_chain_differs_from_the_catalogue(tmp_path: Path) -> None:
    evidence = Evidence()
    assert evidence.end is not None
    Catalogue(tmp_path).enter_audit(RUN["run"], int(evidence.end[ENTRIES]), evidence.end[DIGEST])
    assert evidence.problems(tmp_path) == []
    evidence.log[3]["name"] = "bob"
    evidence.relink()
    assert evidence.problems() == []
    assert "is another audit than the catalogue's, which has 7 entries" in evidence.problems(tmp_path)[0]
    Catalogue(tmp_path).enter_audit(RUN["run"], 7, evidence.end[DIGEST])  # the first entry stays
    assert evidence.problems(tmp_path)


def test_numbers_of_an_entry_are_those_of_the_row_to_the_last_bit() -> None:
    chain = AuditChain()
    line = Evidence().log[0] | {"bench_s": float(np.nextafter(1.0, 2.0))}
    assert chain.link(line) != AuditChain().link(line | {"bench_s": 1.0})
