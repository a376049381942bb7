"""Axes other than rails and turntable: placed before the run is armed, held and monitored during it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hil.config.rig import HeldAtPlace
from hil.core.held_records import HELD_SAMPLE
from hil.drivers.base import AxisGroup
from hil.errors import SafetyTrip
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.loop.bench_stage import BenchStage
from hil.loop.rate_keeper import Tick
from hil.loop.target_axes import TargetAxes


class HeldAxes(TargetAxes):
    """Axes of ``config``, those of a target manipulator or further ones, held at their place during the run.

    number: among the groups of the rig that are held.
    """

    def __init__(self, axes: AxisGroup, config: HeldAtPlace, number: int = 0) -> None:
        place, self._held_within = config.place
        super().__init__(axes, config, np.array(place))
        self._largest = np.zeros(len(place))
        self.sink: Telemetry = NoTelemetry()
        """Receives the axes in each cycle, as a row of HELD_SAMPLE."""
        self._sample = np.zeros(1, HELD_SAMPLE)
        self._sample["group"], self._sample["setpoint"][0, : len(place)] = number, place

    def check(self, now_s: float) -> None:
        """Read the axes; raise SafetyTrip if one is further from its place than the rig file allows."""
        self.read(now_s)
        error = np.abs(self.feedback.position - self.place_at)
        np.maximum(self._largest, error, out=self._largest)
        worst = int(error.argmax())
        if not error[worst] <= self._held_within:
            value, limit = self.text(error[worst], 4), self.text(self._held_within)
            raise SafetyTrip(self.axes.axis_names[worst], "distance from commanded place", value, limit)
        self._check_speeds()

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Send place and encoders, as this cycle has read them, to the sink."""
        row, feedback, n = self._sample, self.feedback, len(self.place_at)
        row["t_s"], row["sampled_s"] = t_s, feedback.t_s - run_zero_s
        row["position"][0, :n], row["rate"][0, :n] = feedback.position, feedback.rate
        self.sink.put(row)

    def numbers(self) -> dict[str, float]:
        """Return the largest distances from their places while armed and running, for the JSON, in m or deg."""
        unit, scale = ("deg", math.degrees(1.0)) if self.rotates else ("m", 1.0)
        names = (name.rpartition(".")[2] for name in self.axes.axis_names)
        return {f"{name}_{unit}": scale * float(value) for name, value in zip(names, self._largest, strict=True)}


class AxesTogether:
    """Target and further axes as one stage, without any a fixed target: what is done is done to each in turn."""

    def __init__(self, groups: Sequence[TargetAxes] = ()) -> None:
        self.groups = tuple(groups)
        """The axis groups."""

    def open(self, now_s: float) -> None:
        """Open all devices."""
        for group in self.groups:
            group.open(now_s)

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed."""
        for group in self.groups:
            group.home(now_s)

    def not_homed(self, now_s: float) -> str:
        """Return the name of an axis that is not homed, "" if all are."""
        return next(filter(None, [group.not_homed(now_s) for group in self.groups]), "")

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move one group after the other to its place."""
        for group in self.groups:
            group.place(tick, step_s)

    def park(self, tick: Callable[[], Tick], step_s: float, rate_fraction: float) -> None:
        """Move one group after the other to its park position, the last one first."""
        for group in reversed(self.groups):
            group.park(tick, step_s, rate_fraction)

    def read(self, now_s: float) -> None:
        """Read all groups."""
        for group in self.groups:
            group.read(now_s)

    def check(self, now_s: float) -> None:
        """Check all groups."""
        for group in self.groups:
            group.check(now_s)

    def relate(self, axes: np.record) -> None:
        """Relate the axes to the target."""
        for group in self.groups:
            group.relate(axes)

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Record all groups."""
        for group in self.groups:
            group.record(t_s, run_zero_s, chaser)

    def stop(self, now_s: float) -> None:
        """Stop all groups."""
        for group in self.groups:
            group.stop(now_s)

    def disable(self, now_s: float) -> None:
        """Switch the torque of all groups off."""
        for group in self.groups:
            group.disable(now_s)

    def close(self) -> None:
        """Close all groups."""
        for group in self.groups:
            group.close()
