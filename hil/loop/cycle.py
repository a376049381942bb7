"""One control cycle: the numbered lines of ``run_cycle`` are the stages of bench paper Fig. 2. Start reading there.

cameras (VMU) -> AKF, PKF -> control -> thrusters on/off -> truth (DSS) -> rails and turntable -> cameras (VMU)

A cycle begins with what the bench measures; truth and setpoints of the next one come last.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from hil.core.messages import AXES_SAMPLE, CYCLE
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.gnc_backends.base import GncBackend
from hil.loop import core
from hil.loop.bench_stage import BenchStage
from hil.loop.core_memory import CoreMemory, CycleData
from hil.loop.rate_keeper import Tick
from hil.loop.safety_io_stage import SafetyIo
from hil.loop.sensor_stage import SensorStage
from hil.loop.stages import DssStage, RunZero, VisionStage
from hil.loop.target_stage import AxesTogether
from hil.safety.condition_alarms import HealthAlarms


@dataclass(slots=True)
class Loop:
    """Stages of the cycle, the records passed between them, and the recording: history and telemetry."""

    memory: CoreMemory
    """What the calls of the core read and write."""
    dss: DssStage
    bench: BenchStage
    vision: VisionStage
    gnc: GncBackend
    history: np.ndarray
    """Rows of the run, (n,) of CYCLE: all of them, or those of the part since ``first``."""
    bench_now_s: Callable[[], float]
    """Bench time, to stamp the thruster command."""
    health_alarms: HealthAlarms
    """Alarms of the consistency monitors."""
    telemetry: Telemetry = field(default_factory=NoTelemetry)
    safety_io: SafetyIo = field(default_factory=SafetyIo)
    target: AxesTogether = field(default_factory=AxesTogether)
    run_zero: RunZero = field(default_factory=RunZero)
    axis_faults: Callable[[float], None] | None = None
    """Applies the faults of axes in memory that act at a time of the run; None if there are none."""
    sensors: SensorStage | None = None
    """Sensors other than vision unit and IMU; None without any."""
    now: CycleData = field(init=False)
    """Row of the cycle under way: until a stage writes a field, it has the value of the cycle before."""
    done: int = 0
    """Completed cycles of the run."""
    first: int = 0
    """Number of the cycle in the first row of ``history``."""
    on_full: Callable[[np.ndarray], np.ndarray] | None = None
    """Receives the rows when no further one fits; returns the memory for the next ones."""
    axes_sink: Telemetry | None = None
    """Receives each setpoint of axes that are faster than the cycle, as a row of AXES_SAMPLE."""
    _axes: np.ndarray = field(default_factory=lambda: np.zeros(1, AXES_SAMPLE))
    _row: memoryview = field(init=False)
    _history_bytes: memoryview = field(init=False)

    def __post_init__(self) -> None:
        self.now = self.memory.now
        self._row = self.now.row.view(np.uint8).data
        self._history_bytes = self.history.view(np.uint8).data

    def record(self, k: int) -> None:
        """Copy the present row into the history as cycle ``k``, as bytes: a structured copy takes five times longer."""
        self.make_room(k)
        start = (k - self.first) * CYCLE.itemsize
        self._history_bytes[start : start + CYCLE.itemsize] = self._row
        self.telemetry.put(self.now.row)

    def make_room(self, k: int) -> None:
        """Hand the rows over and start again if cycle ``k`` does not fit."""
        if k - self.first < len(self.history):
            return
        if self.on_full is not None:
            self.history = self.on_full(self.history)
            self._history_bytes = self.history.view(np.uint8).data
        self.first = k

    def discard_frames(self, bench_s: float) -> int:
        """Stop the run's time, and discard the frames received since the last cycle; return their number."""
        self.run_zero.set(math.nan)
        return self.vision.discard_pending(bench_s)

    def rows(self) -> np.ndarray:
        """Return the rows since ``first``."""
        return self.history[: self.done - self.first]

    def record_axes(self, t_s: float, run_zero_s: float, lateness_s: float) -> None:
        """Send the setpoint of this tick and the encoders read before it to the sink."""
        if self.axes_sink is None:
            return
        row = self._axes
        row["t_s"], row["lateness_s"], row["sampled_s"] = t_s, lateness_s, self.bench.sampled_s(run_zero_s)
        row["setpoint"], row["feedback"] = self.now.row["setpoint"], self.now.row["feedback"]
        self.axes_sink.put(row)


def run_cycle(loop: Loop, k: int, t_s: float, bench_s: float, run_zero_s: float, lateness_s: float) -> None:
    """Run cycle ``k`` at ``t_s`` of the run, ``bench_s`` of bench time; raises BenchError: it is not recorded then.

    run_zero_s: bench time of the run's time zero. lateness_s: wake-up delay of this cycle.
    """
    now, memory = loop.now, loop.memory
    params, state = memory.params, memory.state
    state.cycle, state.zero_s = k, run_zero_s
    loop.run_zero.set(run_zero_s)
    if loop.axis_faults is not None:
        loop.axis_faults(t_s)
    loop.safety_io.check(bench_s)  # 0  emergency stop and safety chain
    loop.bench.read(bench_s)  # 1  encoders
    loop.bench.check(bench_s)  # 2  safety monitor: continue or stop
    loop.target.check(bench_s)  #    target at its commanded place
    loop.target.relate(now.feedback)  #    axes of the chaser relative to those of the target
    loop.bench.guard(bench_s, run_zero_s)  #    bench guard
    loop.gnc.set_bench_check(now.bench_off[0], now.bench_breach[0], bool(state.gnc.approach.bench_disagrees))
    loop.vision.receive(bench_s)  # 3  poses from the vision unit
    if loop.dss.gyros is not None:
        loop.dss.gyros.measure()  #    those of the table, over the cycle that has just ended
    if loop.sensors is not None:
        loop.sensors.receive(t_s, bench_s, run_zero_s, loop.gnc)  #    further sensors, witnesses against navigation
    loop.gnc.step(t_s, now, loop.vision)  # 4-7  navigation, guidance, approach monitor, control
    if loop.sensors is not None:
        loop.sensors.record(k)
    loop.safety_io.mirror_thrusters(bench_s)  #    thruster commands on digital lines
    now.commanded_s[0] = loop.bench_now_s() - run_zero_s
    now.on_wire_s[0] = loop.safety_io.thrusters_s - run_zero_s
    core.isolate_thrusters(params, state)
    now.nees_position[0], now.nees_attitude[0] = loop.gnc.consistency(now.truth, now.imu)
    now.t_s[0], now.lateness_s[0] = t_s, lateness_s
    loop.health_alarms.update(bench_s, int(now.navigation.health))
    loop.record(k)  # 8  record of the cycle at t_s
    loop.target.record(t_s, run_zero_s, loop.bench)
    loop.dss.step(k)  # 9, 10 truth over this cycle, virtual IMU; axes for the pose at its end
    loop.bench.follow(bench_s)  # 11 setpoints for rails and turntable
    loop.record_axes(bench_s - run_zero_s, run_zero_s, lateness_s)


def run_tick(loop: Loop, bench_s: float, run_zero_s: float, lateness_s: float) -> None:
    """Run a tick between two cycles, of axes that are faster: their checks and their next setpoint; raises BenchError.

    Arguments: see ``run_cycle``.
    """
    loop.safety_io.check(bench_s)  # 0
    loop.bench.read(bench_s)  # 1
    loop.bench.check(bench_s)  # 2
    loop.vision.expose(bench_s)
    loop.bench.follow_on(bench_s)  # 11
    loop.record_axes(bench_s - run_zero_s, run_zero_s, lateness_s)


class Cycles(Protocol):
    """Runs the cycles of a closed loop: one at a time in Python, or blocks of compiled ones."""

    def advance(self, held_s: float) -> Tick:
        """Run the next cycle of the run, or several; return the last one's tick. Raises BenchError.

        held_s: time by which holds have delayed the run. Counts the cycles in ``Loop.done``.
        """


class PythonCycles:
    """Runs one cycle of ``loop`` at a time. wait: waits for the next tick. step_s: period of the cycle."""

    def __init__(self, loop: Loop, wait: Callable[[], Tick], step_s: float) -> None:
        self._loop = loop
        self._wait = wait
        self._step_s = step_s

    def advance(self, held_s: float) -> Tick:
        """Run the ticks left of the last cycle, and the next cycle."""
        tick = self._wait()
        while self._loop.bench.tick:
            run_tick(self._loop, tick.now_s, tick.run_zero_s + held_s, tick.lateness_s)
            tick = self._wait()
        k = self._loop.done
        run_cycle(self._loop, k, k * self._step_s, tick.now_s, tick.run_zero_s + held_s, tick.lateness_s)
        self._loop.done = k + 1
        return tick


CyclesOf = Callable[[Loop, Cycles], Cycles]
"""Returns what runs the cycles of a loop: by itself, or by the cycle in Python that it is given."""
