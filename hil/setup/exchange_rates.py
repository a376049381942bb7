"""Rate at which the drives of each axis group were exchanged with during a run."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.drivers.base import AxisGroup, CountsExchanges
from hil.frmn.ring import Telemetry


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
