"""The plan of a scenario: phases, slew, drift of a start in motion, aborts; and what it asks of the axes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.bench import reachability
from hil.checks.planned_trajectory import PlanSample, control_bounds, moments
from hil.checks.reachability import axis_demands
from hil.config.load import load_scenario
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import REFERENCE, new
from hil.gnc import guidance
from hil.gnc.guidance import GUIDANCE_STATE
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params


def _plan(*settings: str, scheme: str = "scheme-1") -> list[PlanSample]:
    return moments(load_scenario(scheme, settings).value)


def _approach(plan: list[PlanSample]) -> list[PlanSample]:
    return [moment for moment in plan if moment.abort_s is None]


def test_plan_goes_from_the_start_through_every_phase_to_the_end_of_the_list() -> None:
    plan = _approach(
        _plan(
            'gnc.guidance.sequence=["approach", "look", "hold", "dock", "back"]',
            "gnc.guidance.phases.look.kind=wait",
            "gnc.guidance.phases.look.end_time_s=200.0",
            "gnc.guidance.phases.hold.kind=hold",
            "gnc.guidance.phases.hold.duration_s=30.0",
            "gnc.guidance.phases.dock.kind=final",
            "gnc.guidance.phases.dock.point_m=[0.2, 0.0, 0.0]",
            "gnc.guidance.phases.back.kind=retreat",
            "gnc.guidance.phases.back.point_m=[3.0, 0.0, 0.0]",
        )
    )
    np.testing.assert_allclose(plan[0].r_CT_H, [5.0, -0.3, 0.3])
    np.testing.assert_allclose(plan[-1].r_CT_H, [3.0, 0.0, 0.0])
    assert np.all(np.diff([moment.t_s for moment in plan]) >= 0.0)
    docked = next(moment for moment in plan if abs(moment.r_CT_H[0] - 0.2) < 1e-9)
    assert docked.point_key == "gnc.guidance.phases.dock.point_m"
    assert docked.t_s > 230.0
    assert plan[-1].point_key == "gnc.guidance.phases.back.point_m"


def test_wait_for_an_order_is_taken_to_end_at_once() -> None:
    plan = _approach(
        _plan(
            'gnc.guidance.sequence=["approach", "ready", "dock"]',
            "gnc.guidance.phases.dock.kind=final",
            "gnc.guidance.phases.dock.point_m=[0.25, 0.0, 0.0]",
        )
    )
    reached = next(moment.t_s for moment in plan if moment.r_CT_H[0] < 0.4 + 1e-9)
    line_s = 0.15 / 0.03 + 0.5 * 0.03 / 0.006 + 0.5 * 0.03 / 0.008  # cruise and half of each ramp
    assert plan[-1].t_s == pytest.approx(reached + line_s, abs=0.3)
    assert plan[-1].r_CT_H[0] == pytest.approx(0.25)


def test_attitude_error_goes_at_the_slew_rate() -> None:
    plan = _approach(_plan("initial.attitude_deg=[4.0, 0.0, 0.0]", "gnc.control.slew_rate_degps=0.5"))
    for moment in plan:
        np.testing.assert_allclose(np.degrees(moment.rotation), [max(0.0, 4.0 - 0.5 * moment.t_s), 0.0, 0.0], atol=1e-9)
    assert sum(moment.rotation.any() for moment in plan) >= 8


def test_start_in_motion_drifts_until_it_is_stopped() -> None:
    moved = _plan("initial.velocity_mps=[0.0, 0.02, 0.0]", "initial.rate_degps=[0.0, 0.0, -0.3]")[1]
    # a lead between 6 periods of 0.14 s and 20 s, and 10 N on 1000 kg
    lead_s = math.sqrt(0.84 * 20.0)
    np.testing.assert_allclose(moved.r_CT_H, [5.0, -0.3 + 0.02 * lead_s + 0.02**2 / 0.02, 0.3], atol=1e-9)
    assert math.degrees(moved.rotation[2]) < -3.0 - 0.3 * 0.84
    assert (moved.point_key, moved.rotation_key) == ("initial.velocity_mps", "initial.rate_degps")


@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2", "scheme-3"])
def test_flown_reference_and_every_abort_stay_within_the_planned_box(scheme: str) -> None:
    """The plan is sampled thinly; guidance sampled closely must not leave what it spans."""
    scenario = load_scenario(scheme).value
    params = gnc_params.guidance(scenario)
    plan = moments(scenario)
    places = np.array([moment.r_CT_H for moment in plan])
    speeds = np.abs([moment.v_CT_H for moment in plan])
    low, high, fastest = places.min(axis=0) - 1e-3, places.max(axis=0) + 1e-3, speeds.max(axis=0) * 1.05 + 1e-4
    flown, reference = new(GUIDANCE_STATE), new(REFERENCE)
    guidance.start(params, flown)
    for t_s in np.arange(0.0, 400.0, 1.7):
        guidance.advance(params, flown, t_s, 0, 0)
        guidance.reference(params, flown, t_s, reference)
        aborted, out = new(GUIDANCE_STATE), new(REFERENCE)
        guidance.start_abort(params, aborted, t_s, reference.r_CT_H, reference.v_CT_H)
        for later in (0.0, 0.5, 1.0, 2.0, 5.0, 20.0, 60.0, 100.0, 300.0):
            guidance.advance(params, aborted, t_s + later, 0, 0)
            guidance.reference(params, aborted, t_s + later, out)
            assert np.all((out.r_CT_H >= low) & (out.r_CT_H <= high)), (t_s, later)
            assert np.all(np.abs(out.v_CT_H) <= fastest), (t_s, later)


def test_every_moment_of_the_approach_has_an_abort() -> None:
    plan = _plan()
    begun = {moment.abort_s for moment in plan if moment.abort_s is not None}
    assert begun == {moment.t_s for moment in _approach(plan)}


def test_band_is_table_iii_at_the_ready_point_and_a_fraction_of_the_corridor_farther_out(
    scheme_1: Scenario, mock_rig: Rig
) -> None:
    asked = axis_demands(scheme_1, mock_rig)
    nearest = int(np.argmin([moment.far_m for moment in asked.plan]))
    np.testing.assert_allclose(asked.margin_m[nearest], [0.03, 0.02, 0.02], atol=1e-9)
    start = asked.plan[0]
    range_m = math.hypot(5.0, 0.3, 0.3)
    assert start.far_m == pytest.approx(range_m)
    wider = 0.25 * math.tan(math.radians(5.0)) * (range_m - 0.4)
    np.testing.assert_allclose(asked.margin_m[0], np.array([0.03, 0.02, 0.02]) + wider)


def test_lever_arm_moves_the_rails_with_the_attitudes_band(mock_rig: Rig) -> None:
    params = bench_params.bench(mock_rig, 0.02)  # lever arm 0.35 m along z
    band = math.radians(2.0)
    level = reachability.attitude(params, np.zeros(3), band)
    np.testing.assert_allclose(level.planned, [0.0, 0.0, -0.35, 0.0, 0.0, 0.0], atol=1e-12)
    swing = 0.35 * math.sin(band)
    np.testing.assert_allclose(level.corners[:, :2].max(axis=0), [swing, swing], rtol=0.03)
    np.testing.assert_allclose(np.degrees(level.corners[:, 3:].max(axis=0)), 2.0, rtol=0.05)
    # a rotation about y at 1 rad/s carries the rotation centre along x at the arm's length
    assert abs(level.turned[0, 1]) == pytest.approx(0.35)
    np.testing.assert_allclose(level.turned[3:], np.eye(3), atol=1e-12)


def test_travel_includes_the_braking_distance(mock_rig: Rig) -> None:
    params = bench_params.bench(mock_rig, 0.02)
    level = reachability.attitude(params, np.zeros(3), 0.0)
    at, fast = np.array([[1.0, 0.0, 0.35]]), np.array([[0.3, 0.0, 0.0]])
    asked = reachability.envelope(
        params, [level], at, fast, np.array([[0.1, 0.0, 0.0]]), reachability.ControlBounds(*[np.zeros(3)] * 4)
    )
    room = 0.3**2 / (2.0 * 0.6)
    np.testing.assert_allclose(asked.high[0, :3], [1.0 + 0.1 + room, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(asked.low[0, :3], [1.0 - 0.1 - room, 0.0, 0.0], atol=1e-12)


def test_control_bounds_cover_what_the_control_can_do(scheme_1: Scenario) -> None:
    free = control_bounds(scheme_1)
    # 0.006 m/s of correction and one burn of 0.14 s with 10 N on 1000 kg; four thrusters of 5 N push along x
    np.testing.assert_allclose(free.speed, 0.006 + 0.14 * 0.01)
    assert free.acceleration[0] == pytest.approx(1.25 * 4 * 5.0 / 1000.0)
    assert np.all(np.degrees(free.rate) > 0.3)
    assert np.all(np.degrees(free.rate) < 0.6)
