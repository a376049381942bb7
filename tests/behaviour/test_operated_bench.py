"""Orders at a mock bench: homing, arming, hold and resume, jogging, emergency stop and reset."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import AxisFeedback
from hil.core.modes import Mode
from hil.core.operator_commands import TOO_LATE, OperatorCommand
from hil.errors import LinkLost
from hil.params import bench as bench_params
from hil.report.summary import summarise
from tests.support.operated_bench import STEP_S, Script, Session, operate

LIMITS = bench_params.bench(load_rig("mock").value, STEP_S)


def idle(_: Session) -> None:
    """Give no order."""


def step_ratios(session: Session) -> tuple[float, float]:
    """Largest step of a setpoint over what the speed limit allows, and change of step over that of acceleration.

    The axes stand before the first setpoint and after the last.
    """
    _, setpoints = session.setpoints()
    speed = np.diff(setpoints, axis=0) / STEP_S
    change = np.diff(speed, axis=0, prepend=0.0 * speed[:1]) / STEP_S
    return float(np.abs(speed / LIMITS.rate_max).max()), float(np.abs(change / LIMITS.acceleration_max).max())


def test_plan_goes_through_all_modes_by_itself() -> None:
    outcome, session = operate(idle, attended=False)
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.RUNNING]  # the mock stands at the start pose
    assert outcome.stop == "completed"
    assert outcome.mode is Mode.STANDBY
    assert outcome.alarms == []


def test_incremental_axes_are_homed_then_placed_and_nothing_jumps() -> None:
    settings = ('rig.rails.y.encoder="incremental"', 'rig.turntable.yaw.encoder="incremental"')
    outcome, session = operate(idle, *settings, attended=False)
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.HOMING, Mode.STANDBY, Mode.PLACING, Mode.RUNNING]
    assert outcome.stop == "completed"
    speed, acceleration = step_ratios(session)
    assert speed <= 1.0 + 1e-6
    assert acceleration <= 1.0 + 1e-3


def test_one_failed_homing_stops_all_axes() -> None:
    def blind(session: Session) -> None:
        session.rails.hide_home_switch(1)

    settings = tuple(f'rig.rails.{axis}.encoder="incremental"' for axis in "xyz")
    outcome, session = operate(idle, *settings, attended=False, prepare=blind)
    assert outcome.mode is Mode.SAFE_STOP
    assert outcome.stop == "rails.y: homing failed, allowed home switch found"
    assert [alarm.device for alarm in outcome.alarms] == ["rails.y"]
    session.rails.open(session.now_s)  # x had the longest way: it was stopped on it
    before = session.rails.read(session.now_s)
    assert before.position[0] != 0.0
    assert session.rails.read(session.now_s + 5.0).position == pytest.approx(before.position, abs=1e-3)


def test_home_is_lost_when_the_drive_was_off() -> None:
    def power_cut(session: Session) -> None:
        if session.once("cut", session.mode is Mode.RUNNING and session.now_s > 1.0):
            session.rails.switch_off_and_on()

    away_from_the_target = "rig.rails.x.home_m=5.0"
    settings = ('rig.rails.x.encoder="incremental"', away_from_the_target)
    outcome, _ = operate(power_cut, *settings, attended=False, duration_s=5.0)
    assert outcome.stop == "rails.x: homing not homed, allowed done"
    assert outcome.mode is Mode.SAFE_STOP


def test_axis_that_is_not_homed_cannot_be_armed() -> None:
    settings = 'rig.rails.x.encoder="incremental"'
    outcome, _ = operate(idle, settings, plan=(OperatorCommand.ARM, OperatorCommand.START), attended=False)
    assert outcome.stop == "rails.x: homing not homed, allowed done"


def hold_once(mode: Mode, condition: Callable[[Session], bool], length_s: float, rates: list[np.ndarray]) -> Script:
    """Hold for ``length_s`` when ``condition`` comes in ``mode``; from 2 s on keep the encoders' rates."""

    def script(session: Session) -> None:
        session.order_once(OperatorCommand.HOLD, session.mode is mode and condition(session))
        session.once("held", session.mode is Mode.HOLD)
        if session.mode is Mode.HOLD and session.since_s("held") > 2.0:
            rates.append(session.rates())
        session.order_once(OperatorCommand.RESUME, session.since_s("held") > length_s)

    return script


def test_held_bench_stands_and_the_run_then_completes_with_the_same_verdict() -> None:
    standing: list[np.ndarray] = []
    script = hold_once(Mode.RUNNING, lambda session: session.now_s >= 8.0, 10.0, standing)
    near = "initial.position_m=[0.6, -0.02, 0.02]"
    outcome, session = operate(script, near, duration_s=60.0)
    assert outcome.stop == "completed"
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.RUNNING, Mode.HOLD, Mode.RUNNING]
    assert len(standing) > 390
    assert np.abs(standing).max() < 1e-6
    assert len(outcome.history) == 3001  # the run's time stood
    assert [event.text for event in outcome.events if event.source == "bench"] == [
        "hold: commanded by the operator",
        "resumed after 10.06 s",
    ]
    speed, acceleration = step_ratios(session)
    assert speed <= 1.0 + 1e-6
    assert acceleration <= 1.0 + 1e-3
    scenario = load_scenario("scheme-1", [near]).value
    summary, verdict = summarise(outcome, scenario, load_rig("mock").value, "mock", 0, 50.0)
    assert verdict.passed
    assert verdict.ready_time_s == pytest.approx(19.18, abs=3.0)  # without the hold
    assert summary["passed_all_parts"]


def test_placing_can_be_held_and_continues_from_its_position() -> None:
    standing: list[np.ndarray] = []
    script = hold_once(Mode.PLACING, lambda session: float(np.abs(session.rates()).max()) > 0.1, 3.0, standing)
    outcome, session = operate(script, 'rig.rails.y.encoder="incremental"')
    modes = [Mode.OFF, Mode.STANDBY, Mode.HOMING, Mode.STANDBY, Mode.PLACING, Mode.HOLD, Mode.PLACING, Mode.RUNNING]
    assert session.seen_modes == modes
    assert outcome.stop == "completed"
    assert np.abs(standing).max() < 1e-6
    speed, acceleration = step_ratios(session)
    assert speed <= 1.0 + 1e-6
    assert acceleration <= 1.0 + 1e-3


def test_unattended_run_without_operator_is_not_resumed() -> None:
    def script(session: Session) -> None:
        if session.mode is Mode.RUNNING:
            session.runner.safety.request_hold("three late cycles")

    outcome, _ = operate(script, attended=False)
    assert outcome.stop == "bench: hold (three late cycles), allowed only in attended runs"


def test_emergency_stop_leads_to_standby_after_its_reset_and_never_back_to_running() -> None:
    def script(session: Session) -> None:
        if session.once("press", session.mode is Mode.STANDBY and session.now_s > 0.5):
            session.button = True
        if session.mode is Mode.SAFE_STOP and session.once("reset too early"):
            session.operator.submit(OperatorCommand.RESET)
        elif session.mode is Mode.SAFE_STOP and session.operator.rejections and session.once("release"):
            session.button = False
            session.operator.submit(OperatorCommand.ARM)  # refused here
            session.operator.submit(OperatorCommand.RESET)
        if "release" in session.marks and session.mode is Mode.STANDBY:
            session.order_once(OperatorCommand.ARM)
        session.order_once(OperatorCommand.START, session.mode is Mode.ARMED)

    outcome, session = operate(script, plan=())
    assert session.seen_modes == [
        Mode.OFF,
        Mode.STANDBY,
        Mode.SAFE_STOP,
        Mode.OFF,
        Mode.STANDBY,
        Mode.ARMED,
        Mode.RUNNING,
    ]
    assert list(session.operator.rejections) == [
        "bench: emergency stop pressed, allowed released",
        "bench: cannot arm in safe-stop",
    ]
    assert outcome.stop == "completed"
    assert [(a.quantity, a.latched, a.acknowledged) for a in outcome.alarms] == [("emergency stop", False, True)]


def test_stop_that_ends_the_watch_over_axes_that_no_brake_holds_ends_the_session() -> None:
    def prepare(session: Session) -> None:
        def never_closed(now_s: float) -> bool:
            session.now_s = now_s
            session.once("tripped", session.mode is Mode.SAFE_STOP)
            session.order_once(OperatorCommand.RESET, session.since_s("tripped") > 1.0)
            session.order_once(OperatorCommand.STOP, session.since_s("tripped") > 2.0)
            return False

        session.runner.loop.safety_io.brakes_closed = never_closed  # type: ignore[method-assign]

    def script(session: Session) -> None:
        session.button = session.mode is Mode.STANDBY

    brake = (
        "rig.rails.z.gravity_loaded=true",
        "rig.rails.z.brake={close_s=0.05, open_s=0.05}",
        "rig.io.torque_delay_s=0.1",
    )
    outcome, session = operate(script, *brake, plan=(), prepare=prepare)
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.SAFE_STOP]
    assert list(session.operator.rejections) == ["bench: cannot reset before the stop is over"]
    assert outcome.stop == "stopped by the operator"


def test_signal_during_a_stop_ends_the_session() -> None:
    def script(session: Session) -> None:
        session.button = session.mode is Mode.STANDBY
        session.order_once(OperatorCommand.STOP, session.mode is Mode.SAFE_STOP)

    def prepare(session: Session) -> None:
        disable = session.rails.disable

        def interrupted(now_s: float) -> None:
            os.kill(os.getpid(), signal.SIGTERM)
            disable(now_s)

        session.rails.disable = interrupted  # type: ignore[method-assign]

    outcome, session = operate(script, plan=(), prepare=prepare)
    assert OperatorCommand.STOP.value not in session.marks  # no command had to end it
    assert outcome.mode is Mode.SAFE_STOP
    assert outcome.stop == "bench: emergency stop pressed, allowed released and reset"


def test_emergency_stop_in_a_run_ends_it() -> None:
    def script(session: Session) -> None:
        session.button = session.mode is Mode.RUNNING and 1.0 < session.now_s < 1.05  # a short press

    outcome, _ = operate(script, duration_s=5.0)
    assert outcome.mode is Mode.SAFE_STOP
    assert outcome.stop.startswith("bench: emergency stop")
    assert len(outcome.history) < 60
    assert outcome.alarms[0].latched


@pytest.mark.parametrize("switch", [-1, 1])
def test_limit_switch_stops_a_run_by_the_name_of_its_axis(switch: int) -> None:
    def script(session: Session) -> None:
        if session.once("switch", session.mode is Mode.RUNNING and session.now_s > 1.0):
            session.turntable.set_limit_switch(2, switch)

    outcome, _ = operate(script, attended=False, duration_s=5.0)
    side = "low" if switch < 0 else "high"
    assert outcome.stop == f"turntable.yaw: limit switch {side}, allowed none"


def test_truth_that_is_no_number_stops_the_run() -> None:
    def script(session: Session) -> None:
        if session.once("poison", session.mode is Mode.RUNNING and session.now_s > 1.0):
            session.runner.loop.now.truth.r_CT_H[1] = np.nan

    outcome, _ = operate(script, attended=False, duration_s=5.0)
    assert outcome.mode is Mode.SAFE_STOP
    assert "nan" in outcome.stop


def jog_script(axis: str, direction: int, press_s: float, end_s: float) -> Script:
    def script(session: Session) -> None:
        if session.now_s < press_s:
            session.operator.jog(axis, direction)
        session.order_once(OperatorCommand.STOP, session.now_s > end_s)

    return script


def test_jog_runs_while_the_key_is_held_and_stops_when_it_is_let_go() -> None:
    outcome, session = operate(jog_script("rails.y", 1, 1.0, 4.0), plan=())
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.JOGGING, Mode.STANDBY]
    t, setpoints = session.setpoints()
    way = setpoints[:, 1] - setpoints[0, 1]
    assert way[t <= 1.0][-1] == pytest.approx(0.05 * 1.0, abs=0.006)  # a tenth of 0.5 m/s
    assert way[-1] - way[t <= 1.0][-1] == pytest.approx(0.05 * 0.2, abs=0.004)  # the key holds for 0.2 s more
    moving = t[:-1][np.diff(way) > 0.0]
    assert moving.max() < 1.0 + 0.2 + 0.05 / 0.6 + 0.1
    assert not np.delete(setpoints - setpoints[0], 1, axis=1).any()
    speed, acceleration = step_ratios(session)
    assert speed <= 0.1 + 1e-6
    assert acceleration <= 1.0 + 1e-3
    assert outcome.stop == "stopped by the operator"


def test_axis_that_is_not_homed_may_be_jogged_slowly_and_stops_at_its_switch() -> None:
    def script(session: Session) -> None:
        session.operator.jog("rails.y", 1)
        if session.once("switch", session.now_s > 2.0):
            session.rails.set_limit_switch(1, 1)
        session.order_once(OperatorCommand.STOP, session.now_s > 4.0)

    _, session = operate(script, 'rig.rails.y.encoder="incremental"', plan=())
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.JOGGING]
    t, setpoints = session.setpoints()
    speed = np.diff(setpoints[:, 1]) / STEP_S
    assert speed.max() == pytest.approx(0.02 * 0.5, rel=1e-6)
    assert not speed[t[1:] > 2.1].any()


def test_jog_of_an_unknown_axis_is_refused_with_a_message() -> None:
    _, session = operate(jog_script("rails.w", 1, 0.1, 0.5), plan=())
    assert session.operator.rejections[0] == "bench: cannot jog rails.w by 1"
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY]


@pytest.mark.parametrize("must_stand", [False, True])
def test_arm_is_refused_when_a_comparison_takes_longer_than_it_is_meant_and_acts_at_once_after_one(
    must_stand: bool,
) -> None:
    stood_s: list[float] = []

    def compare(now_s: float, feedback: np.record) -> bool:
        stood_s.append(now_s)
        if must_stand and len(stood_s) > 200:
            raise LinkLost("tracker", "moved")
        return now_s - stood_s[0] > 1.0

    def script(session: Session) -> None:
        for step, at_s in (("early", 0.2), ("later", 4.4)):
            if session.once(step, session.now_s > at_s):
                session.operator.submit(OperatorCommand.ARM, session.now_s + 0.5)
        session.once("armed", session.mode is Mode.ARMED)
        session.order_once(OperatorCommand.STOP, session.now_s > 5.5)

    def prepare(session: Session) -> None:
        session.runner.parts.before_motion.append(compare)
        session.operator._wall_s = lambda: session.now_s

    outcome, session = operate(script, plan=(), prepare=prepare)
    assert list(session.operator.rejections) == [f"bench: arm {TOO_LATE} (the bench was compared before its motion)"]
    assert ("armed" in session.marks) is not must_stand
    assert [alarm.text for alarm in outcome.alarms] == (["tracker: moved"] if must_stand else [])
    assert must_stand or session.marks["armed"] - session.marks["later"] < 0.1


def test_link_that_fails_while_armed_leads_to_standby_by_a_reset_and_can_be_armed_again() -> None:
    def script(session: Session) -> None:
        if session.once("lose", session.mode is Mode.ARMED):
            session.rails.fail(LinkLost("rails.x", "connection closed"))
        session.order_once(OperatorCommand.RESET, session.mode is Mode.SAFE_STOP)
        if "reset" in session.marks and session.mode is Mode.STANDBY:
            session.order_once(OperatorCommand.STOP, session.now_s > 1.0)

    outcome, session = operate(script, plan=(OperatorCommand.ARM,))
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.ARMED, Mode.SAFE_STOP, Mode.OFF, Mode.STANDBY]
    assert [alarm.text for alarm in outcome.alarms] == ["rails.x: connection closed"]
    assert outcome.stop == "stopped by the operator"


def test_orders_reach_the_approach() -> None:
    def script(session: Session) -> None:
        session.order_once(OperatorCommand.ABORT, session.mode is Mode.RUNNING and session.now_s > 1.0)

    outcome, _ = operate(script, duration_s=4.0)
    assert outcome.history["supervision"]["aborted"][-1] != 0


def test_no_drive_is_enabled_while_the_emergency_stop_is_pressed() -> None:
    def prepare(session: Session) -> None:
        session.button = True

    outcome, session = operate(idle, attended=False, prepare=prepare)
    assert outcome.stop == "bench: emergency stop pressed, allowed released and reset"
    assert session.seen_modes == [Mode.OFF]
    assert not session.rails.sent


def test_emergency_input_that_cannot_be_read_stops_the_bench_and_counts_as_pressed() -> None:
    def script(session: Session) -> None:
        if session.mode is Mode.RUNNING and session.now_s > 1.0:
            raise LinkLost("inputs", "no answer")

    outcome, session = operate(script, attended=False, duration_s=5.0)
    assert outcome.stop == "inputs: no answer"
    assert session.runner.safety.estop.latched


def test_burst_of_lost_frames_stops_a_run_and_single_ones_do_not() -> None:
    lost = [0]

    def prepare(session: Session) -> None:
        source = session.runner.source
        counted = source.counters
        source.counters = lambda: counted() | {"lost": lost[0]}  # type: ignore[method-assign]

    def single(session: Session) -> None:
        lost[0] = int(session.now_s)

    def burst(session: Session) -> None:
        lost[0] = 11 if session.mode is Mode.RUNNING and session.now_s > 1.0 else 0

    assert operate(single, attended=False, duration_s=20.0, prepare=prepare)[0].stop == "completed"
    outcome, _ = operate(burst, attended=False, duration_s=5.0, prepare=prepare)
    assert outcome.stop == "vmu: lost packets 11.0, allowed 10 at once, 1 per 0.32 s"
    assert len(outcome.history) < 60


def test_plan_that_ends_before_the_run_leaves_the_bench_in_standby() -> None:
    for plan in ((), (OperatorCommand.HOME,), (OperatorCommand.HOME, OperatorCommand.ARM)):
        outcome, _ = operate(idle, plan=plan, attended=False)
        assert outcome.mode is Mode.STANDBY
        assert not outcome.faults


def test_homing_that_never_ends_stops_the_bench() -> None:
    settings = ('rig.rails.x.encoder="incremental"', "rig.safety.homing_timeout_s=1.0")
    outcome, _ = operate(idle, *settings, attended=False)
    assert outcome.stop == "rails.x: homing not done after 1.0 s, allowed 1 s"


def test_resume_ordered_while_the_axes_still_brake_waits_until_they_stand() -> None:
    def script(session: Session) -> None:
        session.order_once(OperatorCommand.HOLD, session.mode is Mode.RUNNING and session.now_s > 30.0)
        session.order_once(OperatorCommand.RESUME, session.mode is Mode.HOLD)

    outcome, session = operate(script, duration_s=40.0)
    assert outcome.stop == "completed"
    speed, acceleration = step_ratios(session)
    assert speed <= 1.0 + 1e-6
    assert acceleration <= 1.0 + 1e-3
    assert [event.text for event in outcome.events if event.source == "bench"][1] != "resumed after 0.02 s"


def test_references_are_seeded_from_the_encoders_on_every_path_into_motion() -> None:
    seeded: list[Mode] = []

    def prepare(session: Session) -> None:
        bench = session.runner.loop.bench
        seed = bench.seed

        def recorded(now_s: float) -> None:
            seeded.append(session.mode)
            seed(now_s)

        bench.seed = recorded  # type: ignore[method-assign]

    def script(session: Session) -> None:
        if session.now_s < 0.5:
            session.operator.jog("rails.y", 1)
        elif session.mode is Mode.STANDBY:
            session.order_once(OperatorCommand.ARM)
        session.order_once(OperatorCommand.START, session.mode is Mode.ARMED)
        session.order_once(OperatorCommand.HOLD, session.mode is Mode.RUNNING and session.now_s > 5.0)
        session.order_once(OperatorCommand.RESUME, session.mode is Mode.HOLD)

    outcome, _ = operate(script, plan=(), duration_s=10.0, prepare=prepare)
    assert outcome.stop == "completed"
    assert seeded == [Mode.STANDBY, Mode.STANDBY, Mode.ARMED, Mode.HOLD]  # jog, placing, start, resume


@pytest.mark.parametrize("mode", [Mode.STANDBY, Mode.ARMED])  # before placing, before the loop is closed
@pytest.mark.parametrize("creeps_s", [0.3, math.inf])
def test_axis_that_still_creeps_is_waited_for_and_then_named(mode: Mode, creeps_s: float) -> None:
    def prepare(session: Session) -> None:
        read = session.rails.read

        def creeping(now_s: float) -> AxisFeedback:
            feedback: AxisFeedback = read(now_s)
            session.once("creep", session.mode is mode)
            if session.since_s("creep") < 0.0 or session.since_s("creep") > creeps_s:
                return feedback
            turns_around = round(session.since_s("creep") / STEP_S) % 4 == 3  # stands for the moment
            return replace(feedback, rate=np.array([0.0, 0.0, 0.0 if turns_around else 0.0107]))

        session.rails.read = creeping  # type: ignore[method-assign]

    def script(session: Session) -> None:
        session.order_once(OperatorCommand.START, session.mode is Mode.ARMED and session.now_s > 0.1)
        session.order_once(OperatorCommand.STOP, session.mode is Mode.SAFE_STOP)

    outcome, session = operate(script, plan=(OperatorCommand.HOME, OperatorCommand.ARM), prepare=prepare)
    if creeps_s == math.inf:
        assert outcome.alarms[0].text == "rails.z: speed before motion 0.0107 m/s, allowed 0.01 m/s"
        assert not session.rails.sent
    else:
        assert outcome.stop == "completed"
        assert session.rails.sent[0][0] - session.marks["creep"] >= creeps_s + 0.1 - STEP_S


def test_plan_does_not_continue_by_itself_after_a_reset() -> None:
    def script(session: Session) -> None:
        session.button = session.once("press", session.mode is Mode.STANDBY)
        session.order_once(OperatorCommand.RESET, session.mode is Mode.SAFE_STOP)
        session.order_once(OperatorCommand.STOP, session.mode is Mode.STANDBY and session.since_s("press") > 1.0)

    _, session = operate(script)
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.SAFE_STOP, Mode.OFF, Mode.STANDBY]


def test_poses_exposed_before_the_end_of_a_hold_are_left_out() -> None:
    def script(session: Session) -> None:
        if session.once("begin", session.mode is Mode.RUNNING and session.now_s > 1.0):
            session.runner.loop.vision.not_before_s = 3.0

    outcome, _ = operate(script, attended=False, duration_s=5.0)
    arrived = outcome.history["t_s"][outcome.history["pose"]["fresh"] > 0]
    assert ((arrived < 1.1) | (arrived >= 3.0)).all()
    assert (arrived >= 3.0).any()

    standing: list[np.ndarray] = []
    hold = hold_once(Mode.RUNNING, lambda session: session.now_s >= 2.0, 2.5, standing)
    _, session = operate(hold, duration_s=4.0)
    assert session.runner.loop.vision.not_before_s == pytest.approx(session.marks["resume"], abs=0.05)


@pytest.mark.parametrize("is_dead", [False, True], ids=["frames without a pose", "no frame"])
def test_hold_of_a_run_stays_without_poses_and_ends_in_a_safe_stop_when_the_vision_unit_is_silent(
    is_dead: bool,
) -> None:
    def script(session: Session) -> None:
        session.order_once(OperatorCommand.HOLD, session.mode is Mode.RUNNING and session.now_s > 1.0)
        session.once("held", session.mode is Mode.HOLD)
        session.order_once(OperatorCommand.STOP, session.since_s("held") > 6.0)

    def prepare(session: Session) -> None:
        source = session.runner.loop.vision.source
        name = "_expose_until" if is_dead else "_pose_at"
        works = getattr(source, name)
        setattr(source, name, lambda t_s: None if session.mode is Mode.HOLD else works(t_s))

    outcome, session = operate(script, prepare=prepare)
    if is_dead:
        assert outcome.stop.startswith("vmu: no answer for 0.4")
        assert session.since_s("held") < 1.0
    else:
        assert outcome.stop == "stopped by the operator"
        assert session.runner.loop.vision.source.counters()["no_pose"] > 30


def test_bench_parks_after_a_whole_run_at_the_pose_of_its_rig_file() -> None:
    outcome, session = operate(idle, "rig.bench.park_after_run=true", "rig.turntable.yaw.park_deg=20", attended=False)
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.RUNNING, Mode.STANDBY, Mode.PARKING]
    assert outcome.stop == "completed"
    _, setpoints = session.setpoints()
    assert setpoints[-1] == pytest.approx([3.0, 0.0, 0.0, 0.0, 0.0, math.radians(20.0)], abs=1e-6)
    speed, acceleration = step_ratios(session)
    assert speed <= 1.0 + 1e-6
    assert acceleration <= 1.0 + 1e-3


def test_an_order_to_park_ends_the_session() -> None:
    def script(session: Session) -> None:
        session.order_once(OperatorCommand.PARK, session.mode is Mode.STANDBY)

    _, session = operate(script, plan=())
    assert session.seen_modes == [Mode.OFF, Mode.STANDBY, Mode.PARKING]
    assert session.setpoints()[1][-1] == pytest.approx([3.0, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-6)
