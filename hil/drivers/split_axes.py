"""Drivers of a rig with wires, as its configuration selects them; those of one group on several controllers as one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from hil.config.rig import AxisGroupTable, Rig
from hil.core.clock import BenchClock, Order
from hil.core.messages import Array, AxisFeedback, Homing, PoseFrame
from hil.core.plug_ins import is_plug_in
from hil.drivers.base import (
    NO_TORQUE_LIMIT,
    AxisGroup,
    Describes,
    Jogs,
    LimitsSetpoints,
    LimitsTorque,
    Parks,
    PoseSource,
    Streams,
    accepted_setpoint,
    full_names,
)
from hil.drivers.returned import checked_feedback
from hil.drivers.vmu import COUNTERS, NAME
from hil.errors import BenchError


@dataclass(frozen=True)
class AxisPart:
    """A part of a group. numbers: indices of its axes in the group."""

    axes: AxisGroup
    numbers: list[int]


class SplitAxes:
    """AxisGroup of ``parts``; feedback is as old as the oldest part's, and the failure of one stops all.

    axis_names: full names of all axes.
    """

    def __init__(self, name: str, axis_names: tuple[str, ...], parts: Sequence[AxisPart], clock: BenchClock) -> None:
        self.name = name
        self.axis_names = axis_names
        self._parts = tuple(parts)
        self._clock = clock

    def open(self, now_s: float) -> None:
        """Open the parts one after the other; if one fails, those before are closed. Raises DeviceError."""
        try:
            for part in self._parts:
                part.axes.open(self._clock.now_s())
        except BenchError:
            self.close()
            raise

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed."""
        for part in self._parts:
            part.axes.home(now_s)

    def set_jogging(self, on: bool) -> None:
        for part in self._parts:
            if isinstance(part.axes, Jogs):
                part.axes.set_jogging(on)

    def set_period(self, period_s: float) -> None:
        for part in self._parts:
            if isinstance(part.axes, Streams):
                part.axes.set_period(period_s)

    def limit_torque(self, axis: int, reduced: bool) -> None:
        """Start to reduce the torque limit of ``axis``, or to restore it."""
        part, number = self._part_of(axis)
        if isinstance(part, LimitsTorque):
            part.limit_torque(number, reduced)

    def torque_limit(self, axis: int) -> str:
        """Return what became of that, "" before it is done."""
        part, number = self._part_of(axis)
        return part.torque_limit(number) if isinstance(part, LimitsTorque) else NO_TORQUE_LIMIT

    def _part_of(self, axis: int) -> tuple[AxisGroup, int]:
        part = next(part for part in self._parts if axis in part.numbers)
        return part.axes, part.numbers.index(axis)

    def facts(self) -> list[str]:
        """Return what the drivers use of the opened drives, a line each."""
        return [line for part in self._parts if isinstance(part.axes, Describes) for line in part.axes.facts()]

    def set_limits(self, rate: Array, acceleration: Array) -> None:
        """Set the limits (n,) within which the axes catch up after a gap in the setpoints."""
        for part in self._parts:
            if isinstance(part.axes, LimitsSetpoints):
                part.axes.set_limits(rate[part.numbers], acceleration[part.numbers])

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Send each part its setpoint; return the accepted position (n,)."""
        accepted = np.empty(len(self.axis_names))
        try:
            for part in self._parts:
                accepted[part.numbers] = part.axes.send(position[part.numbers], rate[part.numbers], now_s)
        except BenchError:
            self.stop(now_s)
            raise
        return accepted

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback of all parts, with the time of the oldest."""
        n = len(self.axis_names)
        position, rate = np.empty(n), np.empty(n)
        homing, limit, sampled_s = [Homing.DONE] * n, [0] * n, now_s
        try:
            for part in self._parts:
                feedback = part.axes.read(now_s)
                if is_plug_in(type(part.axes)):
                    feedback = checked_feedback(self.name, part.axes.read, feedback, len(part.numbers))
                sampled_s = min(sampled_s, feedback.t_s)
                position[part.numbers], rate[part.numbers] = feedback.position, feedback.rate
                for axis, state, switch in zip(part.numbers, feedback.homing, feedback.limit, strict=True):
                    homing[axis], limit[axis] = state, switch
        except BenchError:
            self.stop(now_s)
            raise
        return AxisFeedback(sampled_s, position, rate, tuple(homing), tuple(limit))

    def stop(self, now_s: float) -> None:
        """Stop all parts, each in a thread: a dead controller must not delay the stop of the others."""
        first, *others = self._parts
        for part in others:
            self._clock.start_thread(partial(part.axes.stop, now_s), "stop", Order.REQUESTS)
        first.axes.stop(now_s)

    def disable(self, now_s: float) -> None:
        """Switch the torque of all parts off."""
        for part in self._parts:
            part.axes.disable(now_s)

    def close(self) -> None:
        """Close all parts."""
        for part in self._parts:
            part.axes.close()

    def counters(self) -> dict[str, int]:
        """Return the sums of the parts' counters since ``open``."""
        total: Counter[str] = Counter()
        for part in self._parts:
            count = getattr(part.axes, "counters", None)
            total.update(count() if count is not None else {})
        return dict(total)


class SplitParkingAxes(SplitAxes):
    """Parts that all have profiled moves."""

    def move_to(self, position: Array, rate: Array, now_s: float) -> Array:
        """Move to ``position`` (n,) at most at ``rate`` (n,) and hold there; return the accepted goal."""
        goal = np.empty(len(self.axis_names))
        for part in self._parts:
            assert isinstance(part.axes, Parks)
            goal[part.numbers] = part.axes.move_to(position[part.numbers], rate[part.numbers], now_s)
        return goal


class FixedAxes:
    """AxisGroup of the fixed axes of ``table``: they stand where the rig file has them, whatever is sent."""

    def __init__(self, name: str, table: AxisGroupTable) -> None:
        fixed = [axis for axis in table.axis_names if axis not in table.driven]
        self.name = name
        self.axis_names = full_names(name, fixed)
        self._at = np.array([getattr(table, axis).si("park") for axis in fixed])

    def open(self, now_s: float) -> None:
        """Do nothing, as in all other orders."""

    def home(self, now_s: float) -> None:
        """Do nothing: the position is known."""

    def set_jogging(self, on: bool) -> None:
        """Do nothing."""

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Return where the axes stand. Raises SafetyTrip for a value that is not finite."""
        return accepted_setpoint(self.axis_names, position, self._at, self._at)

    def move_to(self, position: Array, rate: Array, now_s: float) -> Array:
        """Return where the axes stand."""
        return self.send(position, rate, now_s)

    def read(self, now_s: float) -> AxisFeedback:
        """Return where the axes stand, at rest."""
        return AxisFeedback(now_s, self._at.copy(), np.zeros_like(self._at))

    def stop(self, now_s: float) -> None:
        """Do nothing."""

    def disable(self, now_s: float) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class RigDrivers:
    """Drivers of a rig. axes: by the names of their devices, ``rails`` and ``turntable`` first.

    poses: vision unit, one that never sends any for a rig without.
    """

    axes: dict[str, AxisGroup]
    poses: PoseSource


def make_drivers(rig: Rig, clock: BenchClock, period_s: float | None = None) -> RigDrivers:
    """Return the drivers of all axes and of the vision unit. period_s: of the setpoints; None: at any time."""
    robots: dict[str, AxisGroup] = {}
    if rig.robots:
        from hil.drivers.arm.device import make_arms  # of few rigs

        robots = make_arms(rig, clock)
    axes = {name: make_axes(table, clock, name, robots) for name, table in rig.axis_groups.items()}
    for group in axes.values():
        if period_s is not None and isinstance(group, Streams):
            group.set_period(period_s)
    return RigDrivers(axes, rig.vmu.make_driver(clock) if rig.has_vmu else AbsentVmu())


def make_axes(
    table: AxisGroupTable, clock: BenchClock, name: str, robots: Mapping[str, AxisGroup] | None = None
) -> AxisGroup:
    """Return the driver of the axes of ``table``: its own, or one per controller and for fixed axes, together.

    robots: axes of robots, by the names of the groups that they stand for.
    """
    made = [
        AxisPart(
            (robots or {}).get(part_name) or part.make_driver(clock, part_name),
            [table.axis_names.index(axis) for axis in part.axis_names],
        )
        for part_name, part in table.parts(name).items()
    ]
    if fixed := [n for n, axis in enumerate(table.axis_names) if axis not in table.driven]:
        made.append(AxisPart(FixedAxes(name, table), fixed))
    if len(made) == 1:
        return made[0].axes
    split = SplitParkingAxes if all(isinstance(part.axes, Parks) for part in made) else SplitAxes
    return split(name, full_names(name, table.axis_names), made, clock)


class AbsentVmu:
    """Vision unit that is not there: no pose ever comes, and none is missing."""

    name = NAME

    def open(self, now_s: float) -> None:
        """Do nothing."""

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return no poses."""
        return []

    def counters(self) -> dict[str, int]:
        """Return the counters of a vision unit, all 0."""
        return dict.fromkeys(COUNTERS, 0)

    def close(self) -> None:
        """Do nothing."""
