"""What is measured over a run on wires in addition to its rows: clocks, exchanges with the drives."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from hil.config.tables.host import ClockConfig
from hil.drivers.base import AxisGroup, CountsExchanges
from hil.drivers.ptp import read_status
from hil.errors import DeviceError
from hil.frmn.ring import NoTelemetry, Telemetry


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
    start_ns = time.monotonic_ns()
    system = time.time_ns()
    return system - (start_ns + time.monotonic_ns()) // 2


class ExchangeRates:
    """Telemetry that also counts the exchanges of ``devices``, from the first cycle of a run to its last."""

    def __init__(self, devices: Mapping[str, AxisGroup]) -> None:
        self._rows: Telemetry = NoTelemetry()
        self._devices = {name: device for name, device in devices.items() if isinstance(device, CountsExchanges)}
        self._first: dict[str, tuple[int, float]] = {}
        self._last: dict[str, tuple[int, float]] = {}

    def over(self, rows: Telemetry) -> Telemetry:
        """Return this telemetry, which passes each row on to ``rows``."""
        self._rows = rows
        return self

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
