"""Transfers: they end where they should, cost hardly more than the least, and are passively safe if that is asked."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import linprog

from hil.checks.abort import check_transfers
from hil.config.load import load_scenario
from hil.core.messages import NAVIGATION, REFERENCE, new
from hil.errors import BadInput
from hil.gnc import guidance
from hil.gnc.estimation.target_orbit import TARGET_ORBIT
from hil.gnc.guidance import GUIDANCE_STATE
from hil.gnc.guidance_transfer import (
    TRANSFER_PLAN,
    least_drift_range,
    on_transfer,
    plan_transfer,
)
from hil.gnc.impulses import TRANSFER_WORK, least_impulses
from hil.maths.kepler import mean_anomaly
from hil.models.elliptic_motion import transition_into
from hil.params import gnc as gnc_params
from tests.support.two_body import AXIS_M, ORBIT_S, N, two_body

NU, BURN_MPS2 = 1.1, 0.05
START = np.array([60.0, -4.0, 9.0, 0.01, -0.02, 0.005])
POINT = np.array([20.0, 1.0, -2.0])


def orbit_of(e: float) -> np.record:
    found = new(TARGET_ORBIT)
    found.mean_motion, found.eccentricity, found.mean_anomaly = N, e, mean_anomaly(e, NU)
    return found


def planned(
    e: float, duration_s: float, optimal: int, start: np.ndarray = START, point: np.ndarray = POINT
) -> np.record:
    plan = new(TRANSFER_PLAN)
    plan_transfer(orbit_of(e), 0.0, duration_s, optimal, BURN_MPS2, start, point, new(TRANSFER_WORK), plan)
    return plan


def total(plan: np.record) -> float:
    return float(np.linalg.norm(plan.impulse[: plan.n], axis=1).sum())


def least_by_linear_programs(e: float, duration_s: float, start: np.ndarray, end: np.ndarray) -> float:
    """Return the largest bound of the primer vector's dual over 65 times: cutting planes, each solved by HiGHS."""
    orbit, whole, columns = orbit_of(e), np.empty((6, 6)), []
    transition_into(N, e, orbit.mean_anomaly, duration_s, whole)
    scale = np.array([1.0 / duration_s] * 3 + [1.0] * 3)
    demand = scale * (end - whole @ start)
    for t_s in np.linspace(0.0, duration_s, 65):
        transition_into(N, e, orbit.mean_anomaly + N * t_s, duration_s - t_s, whole)
        columns.append(scale[:, None] * whole[:, 3:])
    cuts = [column @ axis for column in columns for axis in np.vstack([np.eye(3), -np.eye(3)])]
    while True:
        found = linprog(-demand, A_ub=np.array(cuts), b_ub=np.ones(len(cuts)), bounds=[(None, None)] * 6).x
        primers = [column.T @ found for column in columns]
        longest = max(float(np.linalg.norm(primer)) for primer in primers)
        if longest < 1.0 + 1e-5:
            return float(demand @ found / longest)
        cuts += [
            column @ (primer / np.linalg.norm(primer))
            for column, primer in zip(columns, primers, strict=True)
            if np.linalg.norm(primer) > 1.0
        ]


@pytest.mark.parametrize("e", [0.0, 0.02, 0.09])
@pytest.mark.parametrize(("duration_s", "optimal"), [(600.0, 0), (0.6 * ORBIT_S, 1)])
def test_transfer_ends_at_rest_at_its_point_in_the_motion_of_two_bodies(
    e: float, duration_s: float, optimal: int
) -> None:
    orbit, plan, whole = orbit_of(e), planned(e, duration_s, optimal), np.empty((6, 6))
    state, acceleration = np.empty(6), np.empty(3)

    def thrust(t_s: float) -> np.ndarray:
        on_transfer(orbit, plan, plan.n, t_s, whole, state, acceleration)
        return acceleration

    edges = [plan.at_s[: plan.n] + side * plan.burn_s[: plan.n] for side in (-0.5, 0.5)]
    ends = two_body(e, NU, START, duration_s, thrust, np.clip(np.concatenate(edges), 0.0, duration_s))
    # quadratic in the range of 60 m over the radius of the orbit, which grows along it
    np.testing.assert_allclose(ends[:3], POINT, atol=20.0 * 60.0**2 / AXIS_M)
    np.testing.assert_allclose(ends[3:], 0.0, atol=20.0 * 60.0**2 / AXIS_M * N)
    on_transfer(orbit, plan, plan.n, duration_s, whole, state, acceleration)
    np.testing.assert_allclose(state, [*POINT, 0.0, 0.0, 0.0], atol=1e-3)


@pytest.mark.parametrize("e", [0.0, 0.02, 0.09])
@pytest.mark.parametrize("part", [0.05, 0.4, 1.1])
def test_no_impulses_cost_less_than_the_bound_and_the_plan_hardly_more(e: float, part: float) -> None:
    end, duration_s = np.array([*POINT, 0.0, 0.0, 0.0]), part * ORBIT_S
    bound = least_impulses(orbit_of(e), 0.0, duration_s, START, end, new(TRANSFER_WORK))
    oracle = least_by_linear_programs(e, duration_s, START, end)
    assert 0.99 * oracle < bound < oracle * (1.0 + 1e-4)
    best, two = planned(e, duration_s, 1), planned(e, duration_s, 0)
    assert best.bound == bound
    # burns take |u| / 0.05 m/s^2 of a transfer, up to 2 % of the shortest
    assert bound <= total(best) <= (1.03 if part < 0.1 else 1.012) * bound
    assert total(two) >= (1.0 - 1e-3) * total(best)


def test_radial_hop_over_half_an_orbit_takes_a_quarter_of_n_times_its_length_twice() -> None:
    """x = 4 v / n (1 - cos n t) / 2 by the motion of Clohessy and Wiltshire."""
    found = planned(0.0, 0.5 * ORBIT_S, 1, np.array([100.0, 0, 0, 0, 0, 0]), np.array([80.0, 0.0, 0.0]))
    hop = new(TRANSFER_PLAN)
    hop.n, hop.duration_s, hop.start = 2, 0.5 * ORBIT_S, [100.0, 0, 0, 0, 0, 0]
    hop.at_s[:2], hop.impulse[:2, 2] = [0.0, 0.5 * ORBIT_S], [-N * 20.0 / 4.0] * 2
    hop.burn_s[:2] = 1e-3
    state, aside = np.empty(6), np.empty(3)
    on_transfer(orbit_of(0.0), hop, 2, 0.5 * ORBIT_S + 1e-3, np.empty((6, 6)), state, aside)
    np.testing.assert_allclose(state, [80.0, 0, 0, 0, 0, 0], atol=1e-4)
    assert total(found) <= total(hop) * 1.001


def test_tangential_hop_over_an_orbit_takes_its_length_over_three_orbits_arc() -> None:
    """An impulse v along track moves the chaser by 6 pi v / n per orbit; nothing is cheaper."""
    found = planned(0.0, ORBIT_S, 1, np.array([100.0, 0, 0, 0, 0, 0]), np.array([40.0, 0.0, 0.0]))
    assert total(found) == pytest.approx(2.0 * N * 60.0 / (6.0 * math.pi), rel=5e-3)
    np.testing.assert_allclose(found.impulse[: found.n, 1:], 0.0, atol=2e-4)


def test_two_impulses_half_an_orbit_apart_do_not_move_across_the_plane() -> None:
    assert planned(0.0, 0.5 * ORBIT_S, 0).n == 0
    assert planned(0.0, 0.5 * ORBIT_S, 1).n > 2


def test_burns_that_take_longer_than_the_transfer_are_no_plan() -> None:
    assert planned(0.0, 20.0, 0).n == 0


def transfer(*settings: str) -> np.record:
    return gnc_params.guidance(load_scenario("transfer", settings).value)


def test_transfer_begins_at_the_estimate_of_its_first_cycle_and_ends_at_its_point() -> None:
    params, state, estimate, out = transfer(), new(GUIDANCE_STATE), new(NAVIGATION), new(REFERENCE)
    guidance.start(params, state)
    estimate.valid, estimate.r_CT_H, estimate.v_CT_H = 1, [100.4, -0.2, 0.3], [0.01, 0.0, -0.02]
    guidance.note(state, 59.98, estimate)
    assert guidance.advance(params, state, 60.0, 0, 0) == guidance.MOVED
    guidance.reference(params, state, 60.0, out)
    np.testing.assert_allclose(out.r_CT_H, [100.4002, -0.2, 0.2996], atol=1e-6)
    np.testing.assert_allclose(out.v_CT_H, estimate.v_CT_H, atol=1e-6)
    assert np.linalg.norm(out.a_CT_H) == pytest.approx(0.006)
    guidance.reference(params, state, 560.0, out)
    np.testing.assert_allclose(out.r_CT_H, [30.0, 0.0, 0.0], atol=3e-3)
    assert guidance.advance(params, state, 560.0 + 1e-6, 0, 0) == guidance.MOVED
    guidance.reference(params, state, 570.0, out)
    np.testing.assert_array_equal(out.r_CT_H, [30.0, 0.0, 0.0])


def test_unsafe_transfer_waits_at_rest_and_takes_more_time_until_it_is_safe() -> None:
    params, state, out = transfer(), new(GUIDANCE_STATE), new(REFERENCE)
    params.clear_range = 20.0  # of 18.7 m in 500 s
    guidance.start(params, state)
    guidance.advance(params, state, 60.0, 0, 0)
    assert state.plan.n == 0
    guidance.reference(params, state, 60.0, out)
    np.testing.assert_array_equal(out.v_CT_H, 0.0)
    cycles = 0
    while state.plan.n == 0:
        cycles += 1
        guidance.advance(params, state, 60.0 + 0.02 * cycles, 0, 0)
    assert 500.0 < state.plan.duration_s < 600.0
    assert least_drift_range(params.orbit, state.plan, 6000.0, state.work.whole) >= 20.0
    assert state.since_s == pytest.approx(60.0 + 0.02 * cycles)


def refusal(*settings: str, name: str = "transfer") -> str:
    (problem,) = check_transfers(load_scenario(name, settings))
    return f"{problem.key}: {problem.message}"


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            ("gnc.guidance.phases.to_8.duration_s=300.0",),
            "phases.to_8.duration_s: 300: the drift after a missed burn comes as near as 3.8",
        ),
        (
            ("gnc.guidance.phases.to_30.duration_s=100.0",),
            "phases.to_30.duration_s: 100: no burns with acceleration_mps2 reach point_m in this time",
        ),
        (
            ("gnc.corridor.closing_rate_max_mps=0.1",),
            "phases.to_30.duration_s: 500: closes by 0.0",
        ),
    ],
)
def test_transfer_that_cannot_be_flown_is_refused_before_the_run(settings: tuple[str, ...], text: str) -> None:
    assert text in refusal(*settings)


def test_transfer_in_the_axes_of_a_target_that_tumbles_is_refused() -> None:
    settings = ("gnc.guidance.phases.approach={kind='transfer', duration_s=60.0}".replace("'", '"'),)
    assert 'approach.kind: "transfer": the free motion is that of the Hill frame' in refusal(
        *settings, name="tumbling-1"
    )


def test_keys_of_other_phases_do_not_go_with_a_transfer() -> None:
    with pytest.raises(BadInput, match='speed_mps does not go with kind = "transfer"'):
        load_scenario("transfer", ("gnc.guidance.phases.to_8.speed_mps=0.1",))
    with pytest.raises(BadInput, match='kind = "transfer" needs duration_s'):
        load_scenario("scheme-1", ('gnc.guidance.phases.approach.kind="transfer"',))
