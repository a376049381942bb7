"""Result of a run in memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.core.alarms import Alarm
from hil.core.messages import Event
from hil.core.modes import Mode
from hil.core.realtime import Grant
from hil.core.sensor_records import SENSOR_ARRIVAL


@dataclass(slots=True)
class Outcome:
    """Result of a run: ``history`` (n,) of CYCLE, reason of its end, and counters."""

    history: np.ndarray
    stop: str
    faults: list[str] = field(default_factory=list)
    mode: Mode = Mode.OFF
    overruns: int = 0
    skipped_periods: int = 0
    privileges: list[Grant] = field(default_factory=list)
    limited_cycles: int = 0
    vision_counters: dict[str, int] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    alarms: list[Alarm] = field(default_factory=list)
    measured: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Numbers that the rows do not have, by the table of the JSON that they belong to."""
    sensor_arrivals: np.ndarray = field(default_factory=lambda: np.zeros(0, SENSOR_ARRIVAL))
    """Samples of further sensors, (n,)."""
