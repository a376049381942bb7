"""Axes without a drive: in a group with a driver, and a group of them alone."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.core.clock import SimulatedClock
from hil.core.messages import Homing
from hil.drivers.base import AxisGroup, Jogs, Parks
from hil.drivers.split_axes import FixedAxes, make_axes
from hil.errors import SafetyTrip
from hil.parts.emulation.shared_state import SharedAxisState
from tests.support.lock_step import in_lock_step, serving


def test_group_without_a_drive_stands() -> None:
    rails = load_rig("mock", [f"rig.rails.{name}.fixed_m={k}.0" for k, name in enumerate("xyz", 1)]).value.rails
    group = make_axes(rails, SimulatedClock(), "rails")
    assert isinstance(group, FixedAxes)
    assert isinstance(group, AxisGroup)
    assert isinstance(group, Jogs)
    assert isinstance(group, Parks)
    group.open(0.0)
    np.testing.assert_array_equal(group.send(np.zeros(3), np.ones(3), 0.1), [1.0, 2.0, 3.0])
    feedback = group.read(0.2)
    assert (feedback.t_s, feedback.homing) == (0.2, (Homing.DONE,) * 3)
    np.testing.assert_array_equal(feedback.position, [1.0, 2.0, 3.0])
    with pytest.raises(SafetyTrip, match="rails"):
        group.send(np.array([np.nan, 0.0, 0.0]), np.zeros(3), 0.3)


@pytest.mark.parametrize("fixed", [("z",), ("x",), ("x", "z")])
def test_driver_has_the_other_axes(fixed: tuple[str, ...]) -> None:
    rails = load_rig("emulated", [f"rig.rails.{name}.fixed_m=0.5" for name in fixed]).value.rails
    with in_lock_step() as clock, closing(SharedAxisState.create()) as board:
        (part,) = rails.parts("rails").values()
        emulator = part.make_emulator(clock, board, name="rails")
        wired = rails.connected("rails", emulator.start())
        with serving(clock, emulator), closing(make_axes(wired, clock, "rails")) as group:
            assert group.axis_names == ("rails.x", "rails.y", "rails.z")
            group.open(clock.now_s())
            start = group.read(clock.now_s()).position
            moves = np.array([name not in fixed for name in "xyz"])
            for _ in range(20):
                accepted = group.send(start + 0.01, np.zeros(3), clock.now_s())
                clock.sleep(0.02)
            np.testing.assert_allclose(accepted, start + 0.01 * moves)
            reached = group.read(clock.now_s()).position
            np.testing.assert_allclose(reached, start + 0.01 * moves, atol=2e-3)
            np.testing.assert_array_equal(reached[~moves], 0.5)
