"""The folder of a campaign: nothing lost, nothing doubled, nothing mixed."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hil.errors import BadInput, CampaignStopped
from hil.monte_carlo.outcome import failed_row
from hil.monte_carlo.store import BATCH, Store

IDENTITY = {"scenario": "scheme-1", "seed": 0}


def put(store: Store, first: int, count: int) -> None:
    """Keep made-up rows of these cases."""
    store.put(
        first, [{"case": k, "seed": k, "a": 0.5 * k, **failed_row("made up")} for k in range(first, first + count)]
    )


def test_only_batches_that_are_whole_count_as_done(tmp_path: Path) -> None:
    store = Store(tmp_path / "c", IDENTITY, ["a"])
    assert store.missing(120) == [(0, BATCH), (50, BATCH), (100, 20)]
    put(store, 50, BATCH)
    (tmp_path / "c" / "parts" / "0000000000.parquet.part").write_bytes(b"half")
    (tmp_path / "c" / "parts" / "0000000100.parquet").write_bytes(b"PAR1 cut")
    store.close()
    again = Store(tmp_path / "c", IDENTITY, ["a"])
    assert again.missing(120) == [(0, BATCH), (100, 20)]
    assert not list((tmp_path / "c" / "parts").glob("*.part"))


def test_finished_table_has_every_case_once_and_in_order(tmp_path: Path) -> None:
    store = Store(tmp_path / "c", IDENTITY, ["a"])
    for first, count in reversed(store.missing(120)):
        put(store, first, count)
    store.finish(120)
    assert store.column("case").tolist() == list(range(120))
    assert store.column("a").tolist() == [0.5 * k for k in range(120)]


def test_finished_campaign_can_be_made_longer(tmp_path: Path) -> None:
    store = Store(tmp_path / "c", IDENTITY, ["a"])
    for first, count in store.missing(120):
        put(store, first, count)
    store.finish(120)
    store.close()
    again = Store(tmp_path / "c", IDENTITY, ["a"])
    assert again.missing(120) == []
    assert again.missing(160) == [(100, BATCH), (150, 10)]
    put(again, 100, BATCH)
    put(again, 150, 10)
    again.finish(160)
    assert again.column("case").tolist() == list(range(160))


def test_folder_of_another_campaign_is_refused(tmp_path: Path) -> None:
    Store(tmp_path / "c", IDENTITY, ["a"]).close()
    with pytest.raises(BadInput, match=r'holds another campaign.*scenario "scheme-1".*"scheme-2"'):
        Store(tmp_path / "c", IDENTITY | {"scenario": "scheme-2"}, ["a"])
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    with pytest.raises(BadInput, match="is not empty and holds no campaign"):
        Store(tmp_path / "full", IDENTITY, ["a"])


def test_full_disk_stops_cleanly_and_keeps_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path / "c", IDENTITY, ["a"])
    put(store, 0, BATCH)

    def no_room(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as full:
        full.setattr(os, "fsync", no_room)
        with pytest.raises(CampaignStopped, match="No space left on device"):
            put(store, 50, BATCH)
    assert not list((tmp_path / "c" / "parts").glob("*.part"))
    store.close()
    assert Store(tmp_path / "c", IDENTITY, ["a"]).missing(100) == [(50, BATCH)]


def test_folder_belongs_to_one_campaign_at_a_time(tmp_path: Path) -> None:
    with Store(tmp_path / "c", IDENTITY, ["a"]) as store:
        with pytest.raises(BadInput, match="another campaign is running in it"):
            Store(tmp_path / "c", IDENTITY, ["a"])
        put(store, 0, BATCH)  # which takes nothing from the first
    assert Store(tmp_path / "c", IDENTITY, ["a"]).missing(BATCH) == []


def test_disk_that_is_full_from_the_start_stops_cleanly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_room(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as full:
        full.setattr(Path, "mkdir", no_room)
        with pytest.raises(CampaignStopped, match="No space left on device"):
            Store(tmp_path / "c", IDENTITY, ["a"])
