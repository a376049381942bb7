"""Identification of the axes: moves them one at a time, and measures delay and bandwidth of each.

All motion goes through ``BenchStage.command``: limits, safety monitor and emergency stop act as in a run. The leads of
the rig file are not applied during the measurement; the result is the lead that the axis requires.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.config.rig import LEAD_MAX_S
from hil.core import alarm_table as table
from hil.core.messages import AXES, Array, new
from hil.core.modes import Mode
from hil.loop.bench_stage import Move
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.rate_keeper import Tick
from hil.parts.commissioning.response_fit import Series, StepFit, SweepFit, fit_sine, fit_step, fit_sweep

FREQUENCIES_HZ: Final = (0.5, 0.8, 1.25, 2.0, 3.15, 5.0, 8.0)
_CYCLE_RATE_FRACTION: Final = 1.0 / 6.0  # highest frequency
_SWEEP_M, _SWEEP_RAD = 0.003, math.radians(0.3)  # largest amplitude
_STEP_M, _STEP_RAD = 0.001, math.radians(0.1)  # largest step
_RATE_FRACTION: Final = 0.3
_ACCELERATION_FRACTION: Final = 0.3
_TRAVEL_FRACTION: Final = 0.25
_STEPS: Final = 8
_STEP_PERIOD_S: Final = 0.5
_STEP_CYCLES: Final = 5  # largest duration of a step that the acceleration limit does not allow in one cycle
_STEP_FRACTION: Final = 0.9  # fraction of the speed change that the acceleration limit allows in a cycle
_FITTED_S: Final = 2.0  # least, of each sine without its fading in and out
_FITTED_PERIODS: Final = 2
_PROGRESS_CYCLES: Final = 10
_SETTLE_S: Final = 3.0
RESIDUAL_MAX: Final = 0.1
DELAY_SIGMA_MAX_S: Final = 0.002
GAIN_ERROR_MAX: Final = 0.1  # gain error at the lowest frequency: an axis that is stuck or wrongly scaled exceeds it

Path = Callable[[int, float], tuple[float, float]]
"""Returns, for a cycle and the time since the first one, position about the centre and rate."""

OnProgress = Callable[[str, float], None]
"""Called periodically with the present step and the completed fraction, 0..1."""


@dataclass(frozen=True)
class AxisResult:
    """Result of one axis, and the reason for a rejection (empty if accepted)."""

    axis: str
    step: StepFit
    sweep: SweepFit
    reason: str

    @property
    def passed(self) -> bool:
        return not self.reason

    @property
    def lead_s(self) -> float:
        """Time by which its setpoints must be advanced."""
        return self.sweep.delay_s


@dataclass(frozen=True)
class _Sine:
    """One sine of ``periods`` periods, plus one period each for fading in and out."""

    frequency_hz: float
    amplitude: float
    periods: int

    @property
    def duration_s(self) -> float:
        return (self.periods + 2) / self.frequency_hz

    def path(self, _cycle: int, t_s: float) -> tuple[float, float]:
        """Return position about the centre and rate at ``t_s`` after the start."""
        w = math.tau * self.frequency_hz
        edge_s = min(t_s, self.duration_s - t_s)
        if edge_s <= 0.0:
            return 0.0, 0.0
        envelope, slope = 1.0, 0.0
        if edge_s < 1.0 / self.frequency_hz:
            envelope = 0.5 - 0.5 * math.cos(0.5 * w * edge_s)
            slope = math.copysign(0.25 * w * math.sin(0.5 * w * edge_s), self.duration_s - 2.0 * t_s)
        wave, wave_rate = math.sin(w * t_s), w * math.cos(w * t_s)
        return self.amplitude * envelope * wave, self.amplitude * (envelope * wave_rate + slope * wave)


class Identification:
    """Measures axes of an open bench in standby. Raises BenchError; the caller then stops the bench."""

    def __init__(self, sequencer: MotionSequencer, on_progress: OnProgress) -> None:
        self._sequencer = sequencer
        self._bench = sequencer.loop.bench
        self._now = sequencer.loop.now
        self._params = self._bench.params.copy()
        self._params.lead = 0.0
        self._dt = float(self._params.dt_s)
        self._on_progress = on_progress
        self._title = ""
        self._done_s, self._all_s = 0.0, 1.0
        self._target = new(AXES)

    def measure(self, axes: Sequence[int]) -> list[AxisResult]:
        """Measure each of ``axes`` (0..2 rails, 3..5 gimbals) and return it to its initial position."""
        self._all_s = sum(self._axis_s(axis) for axis in axes)
        self._sequencer.home()
        self._sequencer.begin()
        tick = self._sequencer.seed_for_run()
        self._sequencer.modes.go(Mode.PLACING)  # all safety checks are active in this mode
        results = []
        for axis in axes:
            result, tick = self._axis(axis, tick)
            results.append(result)
        self._sequencer.modes.go(Mode.STANDBY)
        return results

    def _axis(self, axis: int, tick: Tick) -> tuple[AxisResult, Tick]:
        start = self._bench.motion.position.copy()
        centre = start.copy()
        amplitude = self._largest_amplitude(axis)
        centre[axis] = min(self._params.high[axis] - amplitude, max(self._params.low[axis] + amplitude, centre[axis]))
        name = self._bench.axis_names[axis]
        self._title = f"{name}: steps"
        tick = self._move(centre, tick)
        staircase = self._steps(axis)
        steps, tick = self._record(axis, centre, tick, len(staircase), lambda cycle, _: (staircase[cycle], 0.0))
        # held from the time they are sent, not from the time they refer to
        steps = Series(steps.commanded_s - self._dt, steps.position, steps.rate, steps.measured_s, steps.measured)
        points = []
        for sine in self._sines(axis):
            self._title = f"{name}: {sine.frequency_hz:g} Hz"
            cycles = math.ceil(sine.duration_s / self._dt) + 1
            series, tick = self._record(axis, centre, tick, cycles, sine.path)
            points.append(fit_sine(_middle(series, sine), sine.frequency_hz))
        tick = self._move(start, tick)
        return _result(name, fit_step(steps), fit_sweep(points, self._dt)), tick

    def _largest_amplitude(self, axis: int) -> float:
        """Return the largest distance of the axis from its centre."""
        largest = _SWEEP_M if axis < 3 else _SWEEP_RAD
        return min(largest, _TRAVEL_FRACTION * float(self._params.high[axis] - self._params.low[axis]))

    def _sines(self, axis: int) -> list[_Sine]:
        """Return the sines, within fractions of travel, speed and acceleration, also while fading."""
        sines = []
        for f in (f for f in FREQUENCIES_HZ if f <= _CYCLE_RATE_FRACTION / self._dt * (1.0 + 1e-9)):
            w = math.tau * f
            amplitude = min(
                self._largest_amplitude(axis),
                _RATE_FRACTION * self._params.rate_max[axis] / w,
                _ACCELERATION_FRACTION * self._params.acceleration_max[axis] / w**2,
            )
            sines.append(_Sine(f, float(amplitude), max(_FITTED_PERIODS, math.ceil(_FITTED_S * f))))
        return sines

    def _steps(self, axis: int) -> list[float]:
        """Return the position per cycle of alternating steps, each as steep as possible without feed-forward rate."""
        slope = _STEP_FRACTION * float(self._params.acceleration_max[axis]) * self._dt**2
        largest = min(_STEP_M if axis < 3 else _STEP_RAD, self._largest_amplitude(axis))
        cycles = min(_STEP_CYCLES, math.ceil(largest / slope))
        size = min(largest, cycles * slope)
        each = round(_STEP_PERIOD_S / self._dt)
        up = [min(size, (k + 1) * size / cycles) for k in range(each)]
        down = [size - position for position in up]
        return _STEPS // 2 * (up + down)

    def _axis_s(self, axis: int) -> float:
        return _STEPS * _STEP_PERIOD_S + sum(sine.duration_s for sine in self._sines(axis))

    def _record(self, axis: int, centre: Array, tick: Tick, cycles: int, path: Path) -> tuple[Series, Tick]:
        """Move ``axis`` along ``path`` for ``cycles`` cycles; return its setpoints and encoder samples."""
        sent: list[tuple[float, float, float]] = []
        samples: dict[float, float] = {}
        start_s = tick.now_s
        for cycle in range(cycles):
            self._aim(axis, centre, *path(cycle, tick.now_s - start_s))
            self._bench.command(self._target, tick.now_s, self._params)
            position, rate = _of_axis(self._now.setpoint, axis)
            sent.append((tick.now_s + self._dt, position, rate))
            tick = self._next(tick)
            sample = self._bench.feedback[axis // 3]
            samples[sample.t_s] = float(sample.position[axis % 3])
        commanded_s, positions, rates = np.array(sent).T
        measured = np.array(sorted(samples.items()))
        return Series(commanded_s, positions, rates, measured[:, 0], measured[:, 1]), tick

    def _move(self, target: Array, tick: Tick) -> Tick:
        """Move slowly to ``target`` (6,) and wait until the axes are at rest."""
        end = new(AXES)
        end.rail_m, end.gimbal_rad = target[:3], target[3:]
        start = new(AXES)
        start.rail_m, start.gimbal_rad = self._bench.motion.position[:3], self._bench.motion.position[3:]
        move = Move(self._params, start, end)
        moved_s = 0.0
        while moved_s < move.duration_s + 2.0 * self._dt or not self._at_rest(tick):
            if moved_s > move.duration_s + _SETTLE_S:
                raise table.STANDSTILL.trip("bench", "not reached", _SETTLE_S)
            moved_s += self._dt
            move.at(moved_s, self._target)
            self._bench.command(self._target, tick.now_s, move.limits)
            tick = self._next(tick, counts=False)
        return tick

    def _at_rest(self, tick: Tick) -> bool:
        return self._bench.at_rest(tick.now_s)

    def _aim(self, axis: int, centre: Array, offset: float, rate: float) -> None:
        position, speed = centre.copy(), np.zeros(6)
        position[axis] += offset
        speed[axis] = rate
        self._target.rail_m, self._target.gimbal_rad = position[:3], position[3:]
        self._target.rail_mps, self._target.gimbal_radps = speed[:3], speed[3:]

    def _next(self, previous: Tick, counts: bool = True) -> Tick:
        """Wait for the next cycle, with the safety checks of a run."""
        tick = self._sequencer.tick()
        self._sequencer.hold_requested(Mode.PLACING)
        if counts:
            self._done_s += tick.now_s - previous.now_s
        if self._sequencer.ticks % _PROGRESS_CYCLES == 0:
            self._on_progress(self._title, min(1.0, self._done_s / self._all_s))
        return tick


def _of_axis(axes: np.record, axis: int) -> tuple[float, float]:
    """Return position and rate of one axis of AXES."""
    if axis < 3:
        return float(axes.rail_m[axis]), float(axes.rail_mps[axis])
    return float(axes.gimbal_rad[axis - 3]), float(axes.gimbal_radps[axis - 3])


def _middle(series: Series, sine: _Sine) -> Series:
    """Return the complete periods of a sine without its fading in and out."""
    start_s = series.commanded_s[0] + 1.0 / sine.frequency_hz
    end_s = start_s + sine.periods / sine.frequency_hz - 1e-9
    sent = (series.commanded_s >= start_s - 1e-9) & (series.commanded_s < end_s)
    measured = (series.measured_s >= start_s - 1e-9) & (series.measured_s < end_s)
    return Series(
        series.commanded_s[sent],
        series.position[sent],
        series.rate[sent],
        series.measured_s[measured],
        series.measured[measured],
    )


def _result(name: str, step: StepFit, sweep: SweepFit) -> AxisResult:
    """Return the result with the first reason for a rejection."""
    slowest = sweep.points[0]
    reason = ""
    if abs(slowest.gain - 1.0) > GAIN_ERROR_MAX:
        reason = f"gain {slowest.gain:.3f} at {slowest.frequency_hz:g} Hz, allowed 1 +- {GAIN_ERROR_MAX:g}"
    elif sweep.residual > RESIDUAL_MAX:
        reason = f"residual of the sines {100.0 * sweep.residual:.1f} %, allowed {100.0 * RESIDUAL_MAX:g} %"
    elif step.residual > RESIDUAL_MAX:
        reason = f"residual of the steps {100.0 * step.residual:.1f} %, allowed {100.0 * RESIDUAL_MAX:g} %"
    elif abs(sweep.delay_s) > LEAD_MAX_S:
        reason = f"delay {1e3 * sweep.delay_s:.1f} ms, allowed {1e3 * LEAD_MAX_S:g} ms"
    elif sweep.delay_sigma_s > DELAY_SIGMA_MAX_S:
        reason = f"sigma of the delay {1e3 * sweep.delay_sigma_s:.2f} ms, allowed {1e3 * DELAY_SIGMA_MAX_S:g} ms"
    return AxisResult(name, step, sweep, reason)
