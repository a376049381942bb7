"""Vision unit before scenes with something that looks like the ring: no pose of the wrong lights is ``ok``."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.vmu_lookalikes import LOOKALIKE_ROWS

BY_NAME = {row.name: row for row in LOOKALIKE_ROWS}


@pytest.mark.parametrize(
    "name",
    [
        "two LEDs hidden, reflection of 80 %",
        "two LEDs hidden, reflection of 100 %",
        "second ring 1.5 m behind",
        "second ring beside",
    ],
)
def test_two_patterns_without_a_track_are_ambiguous_whichever_is_more_complete(name: str) -> None:
    tally = BY_NAME[name].run(3, 3)
    assert tally.statuses == {"ambiguous": 3}, tally.line()


def test_track_is_kept_while_its_own_leds_are_where_they_are_expected() -> None:
    """The reflection has all LEDs in every frame, the ring four."""
    tally = BY_NAME["reflection of 80 %, tracked"].run(4, 5)
    assert tally.solved == 4, tally.line()
    assert np.abs(tally.ratios).max() < 4.5
