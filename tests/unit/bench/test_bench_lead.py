"""Setpoints taken ahead of their time: by how much, and within which limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.kinematics import BENCH_PARAMS, MOTION, ahead, limit_setpoint
from hil.config.load import load_rig
from hil.core.messages import AXES, new
from hil.params import bench as bench_params

DT = 0.02
places = st.floats(-0.9, 0.9)
rates = st.floats(-0.6, 0.6)


def bench(lead_s: float) -> np.record:
    params = new(BENCH_PARAMS)
    params.dt_s = DT
    params.low, params.high = [-1.0] * 6, [1.0] * 6
    params.rate_max, params.acceleration_max = [0.5] * 6, [0.6] * 6
    params.lead = [lead_s] * 6
    return params


def sent(params: np.record, motion: np.record, place: float, rate: float) -> np.record:
    wanted, out = new(AXES), new(AXES)
    wanted.rail_m, wanted.gimbal_rad = [place] * 3, [place] * 3
    wanted.rail_mps, wanted.gimbal_radps = [rate] * 3, [rate] * 3
    limit_setpoint(params, motion, wanted, out)
    return out


def moving(place: float, rate: float) -> np.record:
    motion = new(MOTION)
    motion.position, motion.rate = [place] * 6, [rate] * 6
    return motion


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(allow_nan=True, allow_infinity=True))
def test_without_a_lead_a_setpoint_stays_as_it_is_to_the_last_bit(place: float, rate: float) -> None:
    found = ahead(place, rate, 0.0)
    assert found == place
    assert math.copysign(1.0, found) == math.copysign(1.0, place)


@pytest.mark.parametrize("lead_s", [0.015, -0.0107])
def test_moving_axis_is_commanded_ahead_by_its_lead(lead_s: float) -> None:
    rate = 0.04
    out = sent(bench(lead_s), moving(0.3 + rate * lead_s - rate * DT, rate), 0.3, rate)
    np.testing.assert_allclose([*out.rail_m, *out.gimbal_rad], 0.3 + rate * lead_s, rtol=1e-15)
    np.testing.assert_array_equal([*out.rail_mps, *out.gimbal_radps], rate)


def test_standing_axis_is_commanded_to_its_place_whatever_its_lead() -> None:
    np.testing.assert_array_equal(sent(bench(0.1), moving(0.3, 0.0), 0.3, 0.0).rail_m, 0.3)


@given(st.lists(st.tuples(places, rates), min_size=1, max_size=30), st.floats(-0.2, 0.2))
def test_limits_hold_for_what_is_sent_and_not_only_for_what_was_wanted(
    wishes: list[tuple[float, float]], lead_s: float
) -> None:
    params, motion = bench(lead_s), moving(0.0, 0.0)
    position, rate = 0.0, 0.0
    for place, speed in wishes:
        out = sent(params, motion, place, speed)
        step = (float(out.rail_m[0]) - position) / DT
        assert abs(out.rail_m[0]) <= 1.0
        assert abs(step) <= 0.5 * (1.0 + 1e-6)
        assert abs(step - rate) <= 0.6 * DT * (1.0 + 1e-6) + 1e-9
        position, rate = float(out.rail_m[0]), step


def test_leads_of_the_rig_file_reach_their_own_axes() -> None:
    settings = ("rig.rails.y.lead_s=0.02", "rig.turntable.yaw.lead_s=-0.01")
    np.testing.assert_array_equal(
        bench_params.bench(load_rig("mock", settings).value, DT).lead, [0.0, 0.02, 0.0, 0.0, 0.0, -0.01]
    )


@pytest.mark.parametrize("rig", ["mock", "emulated"])
def test_shipped_rigs_have_no_lead(rig: str) -> None:
    np.testing.assert_array_equal(bench_params.bench(load_rig(rig).value, DT).lead, 0.0)
