"""Work of the host keeps its pace above real time."""

from __future__ import annotations

import os

import pytest

from hil.core.clock import WallClock
from hil.core.realtime import speed_held


@pytest.mark.parametrize(
    ("speed", "bench_s", "wall_s"), [(0.5, 0.004, 0.008), (1.0, 0.004, 0.004), (4.0, 0.016, 0.004)]
)
def test_steps_of_the_host_are_no_closer_than_in_real_time(speed: float, bench_s: float, wall_s: float) -> None:
    clock = WallClock(speed=speed)
    assert clock.paced_s(0.004) == pytest.approx(bench_s)
    assert clock.wall_s(clock.paced_s(0.004)) == pytest.approx(wall_s)


def test_speed_that_is_held_grows_with_the_processors_that_this_process_may_use() -> None:
    assert speed_held() == len(os.sched_getaffinity(0))
