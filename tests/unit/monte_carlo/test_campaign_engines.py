"""Batches that are flown in parts, put together again."""

from __future__ import annotations

from hil.parts.campaigns.engines import _PART, _Parts


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
