"""Measuring the axes of a mock bench: what is found, what it is good for, and that every protection holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from hil.core.messages import AXES, new
from hil.core.modes import Mode
from hil.errors import BenchError, LinkLost, SafetyTrip
from hil.loop.motion_sequences import MotionSequencer
from hil.parts.commissioning.identification import AxisResult, Identification
from hil.session import build
from tests.support.run_settings import make_job

STEP_S = 0.02
X, YAW = 0, 5


@contextmanager
def standing(*settings: str) -> Iterator[MotionSequencer]:
    job = make_job(STEP_S, settings)
    with build.runner(job) as runner, runner.axes_only() as sequencer:
        yield sequencer


def measured(axes: list[int], *settings: str, tell: Callable[[str, float], None] = lambda *_: None) -> list[AxisResult]:
    with standing(*settings) as sequencer:
        return Identification(sequencer, tell).measure(axes)


@pytest.fixture(scope="module")
def found() -> dict[str, AxisResult]:
    return {result.axis: result for result in measured([X, YAW])}


def worst_error(axis: int, amplitude: float, *settings: str) -> float:
    """Return the rms of commanded against encoder position of an axis that goes to and fro in 10 s."""
    w = math.tau / 10.0
    with standing(*settings) as sequencer:
        bench, now = sequencer.loop.bench, sequencer.loop.now
        tick = sequencer.begin()
        bench.seed_for_run(tick.now_s)
        sequencer.modes.go(Mode.PLACING)
        start, begun_s = bench.motion.position.copy(), tick.now_s
        errors = []
        wanted = new(AXES)
        for _ in range(1000):
            t = tick.now_s - begun_s + STEP_S  # the moment that the setpoint belongs to
            position, rate = start.copy(), np.zeros(6)
            position[axis] += amplitude * (1.0 - math.cos(w * t))
            rate[axis] = amplitude * w * math.sin(w * t)
            wanted.rail_m, wanted.gimbal_rad = position[:3], position[3:]
            wanted.rail_mps, wanted.gimbal_radps = rate[:3], rate[3:]
            bench.command(wanted, tick.now_s)
            tick = sequencer.tick()
            encoder = np.concatenate([now.feedback.rail_m, now.feedback.gimbal_rad])
            errors.append(position[axis] - encoder[axis])
    return float(np.sqrt(np.mean(np.square(errors))))


def test_axes_of_the_shipped_rig_pass_and_run_half_a_cycle_ahead(found: dict[str, AxisResult]) -> None:
    for result in found.values():
        assert result.passed, result.reason
        # setpoints are held for a cycle from when they are sent, a cycle before their moment
        assert result.lead_s == pytest.approx(-0.5 * STEP_S, abs=0.0015)
        assert result.sweep.delay_sigma_s < 0.0005
        assert result.sweep.residual < 0.01
    assert found["rails.x"].step.bandwidth_hz == pytest.approx(4.9, rel=0.2)  # gain 25/s, lag 8 ms
    assert found["turntable.yaw"].step.bandwidth_hz == pytest.approx(5.7, rel=0.2)  # gain 30/s, lag 6 ms


@pytest.mark.parametrize(("axis", "name", "amplitude"), [(X, "rails.x", 0.05), (YAW, "turntable.yaw", 0.03)])
def test_lead_that_was_found_takes_two_thirds_and_more_out_of_the_error(
    found: dict[str, AxisResult], axis: int, name: str, amplitude: float
) -> None:
    without = worst_error(axis, amplitude)
    with_it = worst_error(axis, amplitude, f"rig.{name}.lead_s={found[name].lead_s:.4f}")
    assert without > 3.0 * with_it


def test_lead_in_the_rig_file_does_not_change_what_is_found(found: dict[str, AxisResult]) -> None:
    again = measured([X], "rig.rails.x.lead_s=0.05")[0]
    assert again.lead_s == pytest.approx(found["rails.x"].lead_s, abs=1e-4)


def test_slower_servo_has_less_bandwidth(found: dict[str, AxisResult]) -> None:
    slow = measured([X], "rig.rails.servo={gain_per_s=10.0, lag_s=0.008}")[0]
    assert slow.step.bandwidth_hz < 0.5 * found["rails.x"].step.bandwidth_hz


def test_axis_at_the_end_of_its_travel_is_measured_within_it_and_put_back() -> None:
    with standing("rig.rails.x.travel_m=[4.9826, 12.0]", "rig.rails.x.park_m=6.0") as sequencer:
        bench = sequencer.loop.bench
        lowest = [np.inf]
        send = bench.rails.send

        def seen(position: np.ndarray, rate: np.ndarray, now_s: float) -> np.ndarray:
            lowest[0] = min(lowest[0], float(position[0]))
            return send(position, rate, now_s)

        bench.rails.send = seen  # type: ignore[method-assign]
        before = float(bench.rails.read(0.0).position[0])
        result = Identification(sequencer, lambda *_: None).measure([X])[0]
        assert result.passed
        assert 4.9826 <= lowest[0] < before + 0.001
        assert float(sequencer.loop.now.feedback.rail_m[0]) == pytest.approx(before, abs=1e-4)
        assert sequencer.modes.mode is Mode.STANDBY


def test_no_axis_but_the_one_under_test_moves_and_none_goes_far() -> None:
    with standing() as sequencer:
        places = []

        def watch(_title: str, _share: float) -> None:
            feedback = sequencer.loop.now.feedback
            places.append([*feedback.rail_m, *feedback.gimbal_rad])

        Identification(sequencer, watch).measure([YAW])
    way = np.ptp(np.array(places), axis=0)
    np.testing.assert_allclose(way[:5], 0.0, atol=1e-9)
    assert math.radians(0.1) < way[YAW] <= math.radians(0.7)


def _in_the_middle(act: Callable[[MotionSequencer], Any]) -> tuple[BaseException, list[str]]:
    """Let ``act`` happen while an axis is measured; return what came of it and the order of stop and close."""
    job = make_job(STEP_S)
    calls: list[str] = []
    with build.runner(job) as runner:
        bench = runner.loop.bench
        stop, close = bench.stop, bench.close
        bench.stop = lambda now_s: (calls.append("stop"), stop(now_s))[1]  # type: ignore[method-assign,func-returns-value]
        bench.close = lambda: (calls.append("close"), close())[1]  # type: ignore[method-assign,func-returns-value]

        def tell_with(sequencer: MotionSequencer) -> Callable[[str, float], None]:
            return lambda _title, share: act(sequencer) if share > 0.3 else None

        def work() -> None:
            with runner.axes_only() as sequencer:
                Identification(sequencer, tell_with(sequencer)).measure([X])

        with pytest.raises((BenchError, KeyboardInterrupt)) as raised:
            work()
    return raised.value, calls


def _interrupt(_: MotionSequencer) -> None:
    raise KeyboardInterrupt


def test_ctrl_c_stops_the_axes_first() -> None:
    error, calls = _in_the_middle(_interrupt)
    assert isinstance(error, KeyboardInterrupt)
    assert calls == ["stop", "close"]


def test_emergency_stop_ends_it() -> None:
    error, calls = _in_the_middle(lambda sequencer: sequencer.safety.estop.update(True, False))
    assert isinstance(error, SafetyTrip)
    assert "emergency stop" in str(error)
    assert calls == ["stop", "close"]


def test_link_that_fails_ends_it() -> None:
    error, calls = _in_the_middle(lambda h: h.loop.bench.rails.fail(LinkLost("rails.x", "is gone")))  # type: ignore[attr-defined]
    assert str(error) == "rails.x: is gone"
    assert calls == ["stop", "close"]


def test_axis_that_does_not_follow_is_identified() -> None:
    with standing() as sequencer:
        bench = sequencer.loop.bench
        read, stuck = bench.rails.read, bench.rails.read(0.0).position.copy()

        def frozen(now_s: float) -> Any:
            feedback = read(now_s)
            feedback.position[:] = stuck
            feedback.rate[:] = 0.0
            return feedback

        bench.rails.read = frozen  # type: ignore[method-assign]
        result = Identification(sequencer, lambda *_: None).measure([X])[0]
    assert not result.passed
    assert "gain 0.000 at 0.5 Hz" in result.reason
