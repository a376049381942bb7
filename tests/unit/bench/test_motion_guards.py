"""Kernels that watch and stop the axes: following error, soft limits, the way to a stand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench import guard as guards
from hil.bench.guard import (
    BREACH,
    BY_ENCODERS,
    COLLISION,
    FOLLOWING,
    GUARD,
    NOT_FINITE,
    NOTHING,
    TRAVEL,
    first_beyond_travel,
    first_breach,
    first_moving,
)
from hil.bench.keep_out import KEEP_OUT, PLANE
from hil.bench.kinematics import BENCH_PARAMS, MOTION
from hil.bench.stopping import brake_step, slower
from hil.config.load import load_rig, load_scenario
from hil.config.rig import BENCH_AXES
from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, new
from hil.params import bench as bench_params
from hil.safety.motion_guards import breach_alarm

DT = 0.02


def guard(per_speed: float = 0.0) -> np.record:
    made = new(GUARD)
    made.following_max, made.following_per_speed = [0.05] * 6, [per_speed] * 6
    made.low, made.high = [-1.0] * 6, [1.0] * 6
    return made


def axes(axis: int = 0, position: float = 0.0, rate: float = 0.0) -> np.record:
    made = new(AXES)
    made["rail_m" if axis < 3 else "gimbal_rad"][axis % 3] = position
    made["rail_mps" if axis < 3 else "gimbal_radps"][axis % 3] = rate
    return made


@pytest.mark.parametrize("axis", range(6))
def test_following_error_trips_just_above_its_limit_and_names_the_axis(axis: int) -> None:
    breach = new(BREACH)
    assert first_breach(guard(), axes(axis, 0.3), axes(axis, 0.2501), breach) == NOTHING
    assert first_breach(guard(), axes(axis, 0.3), axes(axis, 0.2499), breach) == FOLLOWING
    assert (breach.axis, breach.value, breach.high) == (axis, pytest.approx(0.0501), 0.05)


ARM = '{on = "turntable", vertices_m = [[0.0, 0.0, 0.0], [-0.6, 0.0, 0.0]], radius_m = 0.05}'
CARRIAGE = '{on = "carriage", vertices_m = [[0.0, 0.0, 0.0]], radius_m = 0.3}'
RING = '{on = "lab", vertices_m = [[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]], radius_m = 0.1}'


@pytest.mark.parametrize(("bodies", "reach_m", "pair"), [((ARM, RING), 0.65, 102), ((RING, CARRIAGE), 0.3, 201)])
@pytest.mark.parametrize("closing", [0.0, 0.2])
def test_bodies_of_the_bench_leave_way_to_brake(
    bodies: tuple[str, ...], reach_m: float, pair: int, closing: float
) -> None:
    settings = (
        f"rig.bench.bodies=[{', '.join(bodies)}]",
        "rig.bench.lever_arm_m=[0.0, 0.0, 0.0]",
        "rig.bench.bodies_distance_m=0.05",
    )
    rig, breach = load_rig("mock", settings).value, new(BREACH)
    params = bench_params.axis_guard(rig, load_scenario("scheme-1", ("keep_out.radius_m=0",)).value)
    least = reach_m + 0.1 + 0.05 + closing * 0.1 + closing**2 / (2.0 * 0.6)
    for inside in (-1e-6, 1e-6):
        here = axes(0, least - inside, -closing)
        assert first_breach(params, here, here, breach) == (COLLISION if inside > 0.0 else NOTHING)
    alarm = breach_alarm(0.0, BENCH_AXES, COLLISION, breach)
    assert (breach.axis, alarm.quantity) == (pair, "distance of bodies")
    away = axes(3 + 2, 0.5)  # the yaw takes the arm aside, not the carriage
    away.rail_m[0], away.rail_mps[0] = here.rail_m[0], here.rail_mps[0]
    assert (first_breach(params, away, away, breach) == NOTHING) == (ARM in bodies)


def volume(*settings: str) -> np.record:
    """Return GUARD of scheme 1 on the mock rig without bodies; its arm is 0.35 m along z."""
    rig = load_rig("mock", ("rig.bench.bodies=[]", *(s for s in settings if s.startswith("rig."))))
    scenario = load_scenario("scheme-1", tuple(s for s in settings if not s.startswith("rig.")))
    return bench_params.axis_guard(rig.value, scenario.value)


@pytest.mark.parametrize("closing", [0.0, 0.2])
@pytest.mark.parametrize("beside_m", [0.0, 0.46])
def test_keep_out_holds_for_the_encoders(closing: float, beside_m: float) -> None:
    params, breach = volume(), new(BREACH)
    least = 0.25 + closing * 0.1 + closing**2 / (2.0 * 0.6)
    for inside in (-1e-6, 1e-6):
        here = axes(0, least - inside, -closing)
        here.rail_m[1:] = beside_m, -0.35
        found = first_breach(params, here, here, breach)
        expected = (KEEP_OUT if beside_m == 0.0 else PLANE) + BY_ENCODERS
        assert found == (expected if inside > 0.0 else NOTHING)
    alarm = breach_alarm(0.0, BENCH_AXES, found, breach)
    assert alarm.value.endswith("m by the encoders")


def test_turntable_that_swings_the_chaser_into_the_keep_out_is_found() -> None:
    params, breach = volume(), new(BREACH)
    here = axes(0, 0.27)
    here.rail_m[1:] = 0.0, -0.35
    assert first_breach(params, here, here, breach) == NOTHING
    here.gimbal_rad[1] = -0.1  # 0.35 m times 0.1 rad forwards
    assert first_breach(params, here, here, breach) == NOTHING or breach.value < 0.25
    here.gimbal_rad[1] = 0.1
    found = {first_breach(params, here, here, breach)}
    here.gimbal_rad[1] = -0.1
    found.add(first_breach(params, here, here, breach))
    assert found == {NOTHING, KEEP_OUT + BY_ENCODERS}


@pytest.mark.parametrize("why", ["homed", "rig.guard.enabled=false", "keep_out.radius_m=0"])
def test_keep_out_of_the_encoders_is_off_before_homing_and_without_a_guard(why: str) -> None:
    params = volume() if why == "homed" else volume(why)
    if why == "homed":
        params.homed = 0
    here = axes(0, 0.05)
    here.rail_m[2] = -0.35
    assert first_breach(params, here, here, new(BREACH)) == NOTHING


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_allowed_following_error_grows_with_the_commanded_speed(axis: int, rate: float) -> None:
    breach = new(BREACH)
    fast, still = axes(axis, 0.3, rate), axes(axis, 0.3)
    behind = axes(axis, 0.2)
    assert first_breach(guard(0.2), fast, behind, breach) == NOTHING  # 0.05 + 0.2 * 0.5 = 0.15
    assert first_breach(guard(0.2), still, behind, breach) == FOLLOWING
    assert first_breach(guard(), fast, behind, breach) == FOLLOWING
    assert first_breach(guard(0.2), fast, axes(axis, 0.1499), breach) == FOLLOWING
    assert breach.high == pytest.approx(0.15)


@pytest.mark.parametrize("axis", range(6))
def test_numbers_that_are_none_are_not_missed(axis: int) -> None:
    breach = new(BREACH)
    assert first_breach(guard(), axes(), axes(axis, math.nan), breach) == FOLLOWING
    assert breach.axis == axis
    assert first_breach(guard(), axes(axis, math.nan), axes(), breach) == FOLLOWING
    assert first_breach(guard(), axes(axis, 0.0, math.nan), axes(), breach) == FOLLOWING
    assert first_beyond_travel(guard(), axes(axis, math.nan), np.zeros(6), breach) == NOT_FINITE
    assert breach.axis == axis
    assert first_moving(axes(axis, 0.0, math.nan), 0.01, 0.01) == axis


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_position_beyond_the_travel_trips(axis: int, side: float) -> None:
    breach = new(BREACH)
    here = axes(axis, 1.06 * side)
    assert first_breach(guard(), here, here, breach) == TRAVEL
    assert (breach.axis, breach.value) == (axis, 1.06 * side)
    assert first_beyond_travel(guard(), here, np.full(6, 0.001), breach) == TRAVEL
    assert first_beyond_travel(guard(), axes(axis, 1.0005 * side), np.full(6, 0.001), breach) == NOTHING


@pytest.mark.parametrize("axis", range(6))
def test_first_moving_axis_is_named(axis: int) -> None:
    assert first_moving(axes(axis, 0.0, -0.011), 0.01, 0.01) == axis
    assert first_moving(axes(axis, 0.0, 0.009), 0.01, 0.01) == -1


def bench() -> np.record:
    params = new(BENCH_PARAMS)
    params.dt_s = DT
    params.low, params.high = [-1.0] * 6, [1.0] * 6
    params.rate_max, params.acceleration_max = [0.5] * 6, [0.6] * 6
    return params


@given(st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6))
def test_braking_keeps_the_acceleration_never_turns_back_and_stays_within_its_way(rates: list[float]) -> None:
    params, motion, out = bench(), new(MOTION), new(AXES)
    motion.rate = rates
    before, place = np.array(rates), np.zeros(6)
    for _ in range(60):
        moving = brake_step(params, motion, out)
        step = motion.position - place
        assert np.all(np.abs(motion.rate - before) <= 0.6 * DT * (1 + 1e-9))
        assert np.all(step * np.sign(rates) >= 0.0)
        np.testing.assert_allclose(step, motion.rate * DT, atol=1e-12)
        before, place = motion.rate.copy(), motion.position.copy()
    assert moving == 0
    assert not motion.rate.any()
    np.testing.assert_array_equal(np.concatenate([out.rail_m, out.gimbal_rad]), motion.position)
    assert np.all(np.abs(motion.position) <= np.array(rates) ** 2 / 1.2 + 1e-12)


def test_setpoint_that_stands_stays_where_it_is() -> None:
    params, motion, out = bench(), new(MOTION), new(AXES)
    motion.position = 0.3
    assert brake_step(params, motion, out) == 0
    assert out.rail_m.tolist() == [0.3] * 3
    assert not out.rail_mps.any()


def test_braking_ends_at_the_end_of_the_travel_and_does_not_jump_back_from_beyond() -> None:
    params, motion, out = bench(), new(MOTION), new(AXES)
    motion.position, motion.rate = 0.999, 0.5
    for _ in range(60):
        brake_step(params, motion, out)
        assert motion.position.max() <= 1.0
    motion.position, motion.rate = 1.2, 0.1
    brake_step(params, motion, out)
    assert motion.position.tolist() == [1.2] * 6


@given(st.floats(-1.0, 1.0), st.floats(1e-6, 1.0))
def test_slower_goes_towards_zero_and_not_past_it(rate: float, loss: float) -> None:
    left = slower(rate, loss)
    assert abs(left) == pytest.approx(max(0.0, abs(rate) - loss))
    assert left * rate >= 0.0


def test_cheap_bound_of_a_fixed_gimbal_hides_no_collision() -> None:
    rig = load_rig("mock-planar", ("rig.bench.lever_arm_m=[0.0, 0.0, 0.35]",)).value
    scenario = load_scenario("planar").value
    guard, exact = (kernel_record(bench_params.axis_guard(rig, scenario)) for _ in range(2))
    exact.turntable.farthest = exact.carriage.farthest = 1e6  # each distance is computed
    for each in (guard, exact):
        each.zone.radius, each.zone.plane = 0.0, -np.inf
    random, axes, breach, found = np.random.default_rng(5), kernel_record(new(AXES)), new(guards.BREACH), []
    for _ in range(400):
        axes.rail_m = random.uniform([-1.5, -1.5, 0.0], [1.5, 1.5, 0.0])
        axes.gimbal_rad = -np.pi / 2.0, 0.0, random.uniform(-1.0, 1.0)
        axes.rail_mps = random.uniform(-0.2, 0.2, 3)
        found.append(int(guards.enters_volume(guard, axes, breach)))
        assert found[-1] == int(guards.enters_volume(exact, axes, breach))
    assert {guards.NOTHING, guards.COLLISION} == {*found}
