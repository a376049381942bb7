"""One control cycle. The place to start reading: each line is a stage of bench paper Fig. 2.

thrusters on/off -> truth (DSS) -> rails and turntable -> cameras (VMU) -> AKF, PKF -> control
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hil.core.messages import CYCLE
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.gnc_backends.base import GncBackend
from hil.loop.bench_stage import BenchStage
from hil.loop.safety_io_stage import NoSafetyIo, SafetyIo
from hil.loop.stages import DssStage, VisionStage
from hil.loop.target_stage import FixedTarget, TargetStage


class CycleData:
    """The records of the present cycle: views into one row of CYCLE, which is what gets recorded."""

    def __init__(self) -> None:
        self.row = np.zeros(1, CYCLE)
        records = self.row.view(np.recarray)
        for name in CYCLE.names or ():
            setattr(self, name, records[name][0] if CYCLE[name].names else self.row[name])

    # one number each, arrays of shape (1,): writing into an array is cheaper than into a record
    t_s: np.ndarray
    sampled_s: np.ndarray  # (1, 2)
    received_s: np.ndarray
    commanded_s: np.ndarray
    on_wire_s: np.ndarray
    lateness_s: np.ndarray
    nees_position: np.ndarray
    nees_attitude: np.ndarray

    truth: np.record
    imu: np.record
    pose: np.record
    navigation: np.record
    reference: np.record
    supervision: np.record
    command: np.record
    setpoint: np.record
    feedback: np.record


@dataclass(slots=True)
class Loop:
    """The stages, the records between them, and where each cycle is written to: history and telemetry."""

    dss: DssStage
    bench: BenchStage
    vision: VisionStage
    gnc: GncBackend
    history: np.ndarray
    bench_now_s: Callable[[], float]
    """Bench time, for the stamp of the thrusters' command."""
    telemetry: Telemetry = field(default_factory=NoTelemetry)
    safety_io: SafetyIo = field(default_factory=NoSafetyIo)
    target: TargetStage = field(default_factory=FixedTarget)
    now: CycleData = field(default_factory=CycleData)
    _row: memoryview = field(init=False)
    _pages: memoryview = field(init=False)

    def __post_init__(self) -> None:
        self._row = self.now.row.view(np.uint8).data
        self._pages = self.history.view(np.uint8).data

    def record(self, k: int) -> None:
        """Write down the present row as that of cycle ``k``, byte by byte: a structured copy costs five times that."""
        self._pages[k * CYCLE.itemsize : (k + 1) * CYCLE.itemsize] = self._row
        self.telemetry.put(self.now.row)


def run_cycle(loop: Loop, k: int, t_s: float, bench_s: float, run_zero_s: float, lateness_s: float) -> None:
    """Run cycle ``k`` at ``t_s`` of the run, ``bench_s`` of bench time; raises BenchError.

    run_zero_s: bench time at which the run's time is zero. lateness_s: how late this cycle woke up.
    """
    now = loop.now
    loop.safety_io.check(bench_s)  # 0  emergency stop and safety chain
    loop.bench.read(bench_s, now.feedback)  # 1  encoders
    loop.bench.check(bench_s, now.feedback)  # 2  may the bench go on?
    loop.target.check(bench_s)  # does the target stay where it was placed?
    loop.vision.receive(bench_s, run_zero_s, now.row[0])  # 3  poses of the vision unit
    loop.gnc.act(t_s, now, loop.vision)  # 4-7  navigation, guidance, supervision, control: thrusters on or off
    loop.safety_io.mirror(bench_s)  # the same on digital lines
    now.commanded_s[0] = loop.bench_now_s() - run_zero_s
    now.on_wire_s[0] = loop.safety_io.thrusters_s - run_zero_s
    now.sampled_s[0, 0], now.sampled_s[0, 1] = loop.bench.sampled_s(run_zero_s)
    now.t_s[0], now.lateness_s[0] = t_s, lateness_s
    now.nees_position[0], now.nees_attitude[0] = loop.gnc.consistency(now.truth, now.imu)
    loop.record(k)  # 8  what was known and done at t_s
    loop.dss.step(now.truth, now.command)  # 9  truth one step on
    loop.dss.sample_imu(now.truth, now.imu)  # 10 virtual IMU over that step
    loop.bench.follow(now.truth, loop.dss.rate_against_hill(now.truth), bench_s, now.setpoint)  # 11 motion
