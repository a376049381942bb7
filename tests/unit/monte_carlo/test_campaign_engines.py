"""Batches that are flown in parts, put together again; workers of a cluster with another program, or none."""

from __future__ import annotations

import logging
import math
import subprocess
import sys
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hil.core import program_digest
from hil.errors import CampaignStopped
from hil.parts.campaigns import engines
from hil.parts.campaigns.batch import Spec
from hil.parts.campaigns.engines import _PART, DaskEngine, _Parts, run_batch_of


def test_parts_of_a_batch_are_joined_in_the_order_of_the_cases_whichever_is_done_first() -> None:
    first, count = 150, 3 * _PART + 1
    parts = _Parts((first, count))
    borders = list(parts.borders)
    assert borders == [first, first + _PART, first + 2 * _PART, first + 3 * _PART]
    rows = {at: [{"case": case} for case in range(at, min(at + _PART, first + count))] for at in borders}
    for at in (borders[3], borders[1], borders[2]):
        assert parts.put(at, rows[at]) is None
    whole = parts.put(borders[0], rows[borders[0]])
    assert whole is not None
    assert [row["case"] for row in whole] == list(range(first, first + count))


class Cluster:
    """Client of a cluster whose workers have the programs in ``workers``."""

    def __init__(self, workers: dict[str, dict[str, str]]) -> None:
        self.workers = workers
        self.scheduler = SimpleNamespace(identity=lambda **_: {"workers": self.workers})
        self.status = "running"

    def sync(self, call: Any, *arguments: Any, callback_timeout: float, **options: Any) -> Any:
        assert callback_timeout > 0.0
        return call(*arguments, **options)

    def _run(self, function: Any, *arguments: Any, workers: list[str], on_error: str) -> dict[str, dict[str, str]]:
        assert function(*arguments) == program_digest.program()  # as the workers would call it
        return {worker: self.workers[worker] for worker in workers}


def engine_of(workers: dict[str, dict[str, str]]) -> DaskEngine:
    engine = object.__new__(DaskEngine)
    engine._client, engine._address, engine._known = Cluster(workers), "tcp://x:1", set()
    engine._program, engine._idle_since_s = program_digest.program(), math.inf
    return engine


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"digest": "0"}, "its hil .* is another program: digest 0 "),
        ({"python": "3.99"}, r"python 3.99 \(here 3"),
        ({"digest": "none"}, "the package hil-bench is not installed there"),
    ],
)
def test_worker_with_another_program_is_refused_by_name(change: dict[str, str], words: str) -> None:
    same = program_digest.program()
    with pytest.raises(CampaignStopped, match=f"^worker tcp://b:2 is refused: .*{words}"):
        engine_of({"tcp://a:1": same, "tcp://b:2": same | change})._check_workers()
    engine_of({"tcp://a:1": same})._check_workers()


def test_campaign_without_workers_warns_and_ends(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for name, value in (("_ASK_EVERY_S", 0.01), ("_IDLE_FIRST_S", 0.02), ("_IDLE_EACH_S", 0.1), ("_IDLE_LAST_S", 0.2)):
        monkeypatch.setattr(engines, name, value)
    with (
        caplog.at_level(logging.WARNING, "hil"),
        pytest.raises(CampaignStopped, match=r"^scheduler tcp://x:1: no worker for 0.2 s: completed cases are kept"),
    ):
        engine_of({})._next(SimpleQueue())
    assert 1 <= len(caplog.records) <= 2
    assert "no worker: the campaign waits, 0.2 s at most" in caplog.text


def test_batch_is_not_run_by_another_program() -> None:
    spec = Spec("{}", "{}", 0, 1.0)
    for program, digest in ((program_digest.program() | {"digest": "0"}, spec.scenario_digest), ({}, "0")):
        with pytest.raises(ValueError, match="another"):
            run_batch_of(program or program_digest.program(), digest, spec, 0, 1)


def test_identity_needs_no_more_than_an_interpreter(tmp_path: Path) -> None:
    text = Path(program_digest.__file__).read_text(encoding="utf-8")
    command = [sys.executable, "-I", "-S", "-c", f"{text}\nprint(program()['digest'])"]
    assert subprocess.check_output(command, text=True, cwd=tmp_path).strip() == "none"
    (tmp_path / "hil").mkdir()
    (tmp_path / "hil" / "a.py").write_text("1")
    first = program_digest._digest(str(tmp_path / "hil"))
    (tmp_path / "hil" / "a.py").write_text("2")
    assert program_digest._digest(str(tmp_path / "hil")) != first


def _flights_loaded() -> int:
    """Return the number of compiled loops in this process."""
    from hil.loop.compiled.run_cycles import run_cycles

    return len(cast(Any, run_cycles).overloads)


def test_worker_has_the_kernels_of_the_process_that_forks_it() -> None:
    with engines._pool(1) as pool:
        assert pool.submit(_flights_loaded).result() > 0
