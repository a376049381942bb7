"""The target's manipulator: placed slowly, held, watched; on axes in memory and in a whole run."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hil.config.rig import RAIL_NAMES, TargetManipulator
from hil.core.clock import SimulatedClock
from hil.drivers.mock_axes import MockAxes
from hil.errors import SafetyTrip
from hil.loop.rate_keeper import SimulatedRate, Tick
from hil.loop.target_axes import FRACTION_OF_LIMITS
from hil.loop.target_stage import HeldAxes
from hil.session.build import runner as make_runner
from tests.support.run_settings import make_job

AXIS = {"travel_m": [-0.5, 0.5], "rate_max_mps": 0.2, "acceleration_max_mps2": 0.4}
TABLE = {
    "driver": "mock",
    "place_m": [0.2, -0.1, 0.0],
    "servo": {"gain_per_s": 25.0, "lag_s": 0.008},
    **dict.fromkeys(RAIL_NAMES, AXIS),
}
SETTING = (
    'rig.target_manipulator={driver="mock", place_m=[0.2, -0.1, 0.0], servo={gain_per_s=25.0, lag_s=0.008}, '
    + ", ".join(f"{n}={{travel_m=[-0.5, 0.5], rate_max_mps=0.2, acceleration_max_mps2=0.4}}" for n in RAIL_NAMES)
    + "}"
)


def config(**changes: object) -> TargetManipulator:
    return TargetManipulator.model_validate(TABLE | changes, strict=False)


class Desk:
    def __init__(self) -> None:
        self.axes = MockAxes("target", config())
        self.target = HeldAxes(self.axes, config())
        self.rate = SimulatedRate(SimulatedClock(), 0.02)
        self.target.open(0.0)

    def place(self) -> np.ndarray:
        """Return where the axes were in each cycle of the move, (n, 3)."""
        seen = []

        def tick() -> Tick:
            tick = self.rate.wait()
            seen.append(self.axes.read(tick.now_s).position)
            return tick

        self.target.place(tick, 0.02)
        return np.array(seen)


def test_target_goes_to_its_place_slowly_and_stays() -> None:
    desk = Desk()
    way = desk.place()
    assert way[-1] == pytest.approx([0.2, -0.1, 0.0], abs=1e-3)
    assert np.abs(np.diff(way, axis=0)).max() / 0.02 < 1.1 * FRACTION_OF_LIMITS * 0.2
    for _ in range(200):
        desk.target.check(desk.rate.wait().now_s)


def test_target_that_is_moved_trips_and_names_axis_value_and_limit() -> None:
    desk = Desk()
    desk.place()
    desk.axes.send(np.array([0.2, -0.08, 0.0]), np.zeros(3), desk.rate.now_s())
    with pytest.raises(SafetyTrip, match=r"target\.y: distance from commanded place 0\.0\d+ m, allowed 0\.005 m"):
        _look_for_a_second(desk)


def _look_for_a_second(desk: Desk) -> None:
    for _ in range(50):
        desk.target.check(desk.rate.wait().now_s)


def test_target_that_does_not_arrive_is_given_up() -> None:
    desk = Desk()
    desk.axes.stop(0.0)
    with pytest.raises(SafetyTrip, match="target: place not reached, allowed 3 s after the move"):
        desk.place()


def test_place_outside_the_travel_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"place_m: y 0\.6, allowed -0\.5 to 0\.5"):
        config(place_m=[0.0, 0.6, 0.0])


def test_run_places_the_target_first_and_is_the_same_run_otherwise() -> None:
    found = []
    for settings in ((), (SETTING,)):
        job = make_job(2.0, settings, seed=1)
        with make_runner(job) as runner:
            outcome = runner.run()
            assert outcome.stop == "completed"
            found.append((outcome, runner.loop.target.groups))
    (plain, _), (placed, (target,)) = found
    assert isinstance(target, HeldAxes)
    np.testing.assert_array_equal(plain.history["truth"]["r_CT_H"][0], placed.history["truth"]["r_CT_H"][0])
    assert len(placed.history) == len(plain.history)
