"""Moves the axes of a bench one by one, gently, and measures how each follows its setpoints.

All motion goes through ``Bench.command``: limits, supervisor and emergency stop hold as in a run. The
leads of the rig file are left out while measuring; what is found is the lead that the axis needs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.commission.response_fit import Series, StepFit, SweepFit, fit_sine, fit_step, fit_sweep
from hil.config.rig import LEAD_MAX_S
from hil.core.messages import AXES, Array, new
from hil.core.modes import Mode
from hil.errors import SafetyTrip
from hil.loop.bench_stage import Move
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.rate_keeper import Tick

FREQUENCIES_HZ: Final = (0.5, 0.8, 1.25, 2.0, 3.15, 5.0, 8.0)
_SHARE_OF_CYCLE_RATE: Final = 1.0 / 6.0  # fastest sine
_SWEEP_M, _SWEEP_RAD = 0.003, math.radians(0.3)  # largest amplitude
_STEP_M, _STEP_RAD = 0.001, math.radians(0.1)  # largest step
_SHARE_OF_RATE: Final = 0.3
_SHARE_OF_ACCELERATION: Final = 0.3
_SHARE_OF_TRAVEL: Final = 0.25
_STEPS: Final = 8
_STEP_EVERY_S: Final = 0.5
_STEP_CYCLES: Final = 5  # a step is spread over so many where acceleration asks for it
_STEP_SHARE: Final = 0.9  # of the speed that an axis may take on, or lose, in a cycle
_FITTED_S: Final = 2.0  # of each sine at least, beside its fading in and out
_FITTED_PERIODS: Final = 2
_TELL_EVERY: Final = 10
_SETTLE_S: Final = 3.0
RESIDUAL_MAX: Final = 0.1
DELAY_SIGMA_MAX_S: Final = 0.002
GAIN_ERROR_MAX: Final = 0.1  # of the slowest sine: an axis that is stuck or wrongly scaled does not follow

Path = Callable[[int, float], tuple[float, float]]
"""Gives, for a cycle and the time since the first one, position about the centre and rate."""

Tell = Callable[[str, float], None]
"""Told now and then what is under way and how far along everything is, 0..1."""


@dataclass(frozen=True)
class AxisResult:
    """What was found of one axis, and why it is not to be trusted (empty where it is)."""

    axis: str
    step: StepFit
    sweep: SweepFit
    reason: str

    @property
    def passed(self) -> bool:
        return not self.reason

    @property
    def lead_s(self) -> float:
        """By how much its setpoints are to be taken ahead."""
        return self.sweep.delay_s


@dataclass(frozen=True)
class _Sine:
    """One sine that fades in and out, over ``periods`` and one more at each end."""

    frequency_hz: float
    amplitude: float
    periods: int

    @property
    def duration_s(self) -> float:
        return (self.periods + 2) / self.frequency_hz

    def path(self, _cycle: int, t_s: float) -> tuple[float, float]:
        """Return position about the centre and rate, ``t_s`` after the begin."""
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
    """Measures axes of an open bench in standby. Raises BenchError; whoever opened the bench stops it then."""

    def __init__(self, sequencer: MotionSequencer, tell: Tell) -> None:
        self._sequencer = sequencer
        self._bench = sequencer.loop.bench
        self._now = sequencer.loop.now
        self._params = self._bench.params.copy()
        self._params.lead = 0.0
        self._dt = float(self._params.dt_s)
        self._tell = tell
        self._title = ""
        self._done_s, self._all_s = 0.0, 1.0
        self._wanted = new(AXES)

    def measure(self, axes: Sequence[int]) -> list[AxisResult]:
        """Move each of ``axes`` (0..2 rails, 3..5 gimbals) to and fro and put it back where it stood."""
        self._all_s = sum(self._axis_s(axis) for axis in axes)
        self._sequencer.home()
        self._sequencer.begin()
        tick = self._sequencer.seed_for_run()
        self._sequencer.modes.go(Mode.PLACING)  # every check of the supervisor is on in this mode
        results = []
        for axis in axes:
            result, tick = self._axis(axis, tick)
            results.append(result)
        self._sequencer.modes.go(Mode.STANDBY)
        return results

    def _axis(self, axis: int, tick: Tick) -> tuple[AxisResult, Tick]:
        stood_at = self._bench.motion.position.copy()
        centre = stood_at.copy()
        room = self._room(axis)
        centre[axis] = min(self._params.high[axis] - room, max(self._params.low[axis] + room, centre[axis]))
        name = self._bench.axis_names[axis]
        self._title = f"{name}: steps"
        tick = self._move(centre, tick)
        staircase = self._steps(axis)
        steps, tick = self._record(axis, centre, tick, len(staircase), lambda cycle, _: (staircase[cycle], 0.0))
        # held from when they are sent, not from the moment they belong to
        steps = Series(steps.commanded_s - self._dt, steps.position, steps.rate, steps.measured_s, steps.measured)
        points = []
        for sine in self._sines(axis):
            self._title = f"{name}: {sine.frequency_hz:g} Hz"
            cycles = math.ceil(sine.duration_s / self._dt) + 1
            series, tick = self._record(axis, centre, tick, cycles, sine.path)
            points.append(fit_sine(_middle(series, sine), sine.frequency_hz))
        tick = self._move(stood_at, tick)
        return _judged(name, fit_step(steps), fit_sweep(points, self._dt)), tick

    def _room(self, axis: int) -> float:
        """Return how far the axis may go from its centre."""
        largest = _SWEEP_M if axis < 3 else _SWEEP_RAD
        return min(largest, _SHARE_OF_TRAVEL * float(self._params.high[axis] - self._params.low[axis]))

    def _sines(self, axis: int) -> list[_Sine]:
        """Return the sines, within shares of travel, speed and acceleration also while they fade."""
        sines = []
        for f in (f for f in FREQUENCIES_HZ if f <= _SHARE_OF_CYCLE_RATE / self._dt * (1.0 + 1e-9)):
            w = math.tau * f
            amplitude = min(
                self._room(axis),
                _SHARE_OF_RATE * self._params.rate_max[axis] / w,
                _SHARE_OF_ACCELERATION * self._params.acceleration_max[axis] / w**2,
            )
            sines.append(_Sine(f, float(amplitude), max(_FITTED_PERIODS, math.ceil(_FITTED_S * f))))
        return sines

    def _steps(self, axis: int) -> list[float]:
        """Return the position, cycle by cycle, of steps to and fro, each as steep as goes without a rate."""
        slope = _STEP_SHARE * float(self._params.acceleration_max[axis]) * self._dt**2
        largest = min(_STEP_M if axis < 3 else _STEP_RAD, self._room(axis))
        cycles = min(_STEP_CYCLES, math.ceil(largest / slope))
        size = min(largest, cycles * slope)
        each = round(_STEP_EVERY_S / self._dt)
        up = [min(size, (k + 1) * size / cycles) for k in range(each)]
        down = [size - place for place in up]
        return _STEPS // 2 * (up + down)

    def _axis_s(self, axis: int) -> float:
        return _STEPS * _STEP_EVERY_S + sum(sine.duration_s for sine in self._sines(axis))

    def _record(self, axis: int, centre: Array, tick: Tick, cycles: int, path: Path) -> tuple[Series, Tick]:
        """Let ``axis`` go along ``path`` for so many cycles; return what it was told and where it went."""
        told: list[tuple[float, float, float]] = []
        seen: dict[float, float] = {}
        begun_s = tick.now_s
        for cycle in range(cycles):
            self._aim(axis, centre, *path(cycle, tick.now_s - begun_s))
            self._bench.command(self._wanted, tick.now_s, self._now.setpoint, self._params)
            place, rate = _of_axis(self._now.setpoint, axis)
            told.append((tick.now_s + self._dt, place, rate))
            tick = self._next(tick)
            sample = self._bench.feedback[axis // 3]
            seen[sample.t_s] = float(sample.position[axis % 3])
        commanded_s, position, rate_told = np.array(told).T
        at = np.array(sorted(seen.items()))
        return Series(commanded_s, position, rate_told, at[:, 0], at[:, 1]), tick

    def _move(self, target: Array, tick: Tick) -> Tick:
        """Move to ``target`` (6,) as to a start pose and wait until the axes stand."""
        there = new(AXES)
        there.rail_m, there.gimbal_rad = target[:3], target[3:]
        start = new(AXES)
        start.rail_m, start.gimbal_rad = self._bench.motion.position[:3], self._bench.motion.position[3:]
        move = Move(self._params, start, there)
        begun_s = tick.now_s
        while tick.now_s - begun_s < move.duration_s + 2.0 * self._dt or not self._stands(tick):
            if tick.now_s - begun_s > move.duration_s + _SETTLE_S:
                raise SafetyTrip("bench", "standstill", "not reached", f"{_SETTLE_S:g} s after a move")
            move.at(tick.now_s - begun_s + self._dt, self._wanted)
            self._bench.command(self._wanted, tick.now_s, self._now.setpoint, self._params)
            tick = self._next(tick, counts=False)
        return tick

    def _stands(self, tick: Tick) -> bool:
        return self._bench.at_rest(tick.now_s, self._now.feedback)

    def _aim(self, axis: int, centre: Array, place: float, rate: float) -> None:
        position, speed = centre.copy(), np.zeros(6)
        position[axis] += place
        speed[axis] = rate
        self._wanted.rail_m, self._wanted.gimbal_rad = position[:3], position[3:]
        self._wanted.rail_mps, self._wanted.gimbal_radps = speed[:3], speed[3:]

    def _next(self, before: Tick, counts: bool = True) -> Tick:
        """Take the next cycle, supervised as in a run."""
        tick = self._sequencer.tick()
        self._sequencer.hold_requested(Mode.PLACING)
        if counts:
            self._done_s += tick.now_s - before.now_s
        if self._sequencer.ticks % _TELL_EVERY == 0:
            self._tell(self._title, min(1.0, self._done_s / self._all_s))
        return tick


def _of_axis(axes: np.record, axis: int) -> tuple[float, float]:
    """Return position and rate of one axis of AXES."""
    if axis < 3:
        return float(axes.rail_m[axis]), float(axes.rail_mps[axis])
    return float(axes.gimbal_rad[axis - 3]), float(axes.gimbal_radps[axis - 3])


def _middle(series: Series, sine: _Sine) -> Series:
    """Return the whole periods of a sine that neither fades in nor out."""
    begin_s = series.commanded_s[0] + 1.0 / sine.frequency_hz
    end_s = begin_s + sine.periods / sine.frequency_hz - 1e-9
    told = (series.commanded_s >= begin_s - 1e-9) & (series.commanded_s < end_s)
    went = (series.measured_s >= begin_s - 1e-9) & (series.measured_s < end_s)
    return Series(
        series.commanded_s[told],
        series.position[told],
        series.rate[told],
        series.measured_s[went],
        series.measured[went],
    )


def _judged(name: str, step: StepFit, sweep: SweepFit) -> AxisResult:
    """Return the result with the first reason not to trust it."""
    slowest = sweep.points[0]
    reason = ""
    if abs(slowest.gain - 1.0) > GAIN_ERROR_MAX:
        reason = f"gain {slowest.gain:.3f} at {slowest.frequency_hz:g} Hz, allowed 1 +- {GAIN_ERROR_MAX:g}"
    elif sweep.residual > RESIDUAL_MAX:
        reason = f"residual of the sines {100.0 * sweep.residual:.1f} %, allowed {100.0 * RESIDUAL_MAX:g} %"
    elif step.residual > RESIDUAL_MAX:
        reason = f"residual of the steps {100.0 * step.residual:.1f} %, allowed {100.0 * RESIDUAL_MAX:g} %"
    elif abs(sweep.delay_s) > LEAD_MAX_S:
        reason = f"delay {1e3 * sweep.delay_s:.1f} ms, allowed {1e3 * LEAD_MAX_S:g} ms to either side"
    elif sweep.delay_sigma_s > DELAY_SIGMA_MAX_S:
        reason = f"delay known to {1e3 * sweep.delay_sigma_s:.2f} ms, allowed {1e3 * DELAY_SIGMA_MAX_S:g} ms"
    return AxisResult(name, step, sweep, reason)
