"""Bench guard as a stage of the cycle."""

from __future__ import annotations

import math

import numpy as np

from hil.bench.bench_guard import BENCH_GUARD_MEMORY, check_bench, compare_pose
from hil.bench.guard import BREACH, NOTHING
from hil.core.kernel_record import kernel_record
from hil.core.messages import new
from hil.loop.bench_stage import BenchStage
from hil.loop.stages import VisionStage
from hil.safety.guard_alarms import guard_alarm


class GuardStage:
    """Bench guard: checks that hold for any GNC. params: BENCH_GUARD_PARAMS."""

    def __init__(self, params: np.record, bench: BenchStage) -> None:
        self.params = kernel_record(params)
        self._bench = bench
        self.memory = kernel_record(new(BENCH_GUARD_MEMORY))
        self._breach = kernel_record(new(BREACH))

    def check(self, bench_s: float, run_zero_s: float, truth: np.record, feedback: np.record) -> None:
        """Check the cycle at ``bench_s`` of bench time; raise SafetyTrip if a limit is violated.

        run_zero_s: bench time of the run's time zero. truth: TRUTH. feedback: AXES of the last reading of the encoders.
        """
        bench = self._bench
        self.restart_with_motion()
        rails, turntable = bench.feedback
        code = check_bench(
            self.params, bench.params, self.memory, bench_s - run_zero_s, truth, bench.wanted, feedback,
            bench_s - rails.t_s, bench_s - turntable.t_s, bench.limited_in_row, self._breach,
        )  # fmt: skip
        if code != NOTHING:
            raise guard_alarm(bench_s, bench.axis_names, int(code), self._breach).trip()

    def compare(self, vision: VisionStage) -> None:
        """Compare the poses of this cycle with the encoders; ``check`` of the next cycle reports them."""
        for i in range(vision.arrived):
            compare_pose(self.params, self._bench.params, self.memory, vision.poses[i])

    def restart_with_motion(self) -> None:
        """Forget the cycles before, if no setpoint was sent since the start of the motion."""
        if math.isnan(self._bench.commanded_s):
            np.asarray(self.memory)[...] = np.zeros((), BENCH_GUARD_MEMORY)
