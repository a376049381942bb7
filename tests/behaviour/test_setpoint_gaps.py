"""Axes that miss setpoints in a move, on wires: they catch up within the limits of the move, by their encoders."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hil.core.clock import BenchClock
from hil.drivers.base import AxisGroup, LimitsSetpoints
from tests.behaviour.test_rails_faults import RIGS, bench_of
from tests.support.turntable_bench import served

STEP_S = 0.02
RESERVE = 1.1  # of the limits of a move beyond its speed
RIPPLE = 1.12  # of the servo: in regular motion 1.07
PEAK = 1.1  # over the limit of the move: measured 1.05; without limits in catching up 1.37 and more
GAP_S = 0.19


def speeds(device: AxisGroup, clock: BenchClock, speed: float, at: Callable[[float], None], end_s: float) -> np.ndarray:
    """Return the speeds of axis 0, (n,), by its encoder, in a move at ``speed``, from half a second on.

    at: called in each cycle with the time of the move.
    """
    acceleration = 1.2 * speed
    assert isinstance(device, LimitsSetpoints)
    device.set_limits(np.full(3, RESERVE * speed), np.full(3, RESERVE * acceleration))
    place, up_s = device.read(clock.now_s()).position.copy(), speed / acceleration
    first_s = clock.now_s()
    found = []
    for k in range(round(end_s / STEP_S)):
        t_s, now_s = k * STEP_S, clock.now_s()
        at(t_s)
        rate = min(acceleration * t_s, speed)
        path = 0.5 * acceleration * t_s**2 if t_s < up_s else speed * (t_s - 0.5 * up_s)
        device.send(place + path * np.eye(3)[0], np.array([rate, 0.0, 0.0]), now_s)
        found.append(float(device.read(now_s).rate[0]))
        clock.sleep_until(first_s + (k + 1) * STEP_S)
    return np.array(found)


def at_once(t_s: float, action: Callable[[], Any]) -> Callable[[float], None]:
    """Return a function of the time that calls ``action`` once, at ``t_s``."""
    done = []
    return lambda now_s: None if done or now_s < t_s else done.append(action())


@pytest.mark.parametrize("rig", RIGS)
def test_rails_catch_up_within_their_move_after_a_lost_answer(rig: str) -> None:
    with bench_of(rig) as bench:
        bench.open()
        found = speeds(bench.rails, bench.clock, 0.25, at_once(1.5, lambda: bench.treat(lambda _: [])), 4.0)
        assert bench.rails.counters()["retries"] == 1
    assert found[-20:].mean() > 0.25 / RIPPLE
    assert found.max() < 0.25 * RESERVE * PEAK


def test_a_turntable_catches_up_within_its_move_after_lost_packets() -> None:
    speed = math.radians(15.0)

    with served("ascii", timeout_s=1.2) as (emulator, device, clock):

        def lose(t_s: float) -> None:
            if 1.5 <= t_s < 1.5 + GAP_S:
                emulator.faults.on("drop", value=1.0)
            else:
                emulator.faults.off("drop")

        found = speeds(device, clock, speed, lose, 3.2)
    assert found.max() < speed * RESERVE * PEAK


def test_rails_exchange_at_their_own_rate_and_go_to_the_newest_setpoint() -> None:
    with bench_of("emulated", exchange_rate_max_hz=60.0) as bench:
        bench.open()
        place, begun_s = bench.read().position.copy(), bench.clock.now_s()
        before, goal = bench.rails.counters()["exchanges"], place
        for k in range(250):
            goal = place + 1e-6 * k
            bench.rails.send(goal, np.zeros(3), bench.clock.now_s())
            bench.clock.sleep_until(begun_s + 0.001 * k)
        exchanges = (bench.rails.counters()["exchanges"] - before) / 3
        assert exchanges <= 60.0 * (bench.clock.now_s() - begun_s) + 3
        assert bench.wait(lambda: bool(np.abs(bench.read().position - goal).max() < 1e-7))
