"""Exchanges with the drives: at most at their own rate, on a grid, however fast setpoints come."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.core.clock import WallClock
from hil.core.messages import HOMED, NO_LIMIT, Array, AxisFeedback
from hil.drivers.cyclic_exchange import CyclicAxisGroup
from hil.drivers.setpoint_limiter import ExchangePacer


def exchanges(setpoints_s: Sequence[float], rate_max_hz: float) -> list[float]:
    """Return the times of the setpoints that trigger an exchange."""
    pacer = ExchangePacer(rate_max_hz)
    return [t_s for t_s in setpoints_s if pacer.is_due(t_s)]


@pytest.mark.parametrize(("setpoints_hz", "exchanges_hz"), [(1000, 250), (500, 250), (1000, 200), (300, 150)])
def test_exchanges_are_a_part_of_the_setpoints_at_even_distances(setpoints_hz: int, exchanges_hz: int) -> None:
    jitter_s = 0.3 / setpoints_hz * np.random.default_rng(1).random(setpoints_hz)
    found = exchanges((np.arange(setpoints_hz) / setpoints_hz + jitter_s).tolist(), exchanges_hz)
    assert len(found) == exchanges_hz + 1
    assert np.ptp(np.diff(found[1:-1])[1:]) < 0.7 / setpoints_hz


@pytest.mark.parametrize("setpoints_hz", [50, 240, 250])
def test_each_setpoint_is_exchanged_at_or_below_the_rate_also_after_late_ones(setpoints_hz: int) -> None:
    times_s = np.arange(100) / setpoints_hz
    times_s[[20, 60]] += 0.4 / setpoints_hz
    assert len(exchanges(times_s.tolist(), 250.0)) == 100


def test_a_late_setpoint_does_not_delay_those_after_it() -> None:
    times_s = [0.001 * k for k in range(13)] + [0.0149] + [0.001 * k for k in range(15, 40)]
    found = exchanges(times_s, 250.0)
    assert found[:6] == pytest.approx([0.0, 0.001, 0.004, 0.008, 0.012, 0.016])


def test_a_pause_earns_one_exchange() -> None:
    times_s = [0.001 * k for k in range(10)] + [1.0 + 0.001 * k for k in range(10)]
    assert exchanges(times_s, 250.0) == pytest.approx([0.0, 0.001, 0.004, 0.008, 1.0, 1.001, 1.004, 1.008])


class CountingLink:
    """Drives that are where they are sent, and count."""

    has_profiles = jogging = False

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self.received: list[float] = []
        self.exchanged = threading.Event()

    def _feedback(self, position: Array) -> AxisFeedback:
        return AxisFeedback(self._clock.now_s(), position, np.zeros(3), HOMED, NO_LIMIT)

    def open(self) -> AxisFeedback:
        return self._feedback(np.zeros(3))

    def exchange(self, position: Array, rate: Array) -> AxisFeedback:
        self.received.append(float(position[0]))
        self.exchanged.set()
        return self._feedback(position)

    def home(self) -> None: ...

    def move_to(self, position: Array, rate: Array) -> None: ...

    def quick_stop(self) -> None: ...

    def disable(self) -> None: ...

    def close(self) -> None: ...

    def counters(self) -> dict[str, int]:
        return {}


def test_the_newest_setpoint_wins_and_superseded_ones_are_not_queued() -> None:
    config = load_rig("mock").value.turntable.model_copy(update={"exchange_rate_max_hz": 20.0, "timeout_s": 10.0})
    clock = WallClock()
    link = CountingLink(clock)
    group = CyclicAxisGroup(config, clock, link, "turntable")
    begun_s = clock.now_s()
    group.open(begun_s)
    try:
        for k in range(200):  # 2 s of setpoints, given within 0.2 s
            link.exchanged.clear()
            group.send(np.full(3, 1e-8 * k), np.zeros(3), begun_s + 0.01 * k)
            if k % 5 == 0:
                assert link.exchanged.wait(5.0)
            else:
                time.sleep(0.001)
        idle = (clock.now_s() - begun_s) / 0.02 + 1.0  # exchanges without a setpoint
        assert 40 <= len(link.received) <= 40 + idle
        link.exchanged.clear()
        assert link.exchanged.wait(5.0)
        assert link.received[-1] == pytest.approx(1e-8 * 199, abs=1e-12)
    finally:
        group.close()
