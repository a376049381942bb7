"""Stages of a cycle: dynamics simulation and vision.

A stage owns its parameters and its state; the records passed between stages belong to the cycle.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hil.core.kernel_record import kernel_record
from hil.core.messages import ARRIVAL, IMU_SAMPLE, MAX_POSES, POSE, Array, PoseFrame, new
from hil.drivers.base import Exposes, PoseSource
from hil.dynamics import imu as imu_kernels
from hil.dynamics import truth as truth_kernels
from hil.dynamics.imu_faults import IMU_MEMORY
from hil.dynamics.isolation import isolate
from hil.dynamics.truth import TRUTH_MEMORY
from hil.frmn.ring import Telemetry
from hil.loop.fault_stages import FrameFaults
from hil.maths.random_streams import NormalRows
from hil.models.mounting import chaser_pose

_NO_POSE = new(POSE)


class DssStage:
    """Dynamics simulation (DSS): truth and virtual IMU."""

    def __init__(self, params: np.record, field: Array, imu_params: np.record, imu_noise: NormalRows) -> None:
        self.params = kernel_record(params)
        self.field = field
        self.memory = kernel_record(new(TRUTH_MEMORY))
        """What the truth keeps from step to step."""
        self.imu_memory = kernel_record(new(IMU_MEMORY))
        """What the faults of the IMU keep from sample to sample."""
        self._imu_params = kernel_record(imu_params)
        self.noise = imu_noise
        """One row per sample."""
        self._rate = np.empty(3)
        self.sample_sink: Telemetry | None = None
        """Receives each sample of an IMU that is faster than the cycle, as a row of IMU_SAMPLE."""
        self._row = np.zeros(1, IMU_SAMPLE)

    def step(self, k: int, truth: np.record, command: np.record, imu: np.record, samples: np.ndarray) -> None:
        """Propagate ``truth`` over cycle ``k`` with the thrusters that ``command`` opens; write the IMU's samples.

        samples: (n,) of IMU, which the next cycle uses. imu: their mean.
        """
        n = len(samples)
        imu_kernels.propagate(
            self.params,
            self._imu_params,
            self.field,
            self.memory,
            truth,
            command.on,
            self.noise.next_rows(n),
            self.imu_memory,
            samples,
            imu,
        )
        self._send_samples(k, samples)

    def _send_samples(self, k: int, samples: np.ndarray) -> None:
        """Send the samples of cycle ``k`` to the sink."""
        n = len(samples)
        if self.sample_sink is None:
            return
        for i, sample in enumerate(samples):
            self._row["cycle"], self._row["t_s"] = k + 1, (k * n + i + 1) * float(self.params.dt_s)
            self._row["imu"] = sample
            self.sample_sink.put(self._row)

    def isolate(self, thrusters: np.ndarray | None) -> None:
        """Command the isolation valves of ``thrusters`` (n,), 0 or 1, to close; None: of no further ones."""
        if thrusters is not None:
            isolate(self.memory.isolation, thrusters)

    def rate_against_hill(self, truth: np.record) -> Array:
        """Return the chaser's rate relative to H, in c, (3,), rad/s; valid until the next call."""
        truth_kernels.rate_against_hill(truth, self._rate)
        return self._rate


class VisionStage:
    """Poses of the vision unit, transformed from the camera to the chaser."""

    def __init__(self, source: PoseSource, mounting: np.record) -> None:
        self.source = source
        self._simulated = source if isinstance(source, Exposes) else None
        self._mounting = mounting
        self.poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
        self._records = [self.poses[i] for i in range(MAX_POSES)]
        self.arrived = 0
        self.dropped = 0  # beyond MAX_POSES in one cycle
        self.not_before_s = -math.inf
        """Frames exposed before this bench time are stale and discarded."""
        self.faults: FrameFaults | None = None
        """Faults of the unit, if it has any: what follows sees only what they leave."""
        self.frame_sink: Telemetry | None = None
        """Receives each frame, as a row of ARRIVAL."""
        self.on_run_zero: Callable[[float], None] | None = None
        """Called with the bench time of the run's time zero when it changes; nan while the run's time stops."""
        self._run_zero_s: float | None = None
        self.on_frame_used: Callable[[PoseFrame, float], None] | None = None
        """Called with each used frame and its time of exposure in the run's time."""
        self._row = np.zeros(1, ARRIVAL)
        self.cycle = -1
        """Number of the last cycle, -1 before the first."""

    def receive(self, bench_s: float, run_zero_s: float, row: np.ndarray) -> None:
        """Write the frames received since the last cycle into ``poses``, the newest also into ``row["pose"]``.

        run_zero_s: bench time of the run's time zero.
        """
        self.set_run_zero(run_zero_s)
        received = self.source.poll(bench_s)
        if self.faults is not None:
            received = self.faults.pass_on(received, bench_s, run_zero_s)
        frames = received
        self.cycle += 1
        if frames:
            frames = [frame for frame in frames if frame.t_s >= self.not_before_s]
        self.dropped += max(0, len(frames) - MAX_POSES)
        self.arrived = min(len(frames), MAX_POSES)
        frames = frames[-MAX_POSES:]
        if self.frame_sink is not None:
            self._record_unused([frame for frame in received if not any(frame is used for used in frames)])
        if not frames:
            row["pose"]["fresh"] = 0
            return
        for frame, pose in zip(frames, self._records, strict=False):
            chaser_pose(self._mounting, frame.t_v, frame.q_vt, frame.covariance, pose)
            pose.t_s = frame.t_s - run_zero_s
            pose.status = frame.status
            if self.on_frame_used is not None:
                self.on_frame_used(frame, pose.t_s)
            if self.frame_sink is not None:
                self._record(frame, self.cycle, pose)
        newest = self.poses[: self.arrived]["t_s"].argmax()
        row["pose"] = self.poses[newest]
        row["pose"]["fresh"] = self.arrived
        row["received_s"] = frames[newest].received_s - run_zero_s

    def set_run_zero(self, run_zero_s: float | None) -> None:
        """Report a changed bench time of the run's time zero to ``on_run_zero``; None: the run's time stops."""
        if run_zero_s == self._run_zero_s:
            return
        self._run_zero_s = run_zero_s
        if self.on_run_zero is not None:
            self.on_run_zero(math.nan if run_zero_s is None else run_zero_s)

    def expose(self, bench_s: float) -> None:
        """Let a simulated unit expose up to ``bench_s``, between two cycles."""
        if self._simulated is not None:
            self._simulated.expose(bench_s)

    def discard_pending(self, bench_s: float) -> int:
        """Discard the frames received since the last cycle; return their number."""
        self.set_run_zero(None)
        frames = self.source.poll(bench_s)
        if self.faults is not None:
            self.faults.delayed = []
        if self.frame_sink is not None:
            self._record_unused(frames)
        return len(frames)

    def _record_unused(self, frames: list[PoseFrame]) -> None:
        for frame in frames:
            self._record(frame, -1, _NO_POSE)

    def _record(self, frame: PoseFrame, cycle: int, pose: np.record) -> None:
        """Send ``frame`` to the sink with the number of the cycle that uses it and the pose passed to navigation."""
        assert self.frame_sink is not None
        self._row["cycle"] = cycle
        frame.write_to(self._row["frame"])
        self._row["pose"] = pose
        self.frame_sink.put(self._row)
