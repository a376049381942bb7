"""State of the computer's clocks over a run: PTP at its begin and end, and steps of the system's time."""

from __future__ import annotations

import time
from typing import Any

from hil.config.clock import ClockConfig
from hil.drivers.ptp import read_status
from hil.errors import DeviceError


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
