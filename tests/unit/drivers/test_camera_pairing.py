"""Pairs of frames are made by time of exposure and frame number, never by arrival."""

from __future__ import annotations

import numpy as np
import pytest

from hil.drivers.cameras.pairing import FRAME_NUMBERS, FramePair, Pairing, TimedFrame

PERIOD_S = 0.16
IMAGE = np.zeros((1, 1), np.uint8)
LEFT, RIGHT = 0, 1


def frame(k: int, number: int | None = None, off_s: float = 0.0) -> TimedFrame:
    """Return the frame of exposure ``k``, received 10 ms later."""
    exposed_s = k * PERIOD_S + off_s
    return TimedFrame(exposed_s, exposed_s + 0.01, k if number is None else number, IMAGE)


def take(pairing: Pairing, k: int) -> list[FramePair]:
    """Return what is complete shortly after exposure ``k``."""
    return list(pairing.pairs(k * PERIOD_S + 0.02))


def shown(pairs: list[FramePair]) -> list[tuple[int | None, int | None]]:
    return [tuple(None if side is None else side.number for side in (pair.left, pair.right)) for pair in pairs]  # type: ignore[misc]


def test_frames_pair_by_exposure_whatever_the_order_of_arrival() -> None:
    pairing = Pairing(0.005, 0.05, 1.0 / PERIOD_S)
    for side, k in ((RIGHT, 0), (RIGHT, 1), (LEFT, 0), (LEFT, 1)):
        pairing.put(side, frame(k, off_s=0.001 * side))
    assert shown(take(pairing, 1)) == [(0, 0), (1, 1)]


def test_a_frame_of_the_neighbouring_exposure_is_no_partner() -> None:
    pairing = Pairing(0.005, 0.05, 1.0 / PERIOD_S)
    pairing.put(LEFT, frame(0))
    pairing.put(RIGHT, frame(1))
    pairing.put(LEFT, frame(1))
    assert shown(take(pairing, 1)) == [(0, None), (1, 1)]
    assert pairing.counters["left_only"] == 1


def test_a_missing_partner_is_waited_for_and_then_left_out() -> None:
    pairing = Pairing(0.005, 0.05, 1.0 / PERIOD_S)
    pairing.put(LEFT, frame(0))
    assert list(pairing.pairs(0.05)) == []
    assert shown(list(pairing.pairs(0.07))) == [(0, None)]
    pairing.put(RIGHT, frame(0))
    assert list(pairing.pairs(0.5)) == []
    assert pairing.counters["late"] == 1


@pytest.mark.parametrize("apart_s", [0.008, 0.1])
def test_frames_of_one_trigger_that_are_no_pair_do_not_wait_for_another_partner(apart_s: float) -> None:
    pairing = Pairing(0.005, 0.05, 1.0 / PERIOD_S)
    for k in range(2):
        pairing.put(LEFT, frame(k, 100 + k))
        pairing.put(RIGHT, frame(k, off_s=apart_s * k))
    assert shown(take(pairing, 1)) == [(100, 0), (101, None), (None, 1)]


def test_a_frame_waits_while_the_one_passed_on_before_is_of_another_trigger() -> None:
    """The left camera misses exposure 1, so that its numbers fall behind: number 1 is of exposure 2."""
    pairing = Pairing(0.005, 0.05, 1.0 / PERIOD_S)
    pairing.put(LEFT, frame(0))
    for k in range(2):
        pairing.put(RIGHT, frame(k))
    assert shown(list(pairing.pairs(PERIOD_S + 0.07))) == [(0, 0), (None, 1)]
    pairing.put(LEFT, frame(2, 1))
    assert take(pairing, 2) == []
    pairing.put(RIGHT, frame(2))
    assert take(pairing, 2) == []  # the numbers of this pair are odd, once
    assert pairing.counters["odd_numbers"] == 1


def test_numbers_of_the_cameras_need_not_be_equal_and_may_wrap() -> None:
    pairing = Pairing(0.005, 0.05, 1.0 / PERIOD_S)
    for k in range(6):
        pairing.put(LEFT, frame(k, FRAME_NUMBERS - 3 + k if k < 4 else k - 3))
        pairing.put(RIGHT, frame(k, 100 + k))
    assert len(take(pairing, 5)) == 6
    assert pairing.counters["odd_numbers"] == 0


def test_numbers_that_contradict_the_times_are_not_trusted_at_once() -> None:
    """From exposure 3 on the right camera's frames have the time of the next exposure, or it has missed a trigger."""
    pairing = Pairing(0.005, 0.05, 1.0 / PERIOD_S)
    used = []
    for k in range(8):
        pairing.put(LEFT, frame(k))
        pairing.put(RIGHT, frame(k, k if k < 3 else k - 1))
        used.append(len(take(pairing, k)))
    assert used == [1, 1, 1, 0, 0, 1, 1, 1]
    assert pairing.counters["odd_numbers"] == 2


def test_one_odd_number_costs_one_pair() -> None:
    pairing = Pairing(0.005, 0.05, 1.0 / PERIOD_S)
    used = []
    for k in range(6):
        pairing.put(LEFT, frame(k))
        pairing.put(RIGHT, frame(k, k + 5 if k == 2 else k))
        used.append(len(take(pairing, k)))
    assert used == [1, 1, 0, 1, 1, 1]
