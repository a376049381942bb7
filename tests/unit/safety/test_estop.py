"""The emergency stop's sequences of levels and edges."""

from __future__ import annotations

import pytest

from hil.safety.monitor import EmergencyStop

IN, OUT, UNKNOWN = True, False, None


@pytest.mark.parametrize(
    ("levels", "latched"),
    [
        ([(OUT, 0)], False),
        ([(IN, 0)], True),
        ([(UNKNOWN, 0)], True),  # no answer counts as pressed
        ([(IN, 0), (OUT, 0)], True),  # seen once is enough, and letting go is not a reset
        ([(IN, 0), (OUT, 0), (OUT, 1)], False),
        ([(IN, 0), (IN, 1)], True),  # the cause is still there
        ([(IN, 0), (IN, 1), (OUT, 1)], True),  # the edge came too early, the level does not count
        ([(IN, 0), (IN, 1), (OUT, 1), (OUT, 0), (OUT, 1)], False),
        ([(OUT, 1), (IN, 1), (OUT, 1)], True),  # a reset that is stuck
        ([(IN, 0), (OUT, 0), (OUT, 1), (IN, 1)], True),  # pressed again
        ([(IN, 0), (OUT, 0), (OUT, 1), (IN, 1), (OUT, 1)], True),
        ([(IN, 1), (OUT, 1)], True),  # held from the start
        ([(IN, 0), (UNKNOWN, 1), (OUT, 1)], True),
    ],
)
def test_only_a_new_reset_with_the_button_out_lets_go(levels: list[tuple[bool | None, int]], latched: bool) -> None:
    stop = EmergencyStop()
    for pressed, reset in levels:
        stop.update(pressed, bool(reset))
    assert stop.latched is latched


def test_order_to_reset_works_with_the_button_out_alone() -> None:
    stop = EmergencyStop()
    stop.update(IN)
    assert not stop.reset()
    assert stop.latched
    stop.update(OUT)
    assert stop.latched
    assert stop.reset()
    assert not stop.latched


def test_order_to_reset_is_not_remembered_until_the_button_comes_out() -> None:
    stop = EmergencyStop()
    stop.update(IN)
    stop.reset()
    stop.update(OUT)
    assert stop.latched
