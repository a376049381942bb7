"""A target that is rotated in the run: the same approach, shown by nine axes; limits, stops and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.bench.manipulator import relative_axes
from hil.core.modes import Mode
from hil.drivers.mock_axes import MockAxes
from hil.errors import BadInput, SafetyTrip
from hil.loop.target_stage import TargetInMotion
from hil.maths import quat
from hil.params import bench as bench_params
from hil.recording import schema
from hil.recording.header import header_of
from hil.recording.read import contents, load
from hil.recording.replay import replay
from hil.recording.session import recording
from hil.recording.writer import RunFile
from hil.session import build
from hil.session.build import check
from tests.support.run_settings import make_job
from tests.support.verdicts import bench_error

RIG = "mock-manipulator"
START = ("initial.attitude_deg=[8, -6, 12]",)


def test_nine_axes_show_the_truth_and_the_vision_unit_sees_what_they_did() -> None:
    job = make_job(4.0, START, rig=RIG)
    with build.runner(job) as runner:
        outcome, (target,) = runner.run(), runner.loop.target.groups
    assert outcome.stop == "completed"
    assert isinstance(target, TargetInMotion)
    assert max(target.numbers()["angle_max_deg"]) > 5.0
    assert max(target.numbers()["following_error_max_deg"]) < 0.05
    rows = outcome.history
    error = bench_error(rows, job.scenario.value, job.rig.value)
    assert error["pose_error_mm"].max < 1.0
    assert error["pose_error_deg"].max < 0.02
    fresh = rows[rows["pose"]["fresh"] > 0]
    seen = [-quat.transform_back(row["pose"]["q_CH"], row["pose"]["z_TC_C"]) for row in fresh]
    assert np.abs(np.mean(seen - fresh["truth"]["r_CT_H"], axis=0)).max() < 0.02  # 25 poses of 12 mm and their turning


def test_manipulator_that_stands_still_trips_and_is_stopped_with_the_bench() -> None:
    with build.runner(make_job(4.0, START, rig=RIG)) as runner:
        (target,) = runner.loop.target.groups
        assert isinstance(target, TargetInMotion)
        follow = target.follow

        def stuck(*arguments: object) -> object:
            target.axes.stop(runner.now_s())
            return follow(*arguments)  # type: ignore[arg-type]

        target.follow = stuck  # type: ignore[method-assign, assignment]
        outcome = runner.run()
    assert outcome.mode is Mode.SAFE_STOP
    # by the axes relative to the target, by its own, or by the setpoints that it limits
    assert any(words in outcome.stop for words in ("distance from the demand", "target.", "limited setpoints"))
    assert np.abs(target.feedback.rate).max() < 1e-6


def test_manipulator_at_its_place_is_expected_there_and_a_hold_does_not_move_it() -> None:
    with build.runner(make_job(1.0, START, rig=RIG)) as runner:
        (target,), rate = runner.loop.target.groups, runner.rate
        assert isinstance(target, TargetInMotion)
        target.open(0.0)
        target.seed(0.0)
        target.place(rate.wait, 0.02)
        for _ in range(50):
            assert not target.brake(rate.wait().now_s)
            target.check(rate.now_s())
    assert np.degrees(np.abs(target.feedback.position)).max() > 5.0


def test_target_that_tumbles_faster_than_both_machines_show_is_refused_with_both_limits() -> None:
    settings = ("target.rate_degps=[1.5, 2.0, 25.0]", "chaser.thrusters.force_n=2000")
    with pytest.raises(BadInput) as refused:
        check(make_job(1.0, settings, scenario="tumbling-1", rig=RIG))
    (problem,) = (each for each in refused.value.problems if each.key == "target.rate_degps")
    assert "rig.rails.y.rate_max_mps" in problem.message
    assert "rig.rotary_manipulator.roll.rate_max_degps" in problem.message


def test_error_of_a_manipulator_names_axis_value_and_limit() -> None:
    with build.runner(make_job(1.0, rig=RIG)) as runner:
        (target,) = runner.loop.target.groups
        assert isinstance(target, TargetInMotion)
        target.open(0.0)
        target.seed(0.0)
        target.axes.send(np.array([0.0, 0.1, 0.0]), np.zeros(3), 0.0)
        target.axes.read(1.0)
        with pytest.raises(SafetyTrip, match=r"target\.pitch: following error \d\.\d+ deg, allowed 0\.500 deg"):
            target.check(1.0)


def test_axes_of_both_machines_are_recorded_and_give_what_the_cycle_records(tmp_path: Path) -> None:
    job = make_job(2.0, START, rig=RIG)
    with recording(job, RIG, tmp_path, lambda _: None) as taken:
        with build.runner(job, sinks=taken.sinks) as runner:
            (target,), outcome = runner.loop.target.groups, runner.run()
        taken.break_off("test")
    assert isinstance(target, TargetInMotion)
    recorded = load(taken.path)
    rows, cycles = recorded.manipulator_samples, recorded.cycles
    np.testing.assert_array_equal(rows["t_s"], cycles["t_s"])
    assert len(rows) == len(outcome.history) == 101
    bench = bench_params.bench(job.rig.value, job.scenario.value.step_s)
    for row, cycle in zip(rows, cycles, strict=True):
        seen = row["chaser_feedback"]
        same = relative_axes(bench, target.params, seen["rail_m"], seen["gimbal_rad"], row["feedback"]["angle_rad"])
        np.testing.assert_array_equal(same, (cycle["feedback"]["rail_m"], cycle["feedback"]["gimbal_rad"]))
    lead_rad = np.abs(rows["setpoint"]["angle_rad"][1:] - rows["feedback"]["angle_rad"][1:]).max()
    assert 0.0 < np.degrees(lead_rad) < 0.5
    moved = np.diff(rows["setpoint"]["angle_rad"], axis=0) / job.scenario.value.step_s
    np.testing.assert_allclose(rows["setpoint"]["rate_radps"][1:], moved, atol=np.radians(0.2))
    assert np.abs(rows["chaser_setpoint"]["rail_m"] - rows["chaser_feedback"]["rail_m"]).max() < 0.01
    assert replay(recorded, recorded.scenario).identical


@pytest.mark.parametrize(("rig", "extra"), [("mock", set()), (RIG, {schema.MANIPULATOR})])
def test_only_the_recording_of_a_rig_with_a_manipulator_has_its_topic(
    tmp_path: Path, rig: str, extra: set[str]
) -> None:
    file = RunFile(tmp_path / "run.mcap", header_of(make_job(1.0, rig=rig), rig, "run", 0))
    file.finish({})
    assert set(contents(file.path).layouts) == {"/cycle", "/vmu/frames", "/imu", "/axes"} | extra


def test_procedure_jogs_an_axis_of_the_manipulator_within_its_travel_while_the_other_axes_stand() -> None:
    overrides = {"duration_s": 1.0, "rig.rotary_manipulator.pitch.travel_deg": [-80.0, 1.5]}
    with hil.Bench(RIG, "scheme-1", overrides=overrides) as bench:
        before = bench.feedback()
        bench.jog("target.yaw", -1, 1.0)  # at a tenth of 10 deg/s, for 0.2 s more than the key
        at = np.degrees(bench.target_feedback().angle_rad)
        np.testing.assert_allclose(at, [0.0, 0.0, -1.2], atol=0.15)
        bench.jog("target.pitch", 1, 3.0)
        at = np.degrees(bench.target_feedback().angle_rad)
        assert at[1] == pytest.approx(1.5, abs=0.01)
        assert np.abs(bench.target_feedback().rate_radps).max() < 1e-6
        for name in ("rail_m", "gimbal_rad"):
            np.testing.assert_allclose(bench.feedback()[name], before[name], atol=1e-6)
        assert bench.mode is Mode.STANDBY
        bench.arm()
        assert bench.start().stop == "completed"


def test_manipulator_stays_where_it_is_when_the_bench_parks() -> None:
    with hil.Bench(RIG, "scheme-1") as bench:
        bench.jog("target.yaw", 1, 1.0)
        at_rad = bench.target_feedback().angle_rad.copy()
        bench.park()
        assert at_rad[2] > 0.01
        np.testing.assert_allclose(bench.target_feedback().angle_rad, at_rad, atol=1e-3)


def test_jog_of_a_manipulator_needs_one_and_an_axis_that_is_homed() -> None:
    with hil.Bench("mock", "scheme-1", overrides={"duration_s": 1.0}) as bench:
        with pytest.raises(BadInput, match=r"must be one of rails\.x, .*, turntable\.yaw; 1 or -1"):
            bench.jog("target.yaw", 1, 0.5)
        with pytest.raises(hil.errors.BenchError, match="mock rotates no target"):
            bench.target_feedback()
    with hil.Bench(RIG, "scheme-1", overrides={"rig.rotary_manipulator.yaw.encoder": "incremental"}) as bench:
        with pytest.raises(hil.errors.BenchError, match=r"target\.yaw: homing not done, required before it is jogged"):
            bench.jog("target.yaw", 1, 0.5)
        assert not bench.target_feedback().angle_rad.any()


def test_switch_stops_a_jog_of_the_manipulator_and_a_jog_leads_off_it() -> None:
    with build.runner(make_job(1.0, rig=RIG)) as runner, runner.axes_only() as sequencer:
        (target,), operator = runner.loop.target.groups, runner.operator
        assert isinstance(target, TargetInMotion)
        assert isinstance(target.axes, MockAxes)
        target.axes.set_limit_switch(2, 1)

        def jogged_deg(direction: int) -> float:
            sequencer.tick()
            before, until_s = target.feedback.position[2], runner.now_s() + 1.0
            poll = operator.poll

            def press(now_s: float) -> None:
                poll(now_s)
                if now_s < until_s:
                    operator.jog("target.yaw", direction)

            operator.poll = press  # type: ignore[method-assign]
            operator.jog("target.yaw", direction)
            operator.pending.clear()  # as the runner, which takes the command before it jogs
            sequencer.jog()
            operator.poll = poll  # type: ignore[method-assign]
            return float(np.degrees(target.feedback.position[2] - before))

        assert jogged_deg(1) == 0.0
        assert jogged_deg(-1) == pytest.approx(-1.2, abs=0.15)
