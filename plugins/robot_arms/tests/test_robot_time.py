"""Bench time of a robot's cycles: delayed datagrams, pauses of the host, a clock that drifts or jumps."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from hil.core.clock import WallClock
from hil_robot_arms.cycles import Cycle, RobotCycles, RobotTime

PERIOD_S = 0.004


@pytest.mark.parametrize("second_s", [1.0, 1.0001, 0.999, 1.15, 1.28], ids=str)
def test_time_of_delayed_datagrams_follows_a_clock_that_drifts(second_s: float) -> None:
    time, draws = RobotTime(), np.random.default_rng(2)
    for number in range(5000):
        sent_s = second_s * PERIOD_S * number
        estimate_s = time.update(PERIOD_S * number, sent_s + 1e-4 + draws.exponential(3e-4))
        if number > 2000:
            assert -3e-4 < estimate_s - sent_s < 1e-3
    assert time.rate == pytest.approx(second_s, abs=2e-3)


def test_pause_of_the_host_does_not_turn_time_back() -> None:
    time, before_s, worst_s = RobotTime(), 0.0, 0.0
    for number in range(3000):
        sent_s = PERIOD_S * number
        arrived_s = max(sent_s, 4.08) if 4.0 < sent_s < 4.08 else sent_s  # 80 ms, then all at once
        estimate_s = time.update(sent_s, arrived_s + 1e-4)
        if number > 1:
            assert estimate_s - before_s > 0.5 * PERIOD_S
        before_s, worst_s = estimate_s, max(worst_s, abs(estimate_s - sent_s))
    assert worst_s < 0.08
    assert estimate_s == pytest.approx(sent_s, abs=5e-4)


def test_clock_that_has_stood_is_followed_again() -> None:
    time = RobotTime()
    for number in range(1000):
        sent_s = PERIOD_S * number + (0.06 if number > 500 else 0.0)
        estimate_s = time.update(PERIOD_S * number, sent_s)
    assert estimate_s == pytest.approx(sent_s, abs=2e-3)
    assert time.update(0.0, 100.0) == 100.0


def test_cycles_that_a_pause_has_left_unread_are_passed_over() -> None:
    """Answers to them would come too late, and their poses would be compared with setpoints of after the pause."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    cycles = RobotCycles(WallClock(), _cycle_of, 1, PERIOD_S, 0.2, "arm")
    cycles.open("127.0.0.1", port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        robot.connect(("127.0.0.1", port))
        for sent in (b"1", b"2 3 3 x 5 6", b"7"):
            for number in sent.split():
                robot.send(number)
            newest = cycles.next()
            assert newest is not None
            assert newest.number == int(sent[-1:])
            cycles.answer(sent[-1:])
            assert robot.recv(8) == sent[-1:]
    counts = {"exchanges": 6, "lost": 1, "protocol_errors": 1, "duplicates": 1, "late_answers": 3}
    assert cycles.counts == counts
    cycles.close()


def _cycle_of(data: bytes) -> Cycle[int]:
    number = int(data)
    return Cycle(number, PERIOD_S * number, number)
