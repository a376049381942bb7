"""Faults that act between devices and cycle: of the vision unit's frames, and of axes in memory."""

from __future__ import annotations

import heapq
import itertools

import numpy as np

from hil.core.messages import VMU_FRAME, PoseFrame, new
from hil.dynamics.vision_faults import VMU_MEMORY, disturb_frame, see_through_plume
from hil.models.axis_faults import NOMINAL_AXES, set_axis_faults
from hil.models.camera_timing import TIME_SLACK_S


class FrameFaults:
    """Faults of the vision unit, applied to its frames in the order of their arrival.

    faults: FAULTS. mounting: MOUNTING. plume: PLUME_PARAMS, plume_memory: PLUME_MEMORY, as the truth keeps it.
    """

    def __init__(self, faults: np.record, mounting: np.record, plume: np.record, plume_memory: np.record) -> None:
        self.faults = faults
        self._mounting = mounting
        self._plume, self._plume_memory = plume, plume_memory
        self._dims = bool(plume.dimming > 0.0)
        self.memory = new(VMU_MEMORY)
        """VMU_MEMORY: the last frame."""
        self._row = np.zeros(1, VMU_FRAME)
        self._record = self._row.view(np.recarray)[0]
        self._delayed: list[tuple[float, int, int, PoseFrame]] = []
        self._number = itertools.count()

    @property
    def delayed(self) -> list[PoseFrame]:
        """Frames that have been received and not yet passed on."""
        return [frame for *_, frame in self._delayed]

    @delayed.setter
    def delayed(self, frames: list[PoseFrame]) -> None:
        self._delayed = []
        for frame in frames:
            self._put(frame)

    def pass_on(self, frames: list[PoseFrame], bench_s: float, run_zero_s: float) -> list[PoseFrame]:
        """Return the frames that the loop receives by ``bench_s``, with ``frames``, which the unit has just sent."""
        for frame in frames:
            frame.write_to(self._row)
            if self._dims and not see_through_plume(
                self._plume, self._plume_memory, self.faults.seed, run_zero_s, self._record
            ):
                continue
            if disturb_frame(self.faults, self._mounting, run_zero_s, self.memory, self._record):
                self._put(PoseFrame.from_record(self._record))
        due = []
        while self._delayed and self._delayed[0][0] <= bench_s + TIME_SLACK_S:
            due.append(heapq.heappop(self._delayed)[-1])
        return due

    def _put(self, frame: PoseFrame) -> None:
        heapq.heappush(self._delayed, (frame.received_s, frame.counter, next(self._number), frame))


class AxisFaults:
    """Faults of rails and turntable in memory, terms of their servos.

    faults: FAULTS. rails, turntable: SERVO.
    """

    def __init__(self, faults: np.record, rails: np.record, turntable: np.record) -> None:
        self.faults = faults
        self._axes = rails, turntable
        self.nominal = new(NOMINAL_AXES)
        """NOMINAL_AXES: what the end of a fault restores."""
        self.nominal.rate_max = np.concatenate([rails.rate_max, turntable.rate_max])

    def act(self, t_s: float) -> None:
        """Apply the faults that act at ``t_s`` of the run."""
        set_axis_faults(self.faults, self.nominal, t_s, *self._axes)
