"""The reference: phases in their order, the line of the bench paper's schemes, the abort's way out."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import REFERENCE, new
from hil.gnc.guidance import GUIDANCE_STATE, HOLDS_HOLD, advance, reference, start, start_abort
from hil.maths import euler, quat
from hil.models.profile import along_line, duration
from hil.params import gnc as gnc_params


def begun(params: np.record) -> np.record:
    state = new(GUIDANCE_STATE)
    start(params, state)
    return state


def at(params: np.record, state: np.record, t_s: float, go: int = 0, held: int = 0) -> np.record:
    """Return the reference at ``t_s``, the phases moved on to it."""
    out = new(REFERENCE)
    advance(params, state, t_s, go, held)
    reference(params, state, t_s, out)
    return out


def listed(*settings: str) -> np.record:
    """Return the parameters of scheme 1 with ``settings``, each without its gnc.guidance. in front."""
    scenario = load_scenario("scheme-1", [f"gnc.guidance.{text}" for text in settings]).value
    return gnc_params.guidance(scenario)


@pytest.mark.parametrize(("name", "start_m"), [("scheme-1", [5.0, -0.3, 0.3]), ("scheme-2", [10.0, -0.5, 0.5])])
def test_shipped_list_is_one_straight_line_to_the_ready_point_and_a_hold(name: str, start_m: list[float]) -> None:
    params = gnc_params.guidance(load_scenario(name).value)
    state, out = begun(params), np.empty(3)
    way = np.array([0.4, 0.0, 0.0]) - start_m
    length = float(np.linalg.norm(way))
    for t_s in np.arange(0.0, 400.0, 1.7):
        along_line(length, 0.03, 0.006, 0.008, t_s, out)
        found = at(params, state, t_s)
        np.testing.assert_allclose(found.r_CT_H, start_m + out[0] * way / length, atol=1e-12)
        np.testing.assert_allclose(found.v_CT_H, out[1] * way / length, atol=1e-12)
        np.testing.assert_allclose(found.a_CT_H, out[2] * way / length, atol=1e-12)
        np.testing.assert_array_equal(found.q_CH, [0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize(("name", "published_s"), [("scheme-1", 162.0), ("scheme-2", 326.0)])
def test_line_takes_about_the_published_time(name: str, published_s: float) -> None:
    params = gnc_params.guidance(load_scenario(name).value)
    length = float(np.linalg.norm(params.point[0] - params.start))
    taken = duration(length, params.speed[0], params.acceleration[0], params.deceleration[0])
    assert taken == pytest.approx(published_s, abs=5.0)
    assert params.speed[0] == 0.03


def test_start_at_the_ready_point_is_a_hold() -> None:
    params = listed()
    params.start = params.point[0]
    found = at(params, begun(params), 5.0)
    np.testing.assert_array_equal(found.r_CT_H, params.point[0])
    np.testing.assert_array_equal(found.v_CT_H, 0.0)


FIVE = (
    'sequence=["approach","pause","near","ready","dock"]',
    "phases.approach.point_m=[2.0,0.0,0.0]",
    "phases.pause.kind=hold",
    "phases.pause.duration_s=20.0",
    "phases.near.kind=approach",
    "phases.near.speed_mps=0.01",
    "phases.dock.kind=final",
    "phases.dock.point_m=[0.2,0.0,0.0]",
)


def test_phases_follow_each_other_in_the_order_of_the_sequence() -> None:
    params = listed(*FIVE)
    state = begun(params)
    seen = [int(at(params, state, t_s).phase) for t_s in np.arange(0.0, 600.0, 0.5)]
    assert [phase for i, phase in enumerate(seen) if i == 0 or seen[i - 1] != phase] == [0, 1, 2, 3]
    assert seen.count(1) * 0.5 == pytest.approx(20.0, abs=0.5)


def test_reference_is_continuous_over_all_changes_of_phase() -> None:
    params = listed(*FIVE)
    state = begun(params)
    rows = [at(params, state, t_s, go=int(t_s == 400.0)) for t_s in np.arange(0.0, 450.0, 0.02)]
    positions, rates = (np.array([row[name] for row in rows]) for name in ("r_CT_H", "v_CT_H"))
    assert np.abs(np.diff(positions, axis=0)).max() <= 0.03 * 0.02 + 1e-9
    assert np.abs(np.diff(rates, axis=0)).max() <= 0.008 * 0.02 + 1e-9
    np.testing.assert_allclose(positions[-1], [0.2, 0.0, 0.0])


def test_wait_ends_at_the_order_and_a_final_phase_is_held_without_leave() -> None:
    params = listed(*FIVE)
    state = begun(params)
    assert at(params, state, 500.0).phase == 3
    assert at(params, state, 501.0, go=1, held=1).phase == 3
    assert at(params, state, 502.0, go=1, held=0).phase == 4
    assert at(params, state, 502.0).r_CT_H[0] == pytest.approx(0.4)


def test_wait_ends_at_its_time() -> None:
    params = listed(*FIVE, "phases.ready.end_time_s=480.0")
    state = begun(params)
    assert at(params, state, 479.9).phase == 3
    assert at(params, state, 480.0).phase == 4


@pytest.mark.parametrize("r", [[0.4, 0.0, 0.0], [3.0, 0.4, -0.2], [4.9, 0.0, 0.1]])
@pytest.mark.parametrize("v", [[-0.03, 0.0, 0.0], [-0.035, 0.01, -0.01], [0.02, 0.0, 0.0], [0.0, 0.0, 0.0]])
def test_abort_brakes_and_retreats_without_ever_coming_nearer_than_its_brake_needs(
    r: list[float], v: list[float]
) -> None:
    params = listed()
    state = begun(params)
    start_abort(params, state, 100.0, np.array(r), np.array(v))
    rows = [at(params, state, t_s) for t_s in np.arange(100.0, 400.0, 0.1)]
    distance = np.array([np.linalg.norm(row.r_CT_H) for row in rows])
    brake_way = float(np.dot(v, v)) / (2.0 * params.brake)
    assert distance.min() >= distance[0] - brake_way - 1e-9
    assert brake_way < 0.05
    turned = int(np.argmin(distance))
    assert (np.diff(distance[turned:]) >= -1e-9).all()
    assert distance[-1] == pytest.approx(max(params.abort_distance, math.hypot(*r)), abs=1e-9)
    np.testing.assert_allclose(rows[-1].v_CT_H, 0.0)
    np.testing.assert_allclose(rows[0].v_CT_H, v, atol=1e-12)
    assert rows[0].phase == (2 if any(v) else 3)  # nothing to brake: the retreat begins at once
    assert rows[-1].phase == 4


def test_abort_behind_the_target_goes_straight_away_from_it() -> None:
    params = listed()
    state = begun(params)
    start_abort(params, state, 0.0, np.array([-0.5, 0.2, 0.0]), np.zeros(3))
    rows = [at(params, state, t_s) for t_s in np.arange(0.0, 200.0, 0.5)]
    distance = np.array([np.linalg.norm(row.r_CT_H) for row in rows])
    assert (np.diff(distance) >= -1e-12).all()
    np.testing.assert_allclose(np.cross(rows[-1].r_CT_H, [-0.5, 0.2, 0.0]), 0.0, atol=1e-9)


def test_abort_distance_is_no_farther_than_the_start(scheme_1: Scenario) -> None:
    params = gnc_params.guidance(load_scenario("scheme-1", ["initial.position_m=[3.0,0.0,0.0]"]).value)
    assert params.abort_distance == 3.0


def test_heavy_chaser_brakes_no_harder_than_its_thrusters_can() -> None:
    params = gnc_params.guidance(load_scenario("scheme-1", ["chaser.mass_kg=2000.0"]).value)
    assert params.brake == pytest.approx(0.9 * 20.0 / 2000.0)


def test_fly_around_keeps_the_camera_on_the_target_and_its_rates_are_derivatives() -> None:
    params = listed(
        'sequence=["approach", "around", "ready"]',
        "phases.approach.point_m=[3.0, 0.0, 0.0]",
        'phases.around={ kind = "fly_around", point_m = [1.5, 1.5, 0.0] }',
    )
    state = begun(params)
    ends = duration(float(np.linalg.norm(params.point[0] - params.start)), 0.03, 0.006, 0.008)
    found = [at(params, state, float(t)) for t in np.arange(ends + 1.0, ends + 120.0, 0.05)]
    r, v, a = (np.array([getattr(each, name) for each in found]) for name in ("r_CT_H", "v_CT_H", "a_CT_H"))
    np.testing.assert_allclose(np.gradient(r, 0.05, axis=0)[1:-1], v[1:-1], atol=3e-4)
    np.testing.assert_allclose(np.gradient(v, 0.05, axis=0)[1:-1], a[1:-1], atol=5e-3)
    np.testing.assert_allclose(r[-1], [1.5, 1.5, 0.0], atol=1e-9)
    assert np.abs(a).max() > 5e-3
    for each in found[::100]:  # the docking axis of the chaser, -x, points at the target
        seen = quat.to_matrix(each.q_CH) @ each.r_CT_H
        np.testing.assert_allclose(seen / np.linalg.norm(seen), [1.0, 0.0, 0.0], atol=1e-9)
        np.testing.assert_array_equal(each.from_H, each.r_CT_H)


def test_slew_ends_at_its_attitude_which_stays_in_an_abort() -> None:
    params = listed(
        'sequence=["turn", "ready"]', 'phases.turn={ kind = "slew", attitude_deg = [0.0, 5.0, -3.0], rate_degps = 0.5 }'
    )
    wanted = euler.to_quaternion(np.radians([0.0, 5.0, -3.0]), euler.YAW_PITCH_ROLL)
    state = begun(params)
    turning = at(params, state, 5.0)
    assert 0.0 < quat.to_rotation_vector(turning.q_CH)[1] < math.radians(5.0)
    np.testing.assert_array_equal(turning.v_CT_H, 0.0)
    np.testing.assert_allclose(at(params, state, 60.0).q_CH, wanted, atol=1e-12)
    other = begun(params)
    at(params, other, 5.0)
    start_abort(params, other, 5.0, params.start, np.zeros(3))
    np.testing.assert_allclose(at(params, other, 9.0).q_CH, turning.q_CH, atol=1e-12)


def test_hold_lasts_until_it_may_end_and_the_next_phase_begins_then() -> None:
    params = listed(
        'sequence=["stay", "approach"]', "phases.stay.kind='hold'", "phases.stay.duration_s=10.0"
    )  # fmt: skip
    state = begun(params)
    np.testing.assert_array_equal(at(params, state, 25.0, held=HOLDS_HOLD).v_CT_H, 0.0)
    assert state.phase == 0
    at(params, state, 30.0)
    assert (state.phase, state.since_s) == (1, 30.0)
    punctual = begun(params)
    at(params, punctual, 10.01)
    assert (punctual.phase, punctual.since_s) == (1, 10.0)
