"""Messages of the console: rows of numbers, decimated if delayed, and one binary packet."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from hil.parts.console.columns import COLUMNS, INDEX, decimated
from hil.parts.console.live_view import BACKLOG, MAX_ROWS, Cursor, RowStore
from hil.parts.console.message import ImageMessage, pack, unpack


def rows(n: int, start: int = 0) -> np.ndarray:
    """Return rows whose first column counts."""
    out = np.zeros((n, COLUMNS), "<f4")
    out[:, 0] = np.arange(start, start + n)
    return out


def test_message_carries_state_rows_and_image_unchanged(rng: np.random.Generator) -> None:
    numbers = rng.standard_normal((5, COLUMNS)).astype("<f4")
    numbers[2, 3] = np.nan
    picture = ImageMessage(
        "left", 1.25, 640, 480, b"\xff\xd8jpeg\xff\xd9", ({"kind": "cross", "at": [1, 2], "good": True},)
    )
    picture = replace(picture, encoding="png", status="ok", exposed_s=99.5)
    portions = {"first": 3, "list": [{"t_s": 1.0}]}
    now = {"mode": "running", "wall_s": 100.0}
    header, got, data = unpack(pack(now, {"word": "\u00e4"}, numbers, 7, picture, {"portions": portions}))
    np.testing.assert_array_equal(got, numbers)
    assert data == picture.data
    assert header["now"] == now
    assert header["portions"] == portions
    assert header["page"] == {"word": "\u00e4"}
    assert (header["rows"], header["columns"], header["first"]) == (5, COLUMNS, 7)
    assert header["picture"] == {
        "name": "left",
        "t_s": 1.25,
        "age_s": 0.5,
        "encoding": "png",
        "status": "ok",
        "width_px": 640,
        "height_px": 480,
        "bytes": len(picture.data),
        "overlay": [{"kind": "cross", "at": [1, 2], "good": True}],
    }


@pytest.mark.parametrize("word", ["", "a", "ab", "abc", "\u00e4"])
def test_rows_of_a_message_begin_where_a_browser_can_read_them(word: str) -> None:
    message = pack({"word": word}, None, rows(1), 0)
    (length,) = struct.unpack_from("<I", message)
    assert length % 4 == 0
    assert json.loads(message[4 : 4 + length])["now"]["word"] == word


def test_message_refuses_what_json_does_not_have() -> None:
    with pytest.raises(ValueError, match="JSON"):
        pack({"run_s": float("nan")}, None, rows(0), 0)


def test_thinned_rows_keep_the_worst_every_firing_and_the_newest_pose() -> None:
    many = rows(10)
    many[:, INDEX["vision_m.x"]] = np.nan
    many[:, INDEX["nis_position"]] = np.nan
    many[1, INDEX["lateness_us"]] = 900.0
    many[6, INDEX["nis_position"]] = 30.0
    many[5, INDEX["thrusters"]] = 1 << 23
    many[7, INDEX["thrusters"]] = 1 << 2
    many[6, INDEX["vision_m.x"]] = 1.5
    many[8, INDEX["vision_m.x"]] = 2.5
    few = decimated(many, 2)
    assert few[:, 0].tolist() == [4.0, 9.0]
    assert few[0, INDEX["lateness_us"]] == 900.0
    assert np.isnan(few[0, INDEX["vision_m.x"]])
    assert np.isnan(few[0, INDEX["nis_position"]])
    assert few[1, INDEX["thrusters"]] == (1 << 23) + (1 << 2)
    assert few[1, INDEX["vision_m.x"]] == 2.5
    assert few[1, INDEX["nis_position"]] == 30.0


@pytest.mark.parametrize(("n", "at_most"), [(0, 5), (5, 5), (6, 5), (11, 5), (1000, 250), (1001, 250)])
def test_thinned_rows_are_no_more_than_allowed_and_end_with_the_newest(n: int, at_most: int) -> None:
    few = decimated(rows(n), at_most)
    assert len(few) <= at_most
    assert n == 0 or few[-1, 0] == n - 1


def test_page_gets_each_row_once_and_one_that_was_slow_gets_few() -> None:
    store, cursor = RowStore(), Cursor()
    store.begin()
    store.add(rows(3))
    assert store.since(cursor)[:, 0].tolist() == [0.0, 1.0, 2.0]
    assert cursor.restarted
    store.add(rows(2, 3))
    assert store.since(cursor)[:, 0].tolist() == [3.0, 4.0]
    assert not cursor.restarted
    assert len(store.since(cursor)) == 0
    store.add(rows(5000, 5))
    late = store.since(cursor)
    assert len(late) <= MAX_ROWS
    assert late[-1, 0] == 5004.0


def test_new_page_gets_a_backlog_and_a_new_session_starts_empty() -> None:
    store, cursor = RowStore(), Cursor()
    store.begin()
    store.add(rows(4000))
    backlog = store.since(cursor)
    assert MAX_ROWS < len(backlog) <= BACKLOG
    store.begin()
    store.add(rows(1))
    assert store.since(cursor)[:, 0].tolist() == [0.0]
    assert cursor.restarted


def test_store_of_a_long_session_stays_bounded_and_keeps_its_whole_course() -> None:
    store, cursor = RowStore(), Cursor()
    store.begin()
    for k in range(150):
        store.add(rows(1000, 1000 * k))
    kept = store.since(cursor)
    assert store.total == 150_000
    assert store.kept <= 60_000
    assert kept[0, 0] < 200.0
    assert kept[-1, 0] == 149_999.0
    assert np.all(np.diff(kept[:, 0]) > 0.0)
