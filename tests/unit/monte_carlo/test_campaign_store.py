"""The folder of a campaign: nothing lost, nothing doubled, nothing mixed."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hil.errors import BadInput, CampaignStopped
from hil.parts.campaigns.outcome import failed_row
from hil.parts.campaigns.store import BATCH, Store

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
    for path, reason in (("thesis.txt", "is no folder"), ("thesis.txt/c", "Not a directory")):
        with pytest.raises(BadInput, match=f"full/{path}: {reason}$"):
            Store(tmp_path / "full" / path, IDENTITY, ["a"])


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


def whole(folder: Path, identity: dict[str, object] = IDENTITY, runs: int = 150) -> list[Path]:
    """Return the parts of a campaign whose batches are all done."""
    with Store(folder, dict(identity), ["a"]) as store:
        for first, count in store.missing(runs):
            put(store, first, count)
    return sorted((folder / "parts").glob("*.parquet"))


def missing(folder: Path, runs: int = 150) -> tuple[list[tuple[int, int]], list[str]]:
    """Return the batches that a new start runs again, and its warnings."""
    lines: list[str] = []
    with Store(folder, IDENTITY, ["a"], lines.append) as store:
        return store.missing(runs), lines


def test_part_with_any_flipped_bit_is_run_again_with_a_line_or_holds_the_same_rows(tmp_path: Path) -> None:
    (part,) = whole(tmp_path / "c", runs=BATCH)
    sound = part.read_bytes()
    lines: list[str] = []
    flipped = range(0, len(sound), 409)
    with Store(tmp_path / "c", IDENTITY, ["a"], lines.append) as store:
        rows = store._read_part(0)
        for at in flipped:
            part.write_bytes(sound[:at] + bytes([sound[at] ^ 1 << at % 8]) + sound[at + 1 :])
            before = len(lines)
            if store.missing(BATCH):
                (line,) = lines[before:]
                assert f"{part.name}: run again: " in line
            else:
                assert lines[before:] == []
                assert store._read_part(0) == rows  # the bit carries nothing
    assert len(lines) > 0.5 * len(flipped)


def test_part_in_the_place_of_another_is_run_again(tmp_path: Path) -> None:
    first, second, _ = whole(tmp_path / "c")
    second.write_bytes(first.read_bytes())
    found, lines = missing(tmp_path / "c")
    assert found == [(50, BATCH)]
    assert len(lines) == 1


def test_part_of_another_campaign_is_run_again(tmp_path: Path) -> None:
    foreign = whole(tmp_path / "other", IDENTITY | {"seed": 1})[1]
    own = whole(tmp_path / "c")[1]
    own.write_bytes(foreign.read_bytes())
    assert missing(tmp_path / "c")[0] == [(50, BATCH)]


def test_part_without_identity_or_with_too_few_cases_is_run_again(tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    first, second, third = whole(tmp_path / "c")
    table = pq.read_table(first)
    pq.write_table(table.replace_schema_metadata(None), first)
    pq.write_table(pq.read_table(second).slice(0, 10), second)
    third.unlink()
    third.mkdir()
    found, lines = missing(tmp_path / "c")
    assert found == [(0, BATCH), (50, BATCH), (100, BATCH)]
    assert len(lines) == 2


def test_damaged_or_other_table_is_run_again(tmp_path: Path) -> None:
    for folder, identity in (("c", IDENTITY), ("other", IDENTITY | {"seed": 1})):
        with Store(tmp_path / folder, identity, ["a"]) as store:
            for first, count in store.missing(150):
                put(store, first, count)
            store.finish(150)
    table, foreign = (tmp_path / name / "cases.parquet" for name in ("c", "other"))
    sound = table.read_bytes()
    every = [(0, BATCH), (50, BATCH), (100, BATCH)]
    for at in (100, len(sound) // 2, len(sound) - 20):
        table.write_bytes(sound[:at] + bytes([sound[at] ^ 1]) + sound[at + 1 :])
        found, lines = missing(tmp_path / "c")
        assert (found == every and len(lines) == 1) or not found
        for part in (tmp_path / "c" / "parts").glob("*.parquet"):
            part.unlink()
    table.write_bytes(foreign.read_bytes())
    line = f"{table}: cases are run again: does not carry the identity of this campaign"
    assert missing(tmp_path / "c") == (every, [line])
