"""Alarms of the safety monitor by mode."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.config.rig import Rig
from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.messages import AXES, AxisFeedback, Homing, new
from hil.core.modes import Mode
from hil.params import bench as bench_params
from hil.safety.monitor import CHECKS, SafetyMonitor, safety_limits

NAMES = ("rails.x", "rails.y", "rails.z", "turntable.roll", "turntable.pitch", "turntable.yaw")
MOVED_BY_SETPOINTS = {Mode.JOGGING, Mode.PLACING, Mode.RUNNING, Mode.PARKING, Mode.HOLD}
OPEN = set(Mode) - {Mode.OFF, Mode.SAFE_STOP}


@dataclass
class Scene:
    """Data of a cycle at t = 10 s: all is well, unless a test changes it."""

    safety: SafetyMonitor
    rails: AxisFeedback = field(default_factory=lambda: AxisFeedback(10.0, np.array([3.0, 0.0, 0.0]), np.zeros(3)))
    turntable: AxisFeedback = field(default_factory=lambda: AxisFeedback(10.0, np.zeros(3), np.zeros(3)))
    commanded_s: float = 9.98
    setpoint: np.record = field(default_factory=lambda: _axes_at_3_m())
    feedback: np.record = field(default_factory=lambda: _axes_at_3_m())

    def check(self, mode: Mode) -> Alarm | None:
        self.safety.modes.mode = mode
        return self.safety.check(10.0, self.rails, self.turntable, self.commanded_s, self.setpoint, self.feedback)

    def refusal(self) -> Alarm | None:
        return self.safety.interlock_motion(10.0, self.rails, self.turntable, self.feedback)


def _axes_at_3_m() -> np.record:
    axes = new(AXES)
    axes.rail_m[0] = 3.0
    return axes


@pytest.fixture
def scene(mock_rig: Rig) -> Scene:
    return Scene(
        SafetyMonitor(
            safety_limits(mock_rig, bench_params.axis_guard(mock_rig, load_scenario("scheme-1").value)), NAMES
        )
    )


def press(scene: Scene) -> None:
    scene.safety.estop.update(True)


def press_and_release(scene: Scene) -> None:
    scene.safety.estop.update(True)
    scene.safety.estop.update(False)


def age_rails(scene: Scene) -> None:
    scene.rails = AxisFeedback(9.59, scene.rails.position, scene.rails.rate)


def age_turntable(scene: Scene) -> None:
    scene.turntable = AxisFeedback(math.nan, scene.turntable.position, scene.turntable.rate)


def lose_home(scene: Scene) -> None:
    states = (Homing.DONE, Homing.DONE, Homing.NEEDED)
    scene.turntable = AxisFeedback(10.0, scene.turntable.position, scene.turntable.rate, states)


def fail_homing(scene: Scene) -> None:
    states = (Homing.DONE, Homing.FAILED, Homing.UNDER_WAY)
    scene.rails = AxisFeedback(10.0, scene.rails.position, scene.rails.rate, states)


def touch_a_switch(scene: Scene) -> None:
    scene.rails = AxisFeedback(10.0, scene.rails.position, scene.rails.rate, limit=(0, 0, -1))


def age_the_setpoint(scene: Scene) -> None:
    scene.commanded_s = 9.4


def stay_behind(scene: Scene) -> None:
    scene.feedback.gimbal_rad[1] = math.radians(-2.5)


def stray(scene: Scene) -> None:
    scene.setpoint.rail_m[1] = scene.feedback.rail_m[1] = 1.56


def lose_a_number(scene: Scene) -> None:
    scene.feedback.rail_m[2] = math.nan


RULES: dict[Callable[[Scene], None], tuple[set[Mode], str]] = {
    press: (OPEN, "bench: emergency stop pressed, allowed released and reset"),
    press_and_release: (OPEN, "bench: emergency stop released, not reset, allowed released and reset"),
    age_rails: (OPEN, "rails: age of the feedback 0.410 s, allowed 0.4 s"),
    age_turntable: (OPEN, "turntable: age of the feedback nan s, allowed 0.4 s"),
    lose_home: (
        {Mode.PLACING, Mode.ARMED, Mode.RUNNING, Mode.PARKING, Mode.HOLD},
        "turntable.yaw: homing not homed, allowed done",
    ),
    fail_homing: (
        {Mode.HOMING, Mode.PLACING, Mode.ARMED, Mode.RUNNING, Mode.PARKING, Mode.HOLD},
        "rails.y: homing failed, allowed ",
    ),
    touch_a_switch: (
        {Mode.PLACING, Mode.ARMED, Mode.RUNNING, Mode.PARKING, Mode.HOLD},
        "rails.z: limit switch low, allowed none",
    ),
    age_the_setpoint: (MOVED_BY_SETPOINTS, "bench: age of the setpoint 0.600 s, allowed 0.5 s"),
    stay_behind: (MOVED_BY_SETPOINTS | {Mode.ARMED}, "turntable.pitch: following error 2.500 deg, allowed 2 deg"),
    stray: (MOVED_BY_SETPOINTS | {Mode.ARMED}, "rails.y: position 1.5600 m, allowed -1.55 m to 1.55 m"),
    lose_a_number: (MOVED_BY_SETPOINTS | {Mode.ARMED}, "rails.z: following error nan m, allowed 0.05 m"),
}


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_each_rule_stops_the_bench_in_its_modes_and_in_no_other(
    scene: Scene, rule: Callable[[Scene], None], mode: Mode
) -> None:
    modes, text = RULES[rule]
    rule(scene)
    alarm = scene.check(mode)
    if mode in modes:
        assert alarm is not None
        assert alarm.text.startswith(text)
        assert alarm.t_s == 10.0
    else:
        assert alarm is None


@pytest.mark.parametrize("mode", list(Mode))
def test_bench_without_faults_may_continue(scene: Scene, mode: Mode) -> None:
    assert scene.check(mode) is None
    assert scene.refusal() is None


def test_table_of_checks_has_a_row_for_each_mode() -> None:
    assert set(CHECKS) == set(Mode)


def test_no_setpoint_since_arming_is_not_an_old_one(scene: Scene) -> None:
    scene.commanded_s = math.nan
    assert scene.check(Mode.RUNNING) is None


@pytest.mark.parametrize("rule", [press, press_and_release, lose_home, fail_homing, touch_a_switch])
def test_motion_is_refused_before_it_begins(scene: Scene, rule: Callable[[Scene], None]) -> None:
    rule(scene)
    alarm = scene.refusal()
    assert alarm is not None
    assert alarm.text.startswith(RULES[rule][1])


def test_axis_that_stands_beyond_its_travel_is_not_armed(scene: Scene) -> None:
    scene.feedback.rail_m[1] = 1.502
    alarm = scene.refusal()
    assert alarm is not None
    assert alarm.text == "rails.y: position 1.5020 m, allowed -1.5 m to 1.5 m"
    scene.feedback.rail_m[1] = math.nan
    alarm = scene.refusal()
    assert alarm is not None
    assert alarm.text == "rails.y: position nan, allowed a finite number"


@pytest.mark.parametrize(
    ("field_name", "text"),
    [
        ("rail_mps", "rails.z: speed before motion 0.0300 m/s, allowed 0.01 m/s"),
        ("gimbal_radps", "turntable.yaw: speed before motion 1.719 deg/s, allowed 1 deg/s"),
    ],
)
def test_references_are_not_seeded_from_axes_that_move(scene: Scene, field_name: str, text: str) -> None:
    scene.feedback[field_name][2] = 0.03
    alarm = scene.refusal()
    assert alarm is not None
    assert alarm.text == text


def test_jog_has_its_own_travel_while_it_lasts(scene: Scene) -> None:
    stray(scene)
    limits = scene.safety.limits.guard
    scene.safety.widen_travel(limits.low - 1.0, limits.high + 1.0)
    assert scene.check(Mode.JOGGING) is None
    scene.safety.restore_travel()
    assert scene.check(Mode.JOGGING) is not None


def test_homing_has_a_limited_time(scene: Scene) -> None:
    lose_home(scene)
    assert scene.safety.homing_timeout(130.0, 10.0, scene.rails, scene.turntable) is None
    alarm = scene.safety.homing_timeout(130.1, 10.0, scene.rails, scene.turntable)
    assert alarm is not None
    assert alarm.text == "turntable.yaw: homing not done after 120.1 s, allowed 120 s"


def test_reset_is_refused_while_the_button_is_in(scene: Scene) -> None:
    press(scene)
    scene.safety.alarms.latch(table.EMERGENCY_STOP.alarm(1.0, "bench", "pressed", "released and reset"))
    refusal = scene.safety.reset(11.0)
    assert refusal is not None
    assert refusal.text == "bench: emergency stop pressed, allowed released"
    assert scene.safety.alarms.latched()
    scene.safety.estop.update(False)
    assert scene.safety.reset(12.0) is None
    assert not scene.safety.alarms.latched()


def test_first_reason_for_a_hold_is_kept_until_the_devices_are_reopened(scene: Scene) -> None:
    scene.safety.request_hold("three late cycles")
    scene.safety.request_hold("another")
    assert scene.safety.hold_reason == "three late cycles"
    scene.safety.restart()
    assert not scene.safety.hold_reason


def test_neither_power_nor_motion_is_permitted_without_the_local_enabling_input(scene: Scene) -> None:
    scene.safety.locally_enabled = False
    for alarm in (scene.safety.interlock_power(10.0), scene.refusal()):
        assert alarm is not None
        assert alarm.text == "io: local enabling input off, allowed on"
