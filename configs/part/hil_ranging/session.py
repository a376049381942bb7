"""What a run does for the part: samples for its recording, numbers for its summary, a section for its report."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from hil.core.alarms import LOW, AlarmKind
from hil.core.fields import Field, record_dtype
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.loop.runner import Outcome, Runner
from hil.loop.session_parts import PartResult, SessionParts
from hil.report.section import Section
from hil.session.assembly import Job
from hil_ranging.table import Ranging

SAMPLE_FIELDS = (
    Field("t_s", "f8", (), "s", "", "time of the run"),
    Field("range_m", "f8", (), "m", "", "distance between chaser and target; nan beyond the longest one"),
)
SAMPLE = record_dtype(SAMPLE_FIELDS)
NEAR = AlarmKind("distance", "ranging", "H-18", "m", priority=LOW)
"""Quantity, device, hazard of docs/hazards.toml, SI unit of the numbers."""


@contextmanager
def attach(job: Job, parts: SessionParts) -> Iterator[None]:
    """Add the part to the session of ``job``, until the run has ended."""
    sampler = Sampler(job.scenario.value.table_of_part("ranging"), parts.sinks.get("ranging_samples", NoTelemetry()))
    parts.layers.append(sampler.over)
    parts.on_built.append(sampler.begin)
    parts.results.append(sampler.result)
    yield


class Sampler:
    """Layer between the loop and the recording. ``put`` is called in each cycle: it must be short and never wait."""

    def __init__(self, table: Ranging, out: Telemetry) -> None:
        self._table, self._out = table, out
        self._next_s = -math.inf
        self._row = np.zeros(1, SAMPLE)
        self._samples: list[tuple[float, float]] = []

    def begin(self, runner: Runner) -> None:
        """Take the safety monitor of the session, whose alarms console, report and summary show."""
        self._safety = runner.safety

    def over(self, rows: Telemetry) -> Telemetry:
        """Return this layer, which passes each row on to ``rows``."""
        self._rows = rows
        return self

    def put(self, row: np.ndarray) -> None:
        """Take a row of the cycle, (1,) of CYCLE."""
        self._rows.put(row)
        t_s = float(row["t_s"][0])
        if t_s < self._next_s - 1e-9:
            return
        self._next_s = t_s + 1.0 / self._table.rate_hz
        range_m = float(np.linalg.norm(row["truth"]["r_CT_H"][0]))
        self._row[0] = (t_s, range_m if range_m <= self._table.range_max_m else math.nan)
        self._samples.append(self._row[0].item())
        self._out.put(self._row)
        if range_m < self._table.alarm_below_m:  # further calls change nothing while the condition lasts
            self._safety.alarms.raise_condition(NEAR.alarm(t_s, "ranging", range_m, self._table.alarm_below_m))
        else:
            self._safety.alarms.return_to_normal("ranging", NEAR.quantity)

    def result(self, outcome: Outcome) -> PartResult:
        """Return the numbers of the summary, table ``ranging``, and the rows of the run."""
        rows = np.array(self._samples, SAMPLE)
        last_m = float(rows["range_m"][-1]) if len(rows) and math.isfinite(rows["range_m"][-1]) else None
        return PartResult("ranging", {"samples": len(rows), "last_range_m": last_m}, {"ranging_samples": rows})


def section(numbers: dict[str, Any]) -> Section:
    """Return the section of the report, for terminal and page."""
    last_m = "-" if numbers["last_range_m"] is None else f"{numbers['last_range_m']:.3f}"
    return Section("Ranging", (), ("samples", "last, m"), [(str(numbers["samples"]), last_m)])
