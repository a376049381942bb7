"""The reference line, and the ready times of the bench paper."""

from __future__ import annotations

import numpy as np
import pytest

from hil import parameters
from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.gnc.guidance import reference
from hil.maths.profile import duration
from hil.messages import REFERENCE, new


def at(params: np.record, t_s: float) -> np.record:
    out = new(REFERENCE)
    reference(params, t_s, out)
    return out


def test_line_runs_straight_from_the_start_to_the_ready_point(scheme_2: Scenario) -> None:
    params = parameters.guidance(scheme_2)
    start, ready = np.array([10.0, -0.5, 0.5]), np.array([0.4, 0.0, 0.0])
    np.testing.assert_allclose(at(params, 0.0).r_CT_H, start)
    np.testing.assert_allclose(at(params, 1000.0).r_CT_H, ready)
    for t_s in (1.0, 50.0, 200.0, 322.0):
        found = at(params, t_s)
        np.testing.assert_allclose(np.cross(found.r_CT_H - start, ready - start), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.cross(found.v_CT_H, ready - start), 0.0, atol=1e-12)
        assert found.v_CT_H @ (ready - start) > 0.0
        np.testing.assert_array_equal(found.q_CH, [0.0, 0.0, 0.0, 1.0])


def test_velocity_and_acceleration_are_derivatives_of_the_position(scheme_1: Scenario) -> None:
    params, h = parameters.guidance(scheme_1), 1e-3
    for t_s in (2.0, 80.0, 156.0):
        found, before, after = at(params, t_s), at(params, t_s - h), at(params, t_s + h)
        np.testing.assert_allclose(found.v_CT_H, (after.r_CT_H - before.r_CT_H) / (2.0 * h), atol=1e-9)
        np.testing.assert_allclose(found.a_CT_H, (after.v_CT_H - before.v_CT_H) / (2.0 * h), atol=1e-9)


def test_line_begins_and_ends_at_rest_and_holds_the_ready_point(scheme_1: Scenario) -> None:
    params = parameters.guidance(scheme_1)
    for t_s in (-1.0, 0.0, 170.0, 400.0):
        np.testing.assert_array_equal([*at(params, t_s).v_CT_H, *at(params, t_s).a_CT_H], 0.0)
    np.testing.assert_array_equal(at(params, 170.0).r_CT_H, at(params, 400.0).r_CT_H)


def test_start_at_the_ready_point_is_a_hold(scheme_1: Scenario) -> None:
    params = parameters.guidance(scheme_1)
    params.start = params.ready
    found = at(params, 5.0)
    np.testing.assert_array_equal(found.r_CT_H, params.ready)
    np.testing.assert_array_equal(found.v_CT_H, 0.0)


@pytest.mark.parametrize(("name", "published_s"), [("scheme-1", 162.0), ("scheme-2", 326.0), ("scheme-3", 326.0)])
def test_line_takes_about_the_published_time(name: str, published_s: float) -> None:
    params = parameters.guidance(load_scenario(name).value)
    length = float(np.linalg.norm(params.ready - params.start))
    taken = duration(length, params.speed, params.acceleration, params.deceleration)
    assert taken == pytest.approx(published_s, abs=5.0)
    assert params.speed == 0.03
