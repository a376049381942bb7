"""Execution times of the cycle and of each device's exchange, with their limits.

``cycle``: from the start of a cycle to its thruster command. ``rails``, ``turntable``: age of the encoders' sample that
the cycle used, with the rate of the exchanges. ``vmu``: from the exposure of a pose to its last byte. ``io``: from a
thruster command to the acknowledgement of its digital lines by the coupler.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from hil.config.rig import Rig
from hil.core.messages import Array
from hil.report.latency import percentiles
from hil.sensors.vision_unit import columns as vmu_columns

NAMES: Final = ("cycle", "rails", "turntable", "vmu", "io")
EXCHANGED: Final = ("rails", "turntable")
"""Those with an exchange of setpoints and feedback."""
_SAMPLE_PERIODS: Final = 2.0  # of the cycle: the limit of a sample's age, unless the rig file sets it
_STAMP_S: Final = 1e-3  # a command is stamped just after its lines were passed on


def execution_times_s(history: np.ndarray) -> dict[str, Array]:
    """Return the times in the rows (n,) of CYCLE, s of bench time, by what they are of."""
    begun_s = history["t_s"] + np.nan_to_num(history["lateness_s"])  # in lock-step it has none
    return {
        "cycle": history["commanded_s"] - begun_s,
        "rails": begun_s - history["sampled_s"][:, 0],
        "turntable": begun_s - history["sampled_s"][:, 1],
        "vmu": vmu_columns.travel_s(history),
        "io": _acknowledged_s(history),
    }


def _acknowledged_s(history: np.ndarray) -> Array:
    """Return a time for each command that changed a line and is known within the next two rows."""
    on, wire_s, commanded_s = history["command"]["on"], history["on_wire_s"], history["commanded_s"]
    k = 1 + np.flatnonzero((on[1:-2] != on[:-3]).any(axis=1)) if len(history) > 3 else np.empty(0, int)
    sent_s = commanded_s[k]
    next_s, later_s = wire_s[k + 1], wire_s[k + 2]
    found: Array = np.where(next_s >= sent_s - _STAMP_S, next_s, later_s) - sent_s
    return found[np.isfinite(found) & (found >= -_STAMP_S)]


def limits_s(rig: Rig, step_s: float) -> dict[str, float]:
    """Return the limit of each time, s: of the cycle its period, of a pose the time-out of its unit."""
    exchange_s = _SAMPLE_PERIODS * step_s if rig.host.exchange_max_s is None else rig.host.exchange_max_s
    return dict.fromkeys(NAMES, exchange_s) | {"cycle": step_s, "vmu": rig.vmu.timeout_s}


def judge_times(times_s: Mapping[str, Array], beyond: Mapping[str, int], rig: Rig, step_s: float) -> dict[str, Any]:
    """Return the table ``timing.devices`` of the JSON. beyond: number of times above their limits."""
    return {
        name: {f"{key}_ms": value for key, value in percentiles(1e3 * times_s[name]).items()}
        | {"limit_ms": 1e3 * limit_s, "beyond": beyond[name]}
        for name, limit_s in limits_s(rig, step_s).items()
    }


def with_exchanges(devices: Mapping[str, Any], rates_hz: Mapping[str, float]) -> dict[str, Any]:
    """Return ``judge_times`` with ``exchange_hz``, exchanges per second with the drives; None for devices in memory."""
    added = {name: {"exchange_hz": rates_hz.get(name)} for name in EXCHANGED}
    return {name: table | added.get(name, {}) for name, table in devices.items()}


def count_beyond(times_s: Mapping[str, Array], rig: Rig, step_s: float) -> dict[str, int]:
    """Return how many of the times are above their limits."""
    return {name: int(np.count_nonzero(times_s[name] > limit_s)) for name, limit_s in limits_s(rig, step_s).items()}
