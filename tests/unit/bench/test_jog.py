"""Jogging: the key, the speed, the switches, the ends."""

from __future__ import annotations

import numpy as np
import pytest

from hil.bench.jog import DEAD_MAN_S, DeadMan, Jog
from hil.bench.kinematics import BENCH_PARAMS, MOTION, limit_setpoint, start_motion
from hil.core.messages import AXES, new

DT = 0.02


def bench() -> np.record:
    params = new(BENCH_PARAMS)
    params.dt_s = DT
    params.low, params.high = [-1.0] * 6, [1.0] * 6
    params.rate_max, params.acceleration_max = [0.5] * 6, [0.6] * 6
    return params


def jogged(jog: Jog, start: list[float], cycles: int) -> np.ndarray:
    """Setpoints, (cycles + 1, 6), of a jog with the key held."""
    motion, wanted, out = new(MOTION), new(AXES), new(AXES)
    start_motion(np.array(start[:3]), np.array(start[3:]), motion)
    places = [motion.position.copy()]
    for _ in range(cycles):
        jog.aim(motion, wanted)
        limit_setpoint(jog.params, motion, wanted, out)
        places.append(motion.position.copy())
    return np.array(places)


def test_key_is_let_go_when_the_refresh_ceases() -> None:
    key = DeadMan()
    assert not key.pressed(0.0)
    key.refresh(5.0)
    assert key.pressed(5.0)
    assert key.pressed(5.0 + 0.99 * DEAD_MAN_S)
    assert not key.pressed(5.0 + 1.01 * DEAD_MAN_S)
    assert not key.pressed(4.9)  # a clock that ran backwards
    assert DEAD_MAN_S == 0.2


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("direction", [-1, 1])
def test_one_axis_moves_at_a_tenth_of_its_speed_within_its_acceleration(axis: int, direction: int) -> None:
    places = jogged(Jog(bench(), axis, direction, True, np.zeros(6)), [0.0] * 6, 100)
    steps = np.diff(places, axis=0)
    assert steps[-1, axis] == pytest.approx(direction * 0.05 * DT)
    assert np.abs(np.diff(steps[:, axis], prepend=0.0)).max() <= 0.6 * DT * DT * (1 + 1e-9)
    assert not np.delete(steps, axis, axis=1).any()


def test_axis_that_is_not_homed_creeps_and_has_no_soft_limits() -> None:
    places = jogged(Jog(bench(), 1, 1, False, np.zeros(6)), [0.0] * 6, 6000)
    assert np.diff(places[:, 1]).max() == pytest.approx(0.01 * DT)
    assert places[-1, 1] > 1.1


def test_homed_axis_brakes_for_the_end_of_its_travel() -> None:
    start = [0.9, 0.0, 0.0, 0.0, 0.0, 0.0]
    places = jogged(Jog(bench(), 0, 1, True, np.array(start)), start, 300)
    assert places[:, 0].max() <= 1.0
    assert places[-1, 0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("side", [-1, 1])
def test_axis_beyond_its_travel_goes_back_without_a_jump_and_not_further_out(side: int) -> None:
    start = [1.2 * side, 0.0, 0.0, 0.0, 0.0, 0.0]
    inward = side * jogged(Jog(bench(), 0, -side, True, np.array(start)), start, 100)[:, 0]
    assert np.abs(np.diff(inward)).max() <= 0.05 * DT * (1 + 1e-9)
    assert inward[-1] < 1.2
    outward = side * jogged(Jog(bench(), 0, side, True, np.array(start)), start, 100)[:, 0]
    assert outward.max() == 1.2


def test_switch_blocks_its_own_direction_alone() -> None:
    jog = Jog(bench(), 0, 1, True, np.zeros(6))
    jog.key.refresh(1.0)
    assert jog.may_move(1.0, 0)
    assert jog.may_move(1.0, -1)
    assert not jog.may_move(1.0, 1)
    assert not jog.may_move(1.3, 0)


@pytest.mark.parametrize(("axis", "direction"), [(6, 1), (-1, 1), (0, 0), (0, 2)])
def test_jog_of_no_axis_or_direction_is_refused(axis: int, direction: int) -> None:
    with pytest.raises(ValueError, match="allowed"):
        Jog(bench(), axis, direction, True, np.zeros(6))
