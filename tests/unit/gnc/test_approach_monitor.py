"""Corridor, closing rate, ready state: margins by hand, and what makes an abort."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import NAVIGATION, REFERENCE, SUPERVISION, new
from hil.gnc import approach_monitor
from hil.gnc.approach_monitor import (
    CLOSING_RATE,
    CORRIDOR,
    NOT_ABORTED,
    ORDERED,
    alert_limits,
    closing_limit,
    closing_margin,
    corridor_margin,
    level_share,
)
from hil.gnc.docking_go import ENCODERS, FIRING, GO, GO_CHECK, HOLD, LEVEL, SUM
from hil.gnc.reactions import REACTION_STATE
from hil.params import gnc as gnc_params

FAR, READY = np.array([5.0, 0.0, 0.0]), np.array([0.4, 0.0, 0.0])


@pytest.fixture
def params(scheme_1: Scenario) -> np.record:
    """Return the shipped parameters."""
    return gnc_params.approach_monitor(scheme_1)


def line() -> np.record:
    reference = new(REFERENCE)
    reference.from_H, reference.to_H = FAR, READY
    return reference


def seen(r: tuple[float, float, float], v: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.record:
    navigation = new(NAVIGATION)
    navigation.valid, navigation.r_CT_H, navigation.v_CT_H, navigation.q_CH = 1, r, v, [0.0, 0.0, 0.0, 1.0]
    return navigation


def check(
    params: np.record,
    t_s: float,
    navigation: np.record,
    reference: np.record,
    ordered: int,
    converged: int,
    found: np.record,
    go: np.record | None = None,
) -> bool:
    """Check an approach that has begun inside its corridor, if the filters have converged."""
    reactions = new(REACTION_STATE)
    reactions.converged = reactions.entered = converged
    share = level_share(params, navigation, reactions.level, reactions.limit)  # as ``reactions.acquire`` writes it
    reactions.beyond = 0 if share <= 1.0 else 1
    certain = new(GO_CHECK) if go is None else go
    return bool(approach_monitor.check(params, t_s, navigation, reference, ordered, reactions, certain, found))


def test_corridor_is_a_cone_with_a_least_radius(params: np.record) -> None:
    off = corridor_margin(params, FAR, READY, np.array([4.0, 0.3, 0.0]))
    assert off == pytest.approx(math.hypot(4.0, 0.3) * math.tan(math.radians(5.0)) - 0.3)
    near = corridor_margin(params, FAR, READY, np.array([0.6, 0.0, 0.04]))
    assert near == pytest.approx(0.1 - 0.04)
    beyond = corridor_margin(params, FAR, READY, np.array([0.28, 0.0, 0.0]))
    assert beyond == pytest.approx(0.1 - 0.12)  # overshoot counts as leaving


def test_closing_rate_limit_grows_with_range_up_to_its_greatest(params: np.record) -> None:
    assert closing_limit(params, 0.2) == pytest.approx(0.02)
    assert closing_limit(params, 0.4) == pytest.approx(0.02)
    assert closing_limit(params, 0.44) == pytest.approx(0.02 + 0.3 * 0.04)
    assert closing_limit(params, 8.0) == pytest.approx(0.04)


def test_closing_rate_is_the_rate_of_the_range(params: np.record) -> None:
    r, v = np.array([3.0, 4.0, 0.0]), np.array([-0.03, -0.01, 0.5])
    assert closing_margin(params, r, v) == pytest.approx(0.04 - (0.03 * 3.0 + 0.01 * 4.0) / 5.0)
    assert closing_margin(params, r, -v) > 0.04


@pytest.mark.parametrize(
    ("r", "v", "cause"),
    [
        ((3.0, 0.5, 0.0), (0.0, 0.0, 0.0), CORRIDOR),
        ((3.0, 0.0, 0.0), (-0.05, 0.0, 0.0), CLOSING_RATE),
        ((0.41, 0.0, 0.0), (-0.03, 0.0, 0.0), CLOSING_RATE),
    ],
)
def test_broken_limit_aborts_after_its_persistence(
    params: np.record, r: tuple[float, float, float], v: tuple[float, float, float], cause: int
) -> None:
    watch = new(SUPERVISION)
    found = [check(params, 0.02 * k, seen(r, v), line(), 0, 1, watch) for k in range(8)]
    assert found == [False] * (params.persistence - 1) + [True] + [False] * (8 - params.persistence)
    assert watch.aborted == cause
    assert watch.aborted_at_s == pytest.approx(0.02 * (params.persistence - 1))


def test_limit_that_is_broken_now_and_then_does_not_abort(params: np.record) -> None:
    watch = new(SUPERVISION)
    for k in range(100):
        y = 0.5 if k % params.persistence else 0.0
        assert not check(params, 0.02 * k, seen((3.0, y, 0.0)), line(), 0, 1, watch)


@pytest.mark.parametrize(
    ("level", "sigma", "cause"), [(0.05, 0.0, NOT_ABORTED), (0.2, 0.0, CORRIDOR), (0.0, 0.01, CLOSING_RATE)]
)
def test_estimate_that_is_not_sure_is_permitted_less(params: np.record, level: float, sigma: float, cause: int) -> None:
    watch, navigation = new(SUPERVISION), seen((3.0, 0.1, 0.0), (-0.03, 0.0, 0.0))
    navigation.protection_level_m, navigation.sigma_v_mps = level, sigma
    for k in range(100):
        check(params, 0.02 * k, navigation, line(), 0, 1, watch)
    assert min(watch.corridor_margin_m, watch.closing_margin_mps) > 0.0
    assert watch.aborted == cause


def test_estimate_that_still_converges_does_not_abort(params: np.record) -> None:
    watch, navigation = new(SUPERVISION), seen((3.0, 0.5, 0.0), (-0.05, 0.0, 0.0))
    navigation.sigma_r_m = navigation.sigma_v_mps = 0.2
    for k in range(100):
        assert not check(params, 0.02 * k, navigation, line(), 0, 0, watch)
    assert watch.corridor_margin_m < 0.0
    assert watch.aborted == NOT_ABORTED


@pytest.mark.parametrize(
    ("r", "levels", "angle", "protected"),
    [
        ((0.4, 0.0, 0.0), (0.09, 0.0, 0.0), 0.0, True),
        ((0.4, 0.0, 0.0), (0.11, 0.0, 0.0), 0.0, False),
        ((0.4, 0.0, 0.0), (0.0, 0.035, 0.035), 0.0, True),
        ((0.4, 0.0, 0.0), (0.0, 0.04, 0.04), 0.0, False),
        ((5.0, 0.0, 0.0), (0.5, 0.15, 0.15), 0.0, True),
        ((5.0, 0.0, 0.0), (0.6, 0.0, 0.0), 0.0, False),
        ((5.0, 0.0, 0.0), (0.1, 0.1, 0.1), math.radians(1.1), False),
        ((0.3, 0.0, 0.0), (0.06, 0.0, 0.0), 0.0, False),  # the keep-out of 0.25 m is nearer
        ((5.0, 0.0, 0.0), (math.nan, math.nan, math.nan), math.nan, True),
    ],
)
def test_alert_limits_follow_range_and_corridor(
    params: np.record, r: tuple[float, float, float], levels: tuple[float, float, float], angle: float, protected: bool
) -> None:
    navigation = seen(r)
    navigation.protection_level_m, navigation.protection_level_rad = levels, angle
    assert (level_share(params, navigation, np.empty(3), np.empty(3)) <= 1.0) == protected


def test_alert_limits_leave_the_bodies_of_chaser_and_target_apart() -> None:
    camera = '{on = "chaser", vertices_m = [[0.0, 0.0, 0.0], [-0.2, 0.0, 0.0]], radius_m = 0.05}'
    mast = '{on = "target", vertices_m = [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], radius_m = 0.1}'
    settings = (f"keep_out.bodies=[{camera}, {mast}]", "keep_out.distance_m=0.05")
    params = gnc_params.approach_monitor(load_scenario("scheme-1", settings).value)
    plain, limits = gnc_params.approach_monitor(load_scenario("scheme-1").value), np.empty((2, 3))
    q, turn_m = np.array([0.0, 0.0, 0.0, 1.0]), math.radians(1.0) * 0.25  # the camera, by an error of the attitude
    for closing in (0.0, 0.03):
        v = np.array([-closing, 0.0, 0.0])
        alert_limits(params, np.array([0.5, 0.0, 0.0]), v, q, limits[0])
        left = 0.5 - 0.25 - 0.1 - 0.05 - turn_m - closing**2 / (2.0 * 0.018)
        assert limits[0, :2] == pytest.approx(np.minimum([0.11, 0.05], left / math.sqrt(2.0)))
    alert_limits(params, np.array([0.405, 0.0, 0.0]), np.zeros(3), q, limits[0])
    assert limits[0, :2] == pytest.approx((0.005 - turn_m) / math.sqrt(2.0))
    alert_limits(params, np.array([0.35, 0.0, 0.0]), np.zeros(3), q, limits[0])
    assert not limits[0, :2].any()
    for given, found in zip((plain, params), limits, strict=True):
        alert_limits(given, np.array([3.0, 0.1, 0.0]), np.zeros(3), q, found)
    assert np.array_equal(limits[0], limits[1])


@pytest.mark.parametrize(("health", "level"), [(2, 0.01), (0, 0.2)])
def test_estimate_that_is_not_healthy_or_not_protected_is_not_ready(
    params: np.record, health: int, level: float
) -> None:
    watch, navigation = new(SUPERVISION), seen((0.4, 0.0, 0.0))
    navigation.protection_level_m = 0.01
    check(params, 1.0, navigation, line(), 0, 1, watch)
    assert not math.isnan(watch.ready_since_s)
    navigation.health, navigation.protection_level_m = health, level
    check(params, 2.0, navigation, line(), 0, 1, watch)
    assert math.isnan(watch.ready_since_s)


def test_order_aborts_at_once_and_only_once(params: np.record) -> None:
    watch = new(SUPERVISION)
    assert check(params, 1.0, seen((3.0, 0.0, 0.0)), line(), 1, 1, watch)
    assert watch.aborted == ORDERED
    assert not check(params, 1.02, seen((3.0, 0.0, 0.0)), line(), 1, 1, watch)


def test_rehearsal_aborts_at_its_time(params: np.record) -> None:
    params.abort_at_s = 1.0
    watch = new(SUPERVISION)
    assert not check(params, 0.98, seen((3.0, 0.0, 0.0)), line(), 0, 1, watch)
    assert check(params, 1.0, seen((3.0, 0.0, 0.0)), line(), 0, 1, watch)


def test_ready_since_is_the_start_of_the_unbroken_stay(params: np.record) -> None:
    watch = new(SUPERVISION)
    since = []
    for k, x in enumerate((0.5, 0.42, 0.41, 0.45, 0.4, 0.4)):
        check(params, float(k), seen((x, 0.0, 0.0)), line(), 0, 1, watch)
        since.append(float(watch.ready_since_s))
    np.testing.assert_array_equal(since, [np.nan, 1.0, 1.0, np.nan, 4.0, 4.0])


@pytest.mark.parametrize(
    ("level_m", "off_m", "lacks", "axis"),
    [(0.012, 0.0, GO, 0), (0.021, 0.0, LEVEL, 1), (0.012, 0.017, ENCODERS, 1), (0.012, -0.017, ENCODERS, 1)],
)
def test_go_requires_a_level_within_table_iii_and_the_encoders(
    params: np.record, level_m: float, off_m: float, lacks: int, axis: int
) -> None:
    watch, navigation, go = new(SUPERVISION), seen((0.4, 0.0, 0.0)), new(GO_CHECK)
    go.level_m, go.known, go.off[1] = (0.005, level_m, 0.005), 1, off_m
    check(params, 1.0, navigation, line(), 0, 1, watch, go)
    assert math.isnan(watch.ready_since_s) == (lacks != GO)
    assert (go.lacks, go.axis if lacks else 0) == (lacks, axis)
    if lacks != GO:
        assert go.value == pytest.approx(max(level_m if lacks == LEVEL else abs(off_m), 0.017))
        assert go.value > go.limit > 0.0


@pytest.mark.parametrize(
    ("field", "component", "value", "lacks", "axis"),
    [
        ("firing", 5, math.radians(0.074), GO, 0),
        ("firing", 5, math.radians(0.076), FIRING, 11),
        ("firing", 1, 0.0151, FIRING, 7),
        ("hold", 0, 0.0249, GO, 0),
        ("hold", 2, 0.016, HOLD, 2),
        ("hold", 4, math.radians(0.6), HOLD, 4),
    ],
)
def test_go_requires_firings_and_a_hold_within_table_iii(
    params: np.record, field: str, component: int, value: float, lacks: int, axis: int
) -> None:
    watch, navigation, go = new(SUPERVISION), seen((0.4, 0.0, 0.0)), new(GO_CHECK)
    go.level_m, go[field][component] = 0.005, value
    check(params, 1.0, navigation, line(), 0, 1, watch, go)
    assert math.isnan(watch.ready_since_s) == (lacks != GO)
    assert (go.lacks, go.axis if lacks else 0) == (lacks, axis)


def test_go_that_is_given_stays_without_the_promise_and_ends_when_deviation_and_level_exceed_table_iii(
    params: np.record,
) -> None:
    watch, navigation, go = new(SUPERVISION), seen((0.4, 0.0, 0.0)), new(GO_CHECK)
    watch.ready_since_s = np.nan
    for t_s in (1.0, 1.0 + params.dwell_s):
        check(params, t_s, navigation, line(), 0, 1, watch, go)
    assert go.given == 1
    go.hold[1] = 0.1
    check(params, 7.0, navigation, line(), 0, 1, watch, go)
    assert (go.given, watch.ready_since_s) == (1, 1.0)
    check(params, 7.02, seen((0.4, 0.0205, 0.0)), line(), 0, 1, watch, go)
    assert (go.given, math.isnan(watch.ready_since_s)) == (0, True)
    check(params, 7.04, navigation, line(), 0, 1, watch, go)
    assert go.lacks == HOLD


def test_go_ends_with_a_sum_of_the_innovations_beyond_its_limit(params: np.record) -> None:
    watch, go = new(SUPERVISION), new(GO_CHECK)
    go.sum, go.sum_of, go.sum_limit = 26.0, 7, 25.0
    check(params, 1.0, seen((0.4, 0.0, 0.0)), line(), 0, 1, watch, go)
    assert (go.lacks, go.axis, math.isnan(watch.ready_since_s)) == (SUM, 7, True)


@pytest.mark.parametrize(("r", "outside"), [((5.0, 0.1, 0.0), 0), ((5.8, 0.0, 0.0), 1), ((5.0, 0.5, 0.0), 1)])
def test_approach_that_begins_far_from_its_plan_is_outside_and_not_aborted(
    params: np.record, r: tuple[float, float, float], outside: int
) -> None:
    watch, reactions, reference = new(SUPERVISION), new(REACTION_STATE), line()
    reactions.converged, reference.r_CT_H = 1, FAR
    for k in range(100):
        assert not approach_monitor.check(params, 0.02 * k, seen(r), reference, 0, reactions, new(GO_CHECK), watch)
    assert reactions.outside == outside
