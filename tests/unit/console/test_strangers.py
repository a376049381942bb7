"""Bounds on clients that have not authenticated."""

from __future__ import annotations

import pytest

from hil.parts.console.lease import RequestRejected
from hil.parts.console.strangers import FairSlots, GuessLimiter


def test_newcomer_displaces_the_oldest_of_the_address_that_has_most() -> None:
    slots: FairSlots[int] = FairSlots(3)
    assert [slots.enter(number, "a") for number in range(3)] == [None] * 3
    assert slots.enter(10, "b") == 0
    assert slots.enter(11, "c") == 1
    assert slots.enter(12, "a") == 2  # not those of other addresses
    assert len(slots) == 3
    slots.leave(10)
    slots.leave(0)  # displaced before
    assert slots.enter(13, "a") is None


def test_pause_after_wrong_tokens_doubles_up_to_half_a_minute_and_concerns_one_address() -> None:
    limiter, pauses = GuessLimiter("right"), []
    for _ in range(12):
        limiter.failed("a", 100.0)
        pauses.append(limiter.pause_s("a", 100.0))
    assert pauses == [0.0, 0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0, 30.0]
    assert limiter.pause_s("a", 130.0) == 0.0
    assert limiter.pause_s("b", 100.0) == 0.0
    limiter.check("right", "a", 100.0)
    limiter.failed("a", 200.0)
    assert limiter.pause_s("a", 200.0) == 0.0


def test_right_token_is_accepted_during_the_pause_of_its_address() -> None:
    limiter = GuessLimiter("right")
    for _ in range(12):
        with pytest.raises(RequestRejected):
            limiter.check("wrong", "a", 100.0)
    with pytest.raises(RequestRejected, match=r"wrong tokens came from this address: try again in 0\.5 s"):
        limiter.check("wrong", "a", 100.0)
    limiter.check("right", "a", 100.0)
    with pytest.raises(RequestRejected, match=r"wrong token$"):
        limiter.check("wrong", "a", 100.0)


def test_only_a_bounded_number_of_addresses_is_remembered() -> None:
    limiter = GuessLimiter("right")
    for number in range(5000):
        limiter.failed(str(number), 0.0)
    assert len(limiter._wrong) == 1024
