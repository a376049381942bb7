"""Status of the bench: a record in shared memory, written by the loop about twenty times per second in every mode."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Final

import numpy as np

from hil.bench.kinematics import write_axes
from hil.bench.manipulator import relative_axes
from hil.config.rig import BENCH_AXES, FURTHER_AXES_MAX, GIMBAL_NAMES
from hil.core.messages import AXES
from hil.core.modes import Mode
from hil.core.sensor_records import MAX_SENSORS
from hil.errors import BenchError
from hil.loop.bench_stage import MovesTarget
from hil.loop.runner import Runner
from hil.loop.safety_io_stage import SafetyIoStage

MODES: Final = tuple(Mode)
AXES_SHOWN: Final = len(BENCH_AXES) + len(GIMBAL_NAMES) + FURTHER_AXES_MAX
DEVICES: Final = ("rails", "turntable", "vmu", "io")
UNKNOWN: Final = -1

SENSOR = np.dtype([("measured_s", "f8"), ("sigmas", "f8"), ("state", "i8")])
"""As of ``SensorState``."""
STATUS = np.dtype(
    [
        ("mode", "i8"),  # index in MODES
        ("bench_s", "f8"),
        ("run_s", "f8"),  # time of the run's last cycle
        ("fraction", "f8"),  # completed, of the present sequence, 0..1
        ("feedback", AXES),  # of a rig with a rotary manipulator in the lab, in each mode
        ("setpoint", AXES),
        ("age_s", "f8", len(DEVICES)),  # of the last data of each of DEVICES; nan if unknown
        ("homing", "i8", AXES_SHOWN),  # in the order of ``Rig.axis_names``
        ("limit", "i8", AXES_SHOWN),
        ("estop", "i8"),  # 1 pressed, 0 released, UNKNOWN
        ("frames", "i8"),
        ("overruns", "i8"),
        ("skipped_periods", "i8"),
        ("limited_cycles", "i8"),
        ("position", "f8", AXES_SHOWN),  # encoders of the axes after the first six, m or rad
        ("rate", "f8", AXES_SHOWN),
        ("axis_age_s", "f8", AXES_SHOWN),
        ("relative", AXES),  # ``feedback`` relative to the target, of a rotary manipulator
        ("sensors", SENSOR, MAX_SENSORS),  # in the order of the loop's records
    ],
    align=True,
)
CELLS: Final = {"status": STATUS}


class StatusWriter:
    """Writes STATUS from a runner, in the loop's thread."""

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self.record = np.zeros(1, STATUS)
        self._view: np.record = self.record.view(np.recarray)[0]
        self._frames = -1
        self._frame_s = math.nan
        self.fraction = 0.0

    def fill(self, now_s: float) -> np.ndarray:
        """Return STATUS (1,) at bench time ``now_s``; always the same array."""
        runner, out = self._runner, self._view
        loop, bench = runner.loop, runner.loop.bench
        out.mode = MODES.index(runner.safety.modes.mode)
        out.bench_s, out.run_s, out.fraction = now_s, loop.now.t_s[0], self.fraction
        self.record["feedback"] = loop.now.row["feedback"]
        self.record["setpoint"] = loop.now.row["setpoint"]
        out.estop = UNKNOWN
        out.age_s[:] = math.nan
        if hasattr(bench, "feedback"):
            rails, turntable = bench.feedback
            out.age_s[0], out.age_s[1] = now_s - rails.t_s, now_s - turntable.t_s
            out.homing[:6] = (*rails.homing, *turntable.homing)
            out.limit[:6] = (*rails.limit, *turntable.limit)
            first = 6
            for group in loop.target.groups:
                feedback, places = group.feedback, slice(first, first + len(group.feedback.position))
                out.homing[places], out.limit[places] = feedback.homing, feedback.limit
                out.position[places], out.rate[places], out.axis_age_s[places] = (
                    feedback.position, feedback.rate, now_s - feedback.t_s
                )  # fmt: skip
                first = places.stop
            if bench.manipulator is not None:
                self._read_manipulator(bench.manipulator)
            out.age_s[2] = self._age_of_frames(now_s)
            self._read_safety_io(now_s)
        if loop.sensors is not None:
            for number, state in enumerate(loop.sensors.states()):
                self.record["sensors"][0, number] = state
        rate = runner.rate
        out.overruns, out.skipped_periods = rate.overruns, rate.skipped_periods
        out.limited_cycles = bench.limited_cycles
        return self.record

    def _read_manipulator(self, manipulator: MovesTarget) -> None:
        """Write the axes of the chaser's rig in the lab and relative to the target."""
        bench, out, target = self._runner.loop.bench, self._view, manipulator.feedback
        rails, turntable = bench.feedback
        write_axes(rails.position, rails.rate, turntable.position, turntable.rate, out.feedback)
        out.relative.rail_m, out.relative.gimbal_rad = relative_axes(
            bench.params, manipulator.params, rails.position, turntable.position, target.position
        )

    def _age_of_frames(self, now_s: float) -> float:
        frames = self._runner.source.counters().get("frames", 0)
        if frames != self._frames:
            self._frame_s = now_s if self._frames >= 0 else math.nan
            self._frames = self._view.frames = frames
        return now_s - self._frame_s

    def _read_safety_io(self, now_s: float) -> None:
        lines = self._runner.loop.safety_io
        if isinstance(lines, SafetyIoStage):
            with suppress(BenchError):  # the cycle raises the alarm
                inputs = lines.io.read(now_s)
                self._view.estop = 0 if inputs.estop_closed else 1
                self._view.age_s[3] = now_s - inputs.t_s


def status_of(record: np.ndarray) -> np.record:
    """Return STATUS (1,) as a record with attributes."""
    view: np.record = record.view(np.recarray)[0]
    return view


def empty_status() -> np.ndarray:
    """Return an empty STATUS (1,)."""
    return np.zeros(1, STATUS)
