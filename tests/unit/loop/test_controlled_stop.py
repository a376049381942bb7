"""Stop category 1: every axis is watched along its ramp, and no axis keeps its torque."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.core.clock import SimulatedClock
from hil.core.messages import Array, AxisFeedback
from hil.errors import LinkTimeout
from hil.loop.controlled_stop import OFF_RAMP_S, REACTION_S, STANDSTILL_S, BrakeTimes, ControlledStop
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.target_stage import AxesTogether
from hil.safety.alarms import AlarmLog

STEP_S = 0.02
DECELERATION = 0.6
Speed = Callable[[float], float]


class Axes:
    """Three axes; the first one has the speed ``speed(t)``, m/s, t s after the start."""

    def __init__(self, name: str, speed: Speed, reported: Speed | None = None) -> None:
        self.name = name
        self.axis_names = (f"{name}.first", f"{name}.second", f"{name}.third")
        self.lost_after_s = np.inf
        self.disabled_s: float | None = None
        self._speed, self._reported = speed, reported or speed
        self._t_s, self._position = 0.0, 0.0

    def read(self, now_s: float) -> AxisFeedback:
        if now_s > self.lost_after_s:
            raise LinkTimeout(self.name, "no answer")
        while self._t_s < now_s - 1e-9:
            self._t_s += 0.001
            self._position += 0.001 * self._speed(self._t_s)
        rate: Array = np.array([self._reported(now_s), 0.0, 0.0])
        return AxisFeedback(now_s, np.array([self._position, 0.0, 0.0]), rate)

    def stop(self, now_s: float) -> None: ...

    def disable(self, now_s: float) -> None:
        self.disabled_s = now_s


class Lines:
    """Safety chain and holding brakes."""

    def __init__(self, confirmed_s: float | None = None) -> None:
        self.opened_s: float | None = None
        self.closed_brakes_s: float | None = None
        self._confirmed_s = confirmed_s

    def keep_closed(self, now_s: float) -> None: ...

    def release_brakes(self, released: bool, now_s: float) -> None:
        assert not released
        self.closed_brakes_s = now_s

    def brakes_closed(self, now_s: float) -> bool | None:
        return None if self._confirmed_s is None else now_s >= self._confirmed_s

    def stop(self, now_s: float) -> None:
        self.opened_s = self.opened_s or now_s


class Bench:
    """Everything that a stop needs of a loop, in simulated time."""

    def __init__(self, rails: Axes, lines: Lines | None = None, brakes: BrakeTimes | None = None) -> None:
        self.rails, self.turntable = rails, Axes("turntable", lambda _: 0.0)
        self.lines = lines or Lines()
        self.alarms = AlarmLog()
        self.rate = SimulatedRate(SimulatedClock(), STEP_S)
        self.ended_s = np.inf
        groups = (self.rails, self.turntable)
        loop: Any = SimpleNamespace(
            bench=SimpleNamespace(
                rails=self.rails,
                turntable=self.turntable,
                params=SimpleNamespace(acceleration_max=np.full(6, DECELERATION)),
                safety=SimpleNamespace(limits=SimpleNamespace(rest_mps=0.01, rest_radps=0.017), alarms=self.alarms),
                stop=lambda now_s: [group.stop(now_s) for group in groups],
                disable=lambda now_s: [group.disable(now_s) for group in groups],
            ),
            target=AxesTogether(),
            safety_io=self.lines,
        )
        self.stop = ControlledStop(loop, self.rate, brakes or BrakeTimes(), lambda now_s: now_s >= self.ended_s)

    def run(self) -> None:
        self.stop.brake()
        self.stop.remove_torque()
        assert self.lines.opened_s is not None
        assert self.rails.disabled_s is not None


def braking(speed: float, deceleration: float = DECELERATION, after_s: float = 0.05) -> Speed:
    return lambda t_s: max(0.0, speed - deceleration * max(0.0, t_s - after_s))


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.5])
def test_axes_that_follow_their_ramps_stand_before_the_torque_goes(speed: float) -> None:
    bench = Bench(Axes("rails", braking(speed)))
    bench.run()
    stands_s = 0.05 + speed / DECELERATION if speed > 0.0 else 0.0
    assert not bench.stop.cut
    assert bench.alarms.all() == ()
    assert bench.lines.opened_s == pytest.approx(stands_s + STANDSTILL_S, abs=2 * STEP_S)


@pytest.mark.parametrize(
    "speed",
    [
        pytest.param(lambda t_s: 0.3, id="goes on"),
        pytest.param(lambda t_s: 0.3 + 0.5 * t_s, id="accelerates"),
        pytest.param(braking(0.3, 0.5 * DECELERATION), id="brakes at half of its ramp"),
        pytest.param(lambda t_s: 0.05, id="creeps"),
    ],
)
def test_an_axis_that_leaves_its_ramp_loses_its_torque_within_0_2_s(speed: Speed) -> None:
    bench = Bench(Axes("rails", speed))
    first = speed(0.0)
    times = np.arange(0.0, 2.0, 0.001)
    ramp = np.maximum(0.0, first - DECELERATION * np.maximum(0.0, times - REACTION_S)) + 0.01
    left_s = times[np.argmax(np.array([speed(t_s) for t_s in times]) > ramp)]
    bench.run()
    assert bench.stop.cut
    assert bench.lines.opened_s is not None
    assert left_s + OFF_RAMP_S <= bench.lines.opened_s <= left_s + 0.2
    assert [alarm.device for alarm in bench.alarms.all()] == ["rails.first"]
    assert bench.alarms.all()[0].quantity == "speed in a stop"


def test_an_axis_whose_drive_reports_a_ramp_that_it_does_not_follow_is_cut_by_its_position() -> None:
    bench = Bench(Axes("rails", lambda t_s: 0.3, reported=braking(0.3)))
    bench.run()
    assert bench.stop.cut
    assert bench.lines.opened_s is not None
    assert bench.lines.opened_s < REACTION_S + 0.4


def test_an_axis_that_cannot_be_seen_is_cut() -> None:
    axes = Axes("rails", braking(0.5))
    axes.lost_after_s = 0.05
    bench = Bench(axes)
    bench.run()
    assert bench.stop.cut
    assert bench.lines.opened_s == pytest.approx(0.05 + OFF_RAMP_S, abs=2 * STEP_S)


def test_feedback_that_is_missing_once_cuts_nothing() -> None:
    axes = Axes("rails", braking(0.3))
    read, gaps = axes.read, iter([0.1, 0.3])
    missing = [next(gaps), next(gaps)]

    def with_gaps(now_s: float) -> AxisFeedback:
        if any(gap <= now_s < gap + 0.05 for gap in missing):
            raise LinkTimeout("rails", "no answer")
        return read(now_s)

    axes.read = with_gaps  # type: ignore[method-assign]
    bench = Bench(axes)
    bench.run()
    assert not bench.stop.cut


def test_brakes_close_at_standstill_and_are_waited_for_before_the_torque_goes() -> None:
    lines = Lines(confirmed_s=None)
    bench = Bench(Axes("rails", braking(0.1)), lines, BrakeTimes(close_s=0.1, open_s=0.1))
    bench.run()
    assert lines.closed_brakes_s is not None
    assert lines.closed_brakes_s >= 0.05 + 0.1 / DECELERATION
    assert bench.rails.disabled_s is not None
    assert bench.rails.disabled_s >= lines.closed_brakes_s + 0.1
    assert lines.opened_s is not None
    assert lines.opened_s >= bench.rails.disabled_s + 0.1  # of a drive that closes its brake itself


def test_axes_whose_brakes_do_not_close_keep_their_torque_with_an_alarm() -> None:
    lines = Lines(confirmed_s=5.0)
    bench = Bench(Axes("rails", lambda _: 0.0), lines, BrakeTimes(close_s=0.1))
    bench.run()
    assert bench.rails.disabled_s == pytest.approx(5.0, abs=2 * STEP_S)
    assert [(alarm.device, alarm.quantity) for alarm in bench.alarms.all()] == [("io", "holding brakes")]


def test_the_operator_ends_the_watch_over_axes_that_no_brake_holds() -> None:
    lines = Lines(confirmed_s=np.inf)
    bench = Bench(Axes("rails", lambda _: 0.0), lines, BrakeTimes(close_s=0.1))
    bench.ended_s = 2.0
    bench.run()
    assert lines.opened_s == pytest.approx(2.0 + 0.1, abs=3 * STEP_S)


def test_an_axis_that_slips_while_its_brake_is_not_closed_is_cut() -> None:
    lines = Lines(confirmed_s=np.inf)
    bench = Bench(Axes("rails", lambda t_s: 0.0 if t_s < 1.0 else 0.1), lines, BrakeTimes(close_s=0.1))
    bench.run()
    assert bench.stop.cut
    assert lines.opened_s == pytest.approx(1.0 + OFF_RAMP_S, abs=2 * STEP_S)


def test_an_axis_that_comes_to_rest_again_and_again_is_cut_when_its_time_is_over() -> None:
    bench = Bench(Axes("rails", lambda t_s: 0.0 if round(t_s / STEP_S) % 4 == 3 else 0.0107))
    bench.run()
    assert bench.stop.cut
    assert bench.lines.opened_s is not None
    assert bench.lines.opened_s < 0.6


def test_the_time_allowed_at_top_speed_is_that_of_the_ramp_and_the_reaction() -> None:
    times: list[float] = []
    bench = Bench(Axes("rails", lambda t_s: 0.5))
    bench.stop.brake(times.append)
    assert times[-1] <= REACTION_S + 0.01 / DECELERATION + OFF_RAMP_S + 2 * STEP_S
    assert pytest.approx(0.95, abs=0.005) == 0.5 / DECELERATION + REACTION_S


@pytest.mark.parametrize(("device", "unit", "per_si"), [("rails", "m/s", 1.0), ("turntable", "deg/s", 57.29578)])
def test_the_alarm_of_a_stop_has_the_unit_of_the_safety_monitor(device: str, unit: str, per_si: float) -> None:
    bench = Bench(Axes("rails", (lambda _: 0.3) if device == "rails" else (lambda _: 0.0)))
    bench.turntable._speed = bench.turntable._reported = (lambda _: 0.3) if device == "turntable" else (lambda _: 0.0)
    bench.run()
    (alarm,) = bench.alarms.all()
    assert alarm.value.endswith(f" {unit}")
    assert float(alarm.value.split()[0]) == pytest.approx(0.3 * per_si, abs=0.01)
    assert f" {unit} on its ramp" in alarm.limit
