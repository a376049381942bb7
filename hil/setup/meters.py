"""What is measured over a run in addition to its rows: true axes, clocks, exchanges with the drives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hil.bench.field_of_view import camera_errors
from hil.bench.manipulator import relative_axes
from hil.config.rig import Rig
from hil.config.tables.bench_scale import FULL_SCALE, BenchScale
from hil.config.tables.host import ClockConfig
from hil.core.kernel_record import kernel_record
from hil.core.messages import CYCLE
from hil.drivers.base import AxisGroup, CountsExchanges
from hil.drivers.ptp import read_status
from hil.drivers.shared_state import SharedAxisState
from hil.errors import DeviceError
from hil.frmn.ring import Telemetry
from hil.params import bench as bench_params
from hil.sensors.vision_unit import parameters as vmu_params


class TrueAxesWatch:
    """Telemetry that also compares, in each cycle, the emulated axes with the truth that they are to show.

    rows: receives the rows. now_s: bench time. step_s: period of the cycle.
    """

    def __init__(
        self,
        rows: Telemetry,
        board: SharedAxisState,
        rig: Rig,
        now_s: Callable[[], float],
        step_s: float,
        shown: BenchScale = FULL_SCALE,
    ) -> None:
        self._rows, self._board, self._now_s = rows, board, now_s
        self._bench = kernel_record(bench_params.bench(rig, step_s, shown))
        self._mounting = kernel_record(vmu_params.mounting(rig))
        self._manipulator = bench_params.manipulator(rig)
        self._errors = np.zeros(1), np.zeros(1)
        self._n, self._squares, self._largest = 0, np.zeros(2), np.zeros(2)
        self._compare(np.zeros(1, CYCLE), 0.0)  # compiles the kernel outside the cycle

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


class ClockWatch:
    """Reads PTP now, and again for ``numbers``. Bench time is the monotonic clock, which no step of the time moves."""

    def __init__(self, config: ClockConfig) -> None:
        self._config = config
        self._begin = self._ptp()
        self._system_ns = _system_ns()

    def numbers(self) -> dict[str, Any]:
        """Return the table ``clocks`` of the JSON."""
        return {
            "ptp": {"begin": self._begin, "end": self._ptp(), "max_offset_us": self._config.ptp_max_offset_us},
            "system_step_us": (_system_ns() - self._system_ns) * 1e-3,
        }

    def _ptp(self) -> dict[str, Any] | None:
        """Return the state of PTP, None without it."""
        try:
            return read_status(self._config.ptp_socket, self._config.ptp_domain).as_json()
        except DeviceError:
            return None


def _system_ns() -> int:
    """Return the system's time less the monotonic clock, ns."""
    before = time.monotonic_ns()
    system = time.time_ns()
    return system - (before + time.monotonic_ns()) // 2


class ExchangeRates:
    """Telemetry that also counts the exchanges of ``devices``, from the first cycle of a run to its last.

    rows: receives the rows.
    """

    def __init__(self, rows: Telemetry, devices: Mapping[str, AxisGroup]) -> None:
        self._rows = rows
        self._devices = {name: device for name, device in devices.items() if isinstance(device, CountsExchanges)}
        self._first: dict[str, tuple[int, float]] = {}
        self._last: dict[str, tuple[int, float]] = {}

    def put(self, row: np.ndarray) -> None:
        """Pass ``row``, (1,) of CYCLE, on, and note the exchanges so far."""
        self._rows.put(row)
        self._last = {name: device.exchanges() for name, device in self._devices.items()}
        self._first = self._first or self._last

    def numbers(self) -> dict[str, float]:
        """Return the exchanges per second of bench time, Hz, by device; none of a run of one cycle."""
        rates = {}
        for name, (count, t_s) in self._last.items():
            count_before, before_s = self._first[name]
            if t_s > before_s:
                rates[name] = (count - count_before) / (t_s - before_s)
        return rates
