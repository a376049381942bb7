"""A target that is rotated in the run: the same approach, shown by nine axes; limits, stops and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from hil.core.modes import Mode
from hil.errors import BadInput, SafetyTrip
from hil.loop.manipulator_stage import RotatedTarget
from hil.session import build
from hil.session.build import check
from tests.support.run_settings import make_job

RIG = "mock-manipulator"


def test_approach_shown_by_nine_axes_is_that_shown_by_six() -> None:
    poses = {}
    for rig in (RIG, "mock"):
        with build.runner(make_job(4.0, ("initial.attitude_deg=[8, -6, 12]",), rig=rig)) as runner:
            outcome = runner.run()
            assert outcome.stop == "completed"
            poses[rig] = outcome.history
            target = runner.loop.target
        if rig == RIG:
            assert isinstance(target, RotatedTarget)
            assert max(target.numbers()["angle_max_deg"]) > 5.0
            assert max(target.numbers()["following_error_max_deg"]) < 0.05
    rows, plain = poses[RIG], poses["mock"]
    # poses of the vision unit, which sees what all axes did
    np.testing.assert_allclose(rows["pose"]["z_TC_C"], plain["pose"]["z_TC_C"], atol=2e-3)
    np.testing.assert_allclose(rows["feedback"]["rail_m"], plain["feedback"]["rail_m"], atol=2e-3)
    np.testing.assert_allclose(rows["truth"]["r_CT_H"], plain["truth"]["r_CT_H"], atol=2e-3)


def test_manipulator_that_stands_still_trips_and_is_stopped_with_the_bench() -> None:
    with build.runner(make_job(4.0, ("initial.attitude_deg=[8, -6, 12]",), rig=RIG)) as runner:
        target = runner.loop.target
        assert isinstance(target, RotatedTarget)
        follow = target.follow

        def stuck(*arguments: object) -> object:
            target.axes.stop(runner.now_s())
            return follow(*arguments)  # type: ignore[arg-type]

        target.follow = stuck  # type: ignore[method-assign, assignment]
        outcome = runner.run()
    assert outcome.mode is Mode.SAFE_STOP
    assert "target." in outcome.stop or "bench" in outcome.stop


def test_target_that_tumbles_faster_than_both_machines_show_is_refused_with_both_limits() -> None:
    settings = ("target.rate_degps=[1.5, 2.0, 25.0]", "chaser.thrusters.force_n=2000")
    with pytest.raises(BadInput) as refused:
        check(make_job(1.0, settings, scenario="tumbling-1", rig=RIG))
    (problem,) = (each for each in refused.value.problems if each.key == "target.rate_degps")
    assert "rig.rails.y.rate_max_mps" in problem.message
    assert "rig.rotary_manipulator.roll.rate_max_degps" in problem.message


def test_error_of_a_manipulator_names_axis_value_and_limit() -> None:
    with build.runner(make_job(1.0, rig=RIG)) as runner:
        target = runner.loop.target
        assert isinstance(target, RotatedTarget)
        target.open(0.0)
        target.seed(0.0)
        target.axes.send(np.array([0.0, 0.1, 0.0]), np.zeros(3), 0.0)
        target.axes.read(1.0)
        with pytest.raises(SafetyTrip, match=r"target\.pitch: following error 5\.\d+ deg, allowed 0\.500 deg"):
            target.check(1.0)
