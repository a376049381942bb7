"""Stages of a cycle: dynamics simulation and vision.

A stage connects calls of the core with devices, streams of random numbers and sinks; the records are the core's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hil.core.messages import ARRIVAL, IMU_SAMPLE, Array, PoseFrame
from hil.drivers.base import Exposes, PoseSource
from hil.frmn.ring import Telemetry
from hil.loop import core
from hil.loop.bench_gyros import BenchGyros
from hil.loop.core_memory import CoreMemory
from hil.maths.random_streams import NormalRows

_NO_ARRIVALS = np.zeros(0, ARRIVAL).view(np.recarray)


class DssStage:
    """Dynamics simulation (DSS): truth and virtual IMU. imu_noise: one row per sample.

    sample_sink: receives each sample of an IMU that is faster than the cycle, as a row of IMU_SAMPLE. gyros: of the
    bench, which the cycle reads in place of the virtual ones.
    """

    def __init__(
        self,
        memory: CoreMemory,
        field: Array,
        imu_noise: NormalRows,
        sample_sink: Telemetry | None = None,
        gyros: BenchGyros | None = None,
    ) -> None:
        self._params, self._state, self._samples = memory.params, memory.state, memory.now.samples
        self.field = field
        self.noise = imu_noise
        self.sample_sink = sample_sink
        self.gyros = gyros
        self._row = np.zeros(1, IMU_SAMPLE)

    def step(self, k: int) -> None:
        """Propagate the truth over cycle ``k``; write the IMU's samples and the axes for the pose at its end."""
        samples = self._samples
        core.advance(self._params, self._state, self.field, self.noise.next_rows(len(samples)), samples)
        self._send_samples(k)

    def close(self) -> None:
        """Release the wire of the gyros."""
        if self.gyros is not None:
            self.gyros.close()

    def _send_samples(self, k: int) -> None:
        """Send the samples of cycle ``k`` to the sink."""
        if self.sample_sink is None:
            return
        n = len(self._samples)
        for i, sample in enumerate(self._samples):
            self._row["cycle"], self._row["t_s"] = k + 1, (k * n + i + 1) * float(self._params.dss.dt_s)
            self._row["imu"] = sample
            self.sample_sink.put(self._row)


class RunZero:
    """Bench time of the run's time zero, for those who follow the run in another process.

    on_change: called with it when it changes; nan while the run's time stops.
    """

    def __init__(self, on_change: Sequence[Callable[[float], None]] = ()) -> None:
        self._on_change = tuple(on_change)
        self._run_zero_s = math.nan

    def set(self, run_zero_s: float) -> None:
        """Report it if it has changed; nan: the run's time stops."""
        if run_zero_s == self._run_zero_s or (math.isnan(run_zero_s) and math.isnan(self._run_zero_s)):
            return
        self._run_zero_s = run_zero_s
        for receive in self._on_change:
            receive(run_zero_s)


FrameUsed = Callable[[PoseFrame, float], None]
"""Called with each used frame and its time of exposure in the run's time."""


class VisionStage:
    """Frames of the vision unit on their way to the poses of the cycle.

    frame_sink: receives each frame, as a row of ARRIVAL.
    """

    def __init__(
        self,
        source: PoseSource,
        memory: CoreMemory,
        on_frame_used: FrameUsed | None = None,
        frame_sink: Telemetry | None = None,
    ) -> None:
        self.source = source
        self._simulated = source if isinstance(source, Exposes) else None
        self._memory, self._params, self._state = memory, memory.params, memory.state
        self._reception = memory.view("vmu")
        self.poses = memory.poses
        self.arrived = 0
        """Poses of the present cycle."""
        self.frame_sink = frame_sink
        self._on_frame_used = on_frame_used
        self._frames = np.zeros(len(memory.frames), memory.frames.dtype).view(np.recarray)

    def receive(self, bench_s: float) -> None:
        """Write the frames received since the last cycle into ``poses``, the newest also into the present row."""
        received = self.source.poll(bench_s)
        waiting = self._make_room(len(received))
        for i, frame in enumerate(received):
            frame.write_to(self._frames[i : i + 1])
        arrivals = _NO_ARRIVALS
        if waiting and (self.frame_sink is not None or self._on_frame_used is not None):
            arrivals = np.zeros(waiting, ARRIVAL).view(np.recarray)
            self._reception.logged = 0
        self.arrived = core.receive_poses(
            self._params, self._state, bench_s, self._frames, len(received), self._memory.delayed, self.poses, arrivals
        )
        if len(arrivals):
            self._tell(arrivals[: self._reception.logged])

    def _make_room(self, n: int) -> int:
        """Enlarge the arrays for ``n`` further frames; return how many frames the cycle may receive."""
        waiting = n + int(self._reception.delayed)
        if n > len(self._frames):
            self._frames = np.resize(self._frames, 2 * n).view(np.recarray)
        if waiting > len(self._memory.delayed):
            self._memory.delayed = np.resize(self._memory.delayed, 2 * waiting).view(np.recarray)
        return waiting

    def _tell(self, arrivals: np.ndarray) -> None:
        """Report the frames of this cycle."""
        for i, arrival in enumerate(arrivals):
            if self._on_frame_used is not None and arrival["cycle"] >= 0:
                self._on_frame_used(PoseFrame.from_record(arrival["frame"]), float(arrival["pose"]["t_s"]))
            if self.frame_sink is not None:
                self.frame_sink.put(arrivals[i : i + 1])

    @property
    def not_before_s(self) -> float:
        """Frames exposed before this bench time are stale and discarded."""
        return float(self._reception.not_before_s)

    @not_before_s.setter
    def not_before_s(self, bench_s: float) -> None:
        self._reception.not_before_s = bench_s

    def expose(self, bench_s: float) -> None:
        """Let a simulated unit expose up to ``bench_s``, between two cycles."""
        if self._simulated is not None:
            self._simulated.expose(bench_s)

    def discard_pending(self, bench_s: float) -> int:
        """Discard the frames received since the last cycle; return their number."""
        frames = self.source.poll(bench_s)
        self._reception.delayed = 0
        if self.frame_sink is not None:
            for frame in frames:
                row = np.zeros(1, ARRIVAL)
                row["cycle"] = -1
                frame.write_to(row["frame"])
                self.frame_sink.put(row)
        return len(frames)
