"""Guard volume in a jog: no jog into it, jogs out of it, none while bodies meet."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import AXES, new
from hil.params import bench as bench_params
from hil.safety.motion_guards import JogGuard

JOG_MPS = 0.05


def jog_guard(*settings: str) -> JogGuard:
    rig = load_rig("mock", settings).value
    return JogGuard(bench_params.axis_guard(rig, load_scenario("scheme-1").value))


def axes(x: float, y: float = 0.0, rate: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.record:
    made = new(AXES)
    made.rail_m, made.rail_mps = (x, y, -0.35), rate
    return made


def test_jog_towards_the_target_is_braked_before_the_alarm_and_one_away_is_not() -> None:
    guard = jog_guard()
    assert guard.check_jog(0.0, 0, -JOG_MPS, axes(3.0)) is None
    near = axes(0.25 + JOG_MPS * 0.2)
    assert guard.check(0.0, near, near) is None
    alarm = guard.check_jog(0.0, 0, -JOG_MPS, near)
    assert alarm is not None
    assert alarm.text.startswith("bench: range to the target 0.26")
    assert guard.check_jog(0.0, 0, JOG_MPS, near) is None
    assert guard.check_jog(0.0, 1, JOG_MPS, near) is None


def test_axes_within_the_volume_may_stand_and_leave_it_but_go_no_deeper() -> None:
    guard = jog_guard()
    inside = axes(0.2)
    assert guard.check_position(inside) is not None
    assert guard.check(0.0, inside, inside) is None
    assert guard.check(0.0, axes(0.2, rate=(0.01, 0.0, 0.0)), inside) is None
    assert guard.check(0.0, axes(0.2, rate=(-0.01, 0.0, 0.0)), inside) is not None
    assert guard.check_jog(0.0, 0, JOG_MPS, inside) is None
    assert guard.check_jog(0.0, 0, -JOG_MPS, inside) is not None


@pytest.mark.parametrize("rate", [0.0, JOG_MPS, -JOG_MPS])
def test_nothing_moves_while_bodies_meet(rate: float) -> None:
    within = axes(-0.1)
    assert jog_guard().check(0.0, axes(-0.1, rate=(rate, 0.0, 0.0)), within) is not None
