"""CAN adapters on a serial line, whose frames have no checksum: how far a damaged one may show an axis elsewhere."""

from __future__ import annotations

import math
import sys
from collections import deque

import numpy as np
import pytest

from hil.errors import DeviceError
from tests.support.lock_step import GRID_S
from tests.support.turntable_bench import PARK_DEG, served

UNNOTICED_DEG = 0.25
"""Half of the following error, 1.1 deg, without the motion as a witness."""


def largest_error_deg(emulator, device, clock, seconds: float, moves: bool) -> tuple[float, bool]:
    """Return the largest error of a position that was read, and whether the link ended in an error."""
    start_s, path = clock.now_s(), np.radians((10.0, -8.0, 6.0)) * moves
    worst, sampled_s, ended = 0.0, start_s, False
    true: deque[tuple[float, np.ndarray]] = deque(maxlen=64)
    while clock.now_s() < start_s + seconds:
        t_s = clock.now_s() - start_s
        phase = math.tau * 0.25 * t_s
        try:
            device.send(np.radians(PARK_DEG) + path * (1.0 - math.cos(phase)) / 2.0,
                        path * math.pi * 0.25 * math.sin(phase), clock.now_s())  # fmt: skip
            seen = device.read(clock.now_s())
        except DeviceError:
            ended = True
            break
        true.append((clock.now_s(), emulator.gimbals.position.copy()))
        if seen.t_s > sampled_s:
            sampled_s = seen.t_s
            _, nearest = min(true, key=lambda each: abs(each[0] - sampled_s))
            worst = max(worst, float(np.degrees(np.abs(seen.position - nearest)).max()))
        clock.sleep(GRID_S / 4.0)
    return worst, ended


@pytest.mark.parametrize("moves", [False, True], ids=["at rest", "moving"])
@pytest.mark.parametrize("seconds", [5.0, pytest.param(120.0, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_damaged_frame_shows_no_axis_far_from_its_place(moves: bool, seconds: float) -> None:
    with served("cia402", timeout_s=2.0) as (emulator, device, clock):
        clean_deg, _ = largest_error_deg(emulator, device, clock, 4.0, moves)
        emulator.faults.on("corrupt", value=0.03)
        worst_deg, ended = largest_error_deg(emulator, device, clock, seconds, moves)
        counts = device.counters()
        sys.stdout.write(f"largest error {worst_deg:.3f} deg, {clean_deg:.3f} undamaged, ended {ended}: {counts}\n")
    assert not ended
    assert worst_deg < UNNOTICED_DEG + clean_deg


def test_true_motion_is_never_taken_for_damage() -> None:
    with served("cia402", timeout_s=2.0) as (emulator, device, clock):
        largest_error_deg(emulator, device, clock, 8.0, moves=True)
        assert device.counters()["protocol_errors"] == 0
        device.send(np.radians((40.0, -40.0, 40.0)), np.zeros(3), clock.now_s())  # as fast as the limits allow
        for _ in range(150):
            clock.sleep(GRID_S)
            device.read(clock.now_s())
        assert device.counters()["protocol_errors"] == 0
        emulator.faults.on("jump", "yaw", 0.7)
        for _ in range(20):
            clock.sleep(GRID_S)
            device.read(clock.now_s())
        assert 1 <= device.counters()["protocol_errors"] <= 2  # seen one exchange later
