"""Axes other than rails and turntable: placed before the run is armed, held and monitored during it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np

from hil.config.rig import AxisGroupTable, HeldAtPlace
from hil.core.messages import Array, Homing
from hil.drivers.base import AxisGroup, LimitsSetpoints
from hil.errors import SafetyTrip
from hil.loop.bench_stage import BenchStage, Move
from hil.loop.rate_keeper import Tick
from hil.models.profile import along_smooth_line, duration

FRACTION_OF_LIMITS: Final = Move.FRACTION_OF_LIMITS
_SETTLE_S: Final = 3.0  # allowed after the move until the axes are at their places
_SETTLED: Final = 0.001  # m or rad


class TargetStage(Protocol):
    """Carrier of the target, as used by cycle and runner."""

    @property
    def groups(self) -> tuple[TargetAxes, ...]:
        """The axis groups that it drives."""

    def open(self, now_s: float) -> None:
        """Open the device; it holds its position. Raises DeviceError."""

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed. Raises DeviceError."""

    def not_homed(self, now_s: float) -> str:
        """Return the name of an axis that is not homed, "" if all are. Raises SafetyTrip if homing has failed."""

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move slowly to the place. Raises BenchError.

        tick: waits for the next cycle, of period ``step_s``, s, and checks the bench.
        """

    def check(self, now_s: float) -> None:
        """Raise SafetyTrip if the target is not at its place, DeviceError on failure."""

    def relate(self, axes: np.record) -> None:
        """Replace positions of rails and turntable, AXES, by those relative to the target, if it moves in a run."""

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Record the physical axes, with those of ``chaser``, at ``t_s`` of the run, if the target moves in it.

        run_zero_s: bench time of the run's time zero.
        """

    def stop(self, now_s: float) -> None:
        """Stop the device. Never raises."""

    def disable(self, now_s: float) -> None:
        """Switch the torque off. Never raises."""

    def close(self) -> None:
        """Close the link. Never raises."""


class FixedTarget:
    """Fixed target."""

    groups = ()

    def open(self, now_s: float) -> None: ...

    def home(self, now_s: float) -> None: ...

    def not_homed(self, now_s: float) -> str:
        return ""

    def place(self, tick: Callable[[], Tick], step_s: float) -> None: ...

    def check(self, now_s: float) -> None: ...

    def relate(self, axes: np.record) -> None: ...

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None: ...

    def stop(self, now_s: float) -> None: ...

    def disable(self, now_s: float) -> None: ...

    def close(self) -> None: ...


class TargetAxes:
    """Target or another body on axes, m or rad: placed before the run is armed."""

    def __init__(self, axes: AxisGroup, config: AxisGroupTable, place: Array) -> None:
        self.axes = axes
        self.rotates = config.si_per_unit != 1.0
        """Whether they rotate, rad, rather than move along lines, m."""
        self.place_at = place
        """Position (n,) that ``place`` moves to."""
        limits = np.array([axis.limits for axis in config.axes])
        self._smooth_s = np.array([axis.averaging_s for axis in config.axes])
        self._speed, self._acceleration = FRACTION_OF_LIMITS * limits[:, 2], FRACTION_OF_LIMITS * limits[:, 3]
        self.acceleration_max = limits[:, 3]

    @property
    def groups(self) -> tuple[TargetAxes, ...]:
        """This group."""
        return (self,)

    def open(self, now_s: float) -> None:
        """Open the axes; they hold their positions."""
        self.axes.open(now_s)

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed."""
        self.axes.home(now_s)

    def not_homed(self, now_s: float) -> str:
        """Return the name of an axis that is not homed, "" if all are."""
        waiting = ""
        for name, state in zip(self.axes.axis_names, self.axes.read(now_s).homing, strict=True):
            if state is Homing.FAILED:
                raise SafetyTrip(name, "homing", "failed", "home switch found")
            waiting = waiting or ("" if state is Homing.DONE else name)
        return waiting

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move all axes slowly to the place and wait until they are at rest there."""
        now_s = tick().now_s
        feedback = self.axes.read(now_s)
        for name, homing in zip(self.axes.axis_names, feedback.homing, strict=True):
            if homing is not Homing.DONE:
                raise SafetyTrip(name, "homing", homing.name.lower().replace("_", " "), "done before a run")
        start, distance = feedback.position.copy(), self.place_at - feedback.position
        if isinstance(self.axes, LimitsSetpoints):
            self.axes.set_limits(Move.RESERVE * self._speed, Move.RESERVE * self._acceleration)
        moved_s = 0.0
        limits = list(zip(np.abs(distance), self._speed, self._acceleration, self._smooth_s, strict=True))
        duration_s = max(duration(length, speed, up, up) + smooth_s for length, speed, up, smooth_s in limits)
        position, motion, along = start.copy(), np.zeros(len(start)), np.empty(2)
        while moved_s <= duration_s or self._off(now_s) > _SETTLED:
            if moved_s > duration_s + _SETTLE_S:
                raise SafetyTrip(self.axes.name, "place", "not reached", f"{_SETTLE_S:g} s after the move")
            for i, (length, speed, up, smooth_s) in enumerate(limits):
                along_smooth_line(length, speed, up, up, smooth_s, moved_s, along)
                position[i] = start[i] + math.copysign(along[0], distance[i])
                motion[i] = math.copysign(along[1], distance[i])
            self.axes.send(position, motion, now_s)
            now_s = tick().now_s
            moved_s += step_s  # a late cycle delays the move
        self.axes.send(self.place_at, np.zeros(len(start)), now_s)

    def stop(self, now_s: float) -> None:
        """Stop the axes."""
        self.axes.stop(now_s)

    def disable(self, now_s: float) -> None:
        """Switch the torque of the axes off."""
        self.axes.disable(now_s)

    def close(self) -> None:
        """Close the axes."""
        self.axes.close()

    def _off(self, now_s: float) -> float:
        return float(np.abs(self.axes.read(now_s).position - self.place_at).max())


class HeldAxes(TargetAxes):
    """Axes of ``config``, those of a target manipulator or further ones, held at their place during the run."""

    def __init__(self, axes: AxisGroup, config: HeldAtPlace) -> None:
        place, self._held_within = config.place
        super().__init__(axes, config, np.array(place))
        self._largest = np.zeros(len(place))

    def check(self, now_s: float) -> None:
        """Raise SafetyTrip if an axis is further from its place than the rig file allows."""
        error = np.abs(self.axes.read(now_s).position - self.place_at)
        np.maximum(self._largest, error, out=self._largest)
        worst = int(error.argmax())
        if not error[worst] <= self._held_within:
            value, limit = self._text(error[worst], 4), self._text(self._held_within)
            raise SafetyTrip(self.axes.axis_names[worst], "distance from commanded place", value, limit)

    def relate(self, axes: np.record) -> None:
        """Change nothing: the axes stand."""

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Record nothing: the axes stand."""

    def numbers(self) -> dict[str, float]:
        """Return the largest distances from their places while armed and running, for the JSON, in m or deg."""
        unit, scale = ("deg", math.degrees(1.0)) if self.rotates else ("m", 1.0)
        names = (name.rpartition(".")[2] for name in self.axes.axis_names)
        return {f"{name}_{unit}": scale * float(value) for name, value in zip(names, self._largest, strict=True)}

    def _text(self, value: float, places: int | None = None) -> str:
        shown, unit = (math.degrees(value), "deg") if self.rotates else (value, "m")
        return f"{shown:g} {unit}" if places is None else f"{shown:.{places}f} {unit}"


class AxesTogether:
    """Target and further axes as one stage: what is done is done to each in turn, a stop to all."""

    def __init__(self, stages: Sequence[TargetStage]) -> None:
        self._stages = tuple(stages)

    @property
    def groups(self) -> tuple[TargetAxes, ...]:
        """The axis groups of all stages."""
        return tuple(group for stage in self._stages for group in stage.groups)

    def open(self, now_s: float) -> None:
        """Open all devices."""
        for stage in self._stages:
            stage.open(now_s)

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed."""
        for stage in self._stages:
            stage.home(now_s)

    def not_homed(self, now_s: float) -> str:
        """Return the name of an axis that is not homed, "" if all are."""
        return next(filter(None, [stage.not_homed(now_s) for stage in self._stages]), "")

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move one group after the other to its place."""
        for stage in self._stages:
            stage.place(tick, step_s)

    def check(self, now_s: float) -> None:
        """Check all groups."""
        for stage in self._stages:
            stage.check(now_s)

    def relate(self, axes: np.record) -> None:
        """Relate the axes to the target."""
        for stage in self._stages:
            stage.relate(axes)

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Record the axes that move in a run."""
        for stage in self._stages:
            stage.record(t_s, run_zero_s, chaser)

    def stop(self, now_s: float) -> None:
        """Stop all groups."""
        for stage in self._stages:
            stage.stop(now_s)

    def disable(self, now_s: float) -> None:
        """Switch the torque of all groups off."""
        for stage in self._stages:
            stage.disable(now_s)

    def close(self) -> None:
        """Close all groups."""
        for stage in self._stages:
            stage.close()
