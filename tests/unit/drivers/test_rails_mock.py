"""The mock keeps a device's promises in simulated time."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.rig import Rails, Turntable
from hil.drivers.base import AxisGroup
from hil.drivers.mock_axes import MockAxes
from hil.errors import LinkLost, LinkTimeout, SafetyTrip

CYCLE_S = 0.01


def rails_config() -> Rails:
    axis = {"rate_max_mps": 1.0, "acceleration_max_mps2": 2.0}
    return Rails.model_validate(
        {
            "driver": "mock",
            "servo": {"gain_per_s": 10.0, "lag_s": 0.02},
            "x": {"travel_m": (0.0, 12.0), "park_m": 6.0} | axis,
            "y": {"travel_m": (-1.0, 1.0)} | axis,
            "z": {"travel_m": (0.0, 2.0), "park_m": 0.5} | axis,
        }
    )


def open_rails() -> MockAxes:
    rails = MockAxes("rails", rails_config())
    rails.open(0.0)
    return rails


def drive(rails: MockAxes, cycles: int) -> None:
    for k in range(cycles):
        rails.send(np.array([6.0 + 0.002 * k, 0.001 * k, 0.5]), np.array([0.2, 0.1, 0.0]), k * CYCLE_S)


def test_open_holds_the_present_position() -> None:
    rails = open_rails()
    assert isinstance(rails, AxisGroup)
    assert rails.axis_names == ("rails.x", "rails.y", "rails.z")
    feedback = rails.read(1.0)
    assert feedback.t_s == 1.0
    assert feedback.position.tolist() == [6.0, 0.0, 0.5]
    assert not feedback.rate.any()


def test_axes_follow_a_ramp() -> None:
    rails = open_rails()
    drive(rails, 200)
    feedback = rails.read(1.99)
    assert feedback.position == pytest.approx([6.398, 0.199, 0.5], abs=1e-2)
    assert feedback.rate == pytest.approx([0.2, 0.1, 0.0], abs=1e-2)


def test_same_calls_give_the_same_bits() -> None:
    first, second = open_rails(), open_rails()
    drive(first, 100)
    drive(second, 100)
    assert first.read(1.0).position.tobytes() == second.read(1.0).position.tobytes()


def test_setpoint_acts_from_its_own_time_on() -> None:
    rails = open_rails()
    rails.send(np.array([7.0, 0.0, 0.5]), np.zeros(3), 5.0)
    assert rails.read(5.0).position.tolist() == [6.0, 0.0, 0.5]
    assert rails.read(5.1).position[0] > 6.0


def test_setpoint_is_cut_to_travel() -> None:
    rails = open_rails()
    accepted = rails.send(np.array([13.0, -2.0, 0.5]), np.zeros(3), 0.0)
    assert accepted.tolist() == [12.0, -1.0, 0.5]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_setpoint_that_is_no_number_trips(bad: float) -> None:
    rails = open_rails()
    with pytest.raises(SafetyTrip, match=r"rails\.y"):
        rails.send(np.array([6.0, bad, 0.5]), np.zeros(3), 0.0)
    with pytest.raises(SafetyTrip, match=r"rails\.z"):
        rails.send(np.array([6.0, 0.0, 0.5]), np.array([0.0, 0.0, bad]), 0.0)


def test_stop_brakes_and_stays() -> None:
    rails = open_rails()
    drive(rails, 100)
    rails.stop(1.0)
    before = rails.read(1.0).position
    standing = rails.read(2.0)
    assert np.abs(standing.rate).max() < 1e-6
    assert 0.0 < standing.position[0] - before[0] < 0.03
    held = rails.send(np.array([0.0, 0.0, 0.0]), np.zeros(3), 2.0)
    assert held == pytest.approx(standing.position, abs=1e-9)
    assert rails.read(4.0).position == pytest.approx(standing.position, abs=1e-9)
    rails.stop(4.0)


def test_brakes_without_turning_back() -> None:
    rails = open_rails()
    drive(rails, 100)
    rails.stop(1.0)
    places = [rails.read(1.0 + 0.05 * k).position[0] for k in range(20)]
    assert np.diff(places).min() >= 0.0


def test_time_that_runs_backwards_moves_nothing() -> None:
    rails = open_rails()
    drive(rails, 100)
    at_end = rails.read(1.0).position
    assert rails.read(0.5).position.tolist() == at_end.tolist()


def test_injected_failure_comes_out_of_send_and_read() -> None:
    rails = open_rails()
    rails.fail(LinkTimeout("rails.x", "no answer"))
    with pytest.raises(LinkTimeout, match=r"rails\.x: no answer"):
        rails.read(0.1)
    with pytest.raises(LinkTimeout):
        rails.send(np.zeros(3), np.zeros(3), 0.1)
    rails.stop(0.1)
    rails.close()


def test_closed_and_unopened_mocks_do_not_answer() -> None:
    rails = MockAxes("rails", rails_config())
    rails.stop(0.0)
    with pytest.raises(LinkLost, match="is not open"):
        rails.read(0.0)
    rails.open(0.0)
    rails.close()
    rails.close()
    with pytest.raises(LinkLost, match="is closed"):
        rails.send(np.zeros(3), np.zeros(3), 0.0)


def test_turntable_moves_in_radians() -> None:
    axis = {"travel_deg": (-90.0, 90.0), "rate_max_degps": 30.0, "acceleration_max_degps2": 60.0}
    servo = {"gain_per_s": 10.0, "lag_s": 0.02}
    config = Turntable.model_validate({"driver": "mock", "servo": servo, "roll": axis, "pitch": axis, "yaw": axis})
    table = MockAxes("turntable", config)
    assert table.axis_names == ("turntable.roll", "turntable.pitch", "turntable.yaw")
    table.open(0.0)
    accepted = table.send(np.array([0.1, 2.0, 0.0]), np.zeros(3), 0.0)
    assert accepted == pytest.approx([0.1, np.pi / 2.0, 0.0])
    assert table.read(10.0).position == pytest.approx(accepted, abs=1e-3)
