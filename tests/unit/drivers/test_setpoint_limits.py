"""Limits of setpoints, the same for every driver of axes."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.rig import Rig
from hil.drivers.axes import SetpointLimits
from hil.errors import SafetyTrip


@pytest.fixture
def limits(mock_rig: Rig) -> SetpointLimits:
    return SetpointLimits("rails", mock_rig.rails)


def test_axis_that_is_limited_in_position_gets_no_rate(limits: SetpointLimits) -> None:
    inside, rate = 0.5 * (limits.low + limits.high), 0.5 * limits.rate_max
    beyond = inside + np.array([0.0, 10.0, 0.0])
    position, accepted = limits.accepted(beyond, rate, jogging=False)
    np.testing.assert_array_equal(position, [inside[0], limits.high[1], inside[2]])
    np.testing.assert_array_equal(accepted, [rate[0], 0.0, rate[2]])
    for found, given in zip(limits.accepted(beyond, rate, jogging=True), (beyond, rate), strict=True):
        np.testing.assert_array_equal(found, given)


def test_rate_is_limited_and_a_value_must_be_finite(limits: SetpointLimits) -> None:
    inside = 0.5 * (limits.low + limits.high)
    np.testing.assert_array_equal(limits.accepted(inside, -10.0 * limits.rate_max, False)[1], -limits.rate_max)
    goal, speed = limits.accepted_goal(inside + 100.0, -0.5 * limits.rate_max)
    np.testing.assert_array_equal(goal, limits.high)
    np.testing.assert_array_equal(speed, 0.5 * limits.rate_max)
    with pytest.raises(SafetyTrip, match=r"rails\.y: rate"):
        limits.accepted(inside, np.array([0.0, np.nan, 0.0]), False)
