"""True axes of an emulated rig over a run, against the truth that they are to show."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hil.bench.field_of_view import camera_errors
from hil.bench.manipulator import relative_axes
from hil.config.rig import Rig
from hil.config.tables.bench_scale import FULL_SCALE, BenchScale
from hil.core.kernel_record import kernel_record
from hil.core.messages import CYCLE
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.params import bench as bench_params
from hil.parts.emulation.shared_state import SharedAxisState
from hil.sensors.vision_unit import parameters as vmu_params


class TrueAxesWatch:
    """Telemetry that also compares, in each cycle, the emulated axes with the truth that they are to show.

    now_s: bench time. step_s: period of the cycle.
    """

    def __init__(
        self,
        board: SharedAxisState,
        rig: Rig,
        now_s: Callable[[], float],
        step_s: float,
        shown: BenchScale = FULL_SCALE,
    ) -> None:
        self._rows: Telemetry = NoTelemetry()
        self._board, self._now_s = board, now_s
        self._bench = kernel_record(bench_params.bench_as_built(rig, step_s, shown))
        self._mounting = kernel_record(vmu_params.mounting(rig))
        self._manipulator = bench_params.manipulator(rig)
        self._errors = np.zeros(1), np.zeros(1)
        self._n, self._squares, self._largest = 0, np.zeros(2), np.zeros(2)
        self._compare(np.zeros(1, CYCLE), 0.0)  # compiles the kernel outside the cycle

    def over(self, rows: Telemetry) -> Telemetry:
        """Return this telemetry, which passes each row on to ``rows``."""
        self._rows = rows
        return self

    def put(self, row: np.ndarray) -> None:
        """Pass ``row``, (1,) of CYCLE, on, and compare the axes at its time with its truth."""
        run_zero_s = self._now_s() - float(row["commanded_s"][0])  # the command was stamped just before
        self._rows.put(row)
        self._compare(row, run_zero_s + float(row["t_s"][0]))
        errors = np.concatenate(self._errors)
        self._n += 1
        self._squares += errors * errors
        np.maximum(self._largest, errors, out=self._largest)

    def numbers(self) -> dict[str, Any]:
        """Return rms and largest error, for the table ``bench`` of the JSON."""
        rms = np.sqrt(self._squares / max(1, self._n))
        return {
            f"true_pose_error_{unit}": {"rms": scale * float(rms[i]), "max": scale * float(self._largest[i])}
            for i, (unit, scale) in enumerate((("mm", 1e3), ("deg", math.degrees(1.0))))
        }

    def _compare(self, row: np.ndarray, bench_s: float) -> None:
        rails, gimbals, target = (self._board.read(device, bench_s)[0] for device in ("rails", "turntable", "target"))
        rails, gimbals = relative_axes(self._bench, self._manipulator, rails, gimbals, target)
        truth = row["truth"]
        camera_errors(
            self._bench, self._mounting, rails[None], gimbals[None], truth["r_CT_H"], truth["q_CH"], *self._errors
        )
