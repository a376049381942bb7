"""What the rows of a run give: the tables of its JSON that are counted, and the verdict.

The rows are counted in blocks of a fixed length, one after the other. So a recording, a run whose rows are in memory,
and one whose rows are handed over in parts give the same bytes, in memory that does not grow.
"""

from __future__ import annotations

import time
from typing import Any, Final

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.kernel_record import kernel_record
from hil.loop.compiled import run_stats
from hil.loop.overrun_monitor import lateness_histogram, lateness_percentiles_us
from hil.params.held_back import HeldBack
from hil.params.ready import SETTLED_S
from hil.report.bench_error import BenchErrorSums
from hil.report.latency import LATENCIES, NAMES, count_beyond, execution_times_s, judge_times, measured, percentiles
from hil.report.navigation_bound import NavigationBound
from hil.report.results import (
    BenchResults,
    Latency,
    LatenessResults,
    NavigationResults,
    Percentiles,
    RunResults,
    Timing,
    VerdictParts,
)
from hil.report.sums import Squares, ThinnedSample
from hil.report.verdict import Verdict, control_precision, verdict_of
from hil.report.verdict_parts import (
    AbortCourse,
    FieldOfView,
    energy_part,
    navigation_numbers,
    security_part,
    thruster_numbers,
)

_BLOCK_S: Final = 20.0
"""Of the run: what is fitted to windows (``latency``) finds whole ones in a block."""
_ROWS_MAX: Final = 2048


Tallied = tuple[RunResults, np.record, Verdict]
"""Results that the rows give, RUN_STATS, and the verdict."""


class Tally:
    """Counts the rows of a run of ``scenario`` on ``rig``, which are added in order.

    pause_s: wall time between two blocks, for a loop that runs meanwhile in real time.
    """

    def __init__(self, scenario: Scenario, rig: Rig, pause_s: float = 0.0) -> None:
        self._scenario, self._rig, self.pause_s = scenario, rig, pause_s
        self._block = max(2, min(_ROWS_MAX, round(_BLOCK_S / scenario.step_s)))
        self._params = kernel_record(run_stats.run_stats_params(scenario, rig, SETTLED_S))
        self.stats = run_stats.new_run_stats()
        self._abort = AbortCourse(scenario)
        self._view = FieldOfView(scenario, rig)
        self._bound = NavigationBound(scenario, rig, SETTLED_S)
        self._bench = BenchErrorSums(scenario, rig, SETTLED_S)
        is_held = scenario.chaser.planar and scenario.truth.relative_motion != "free"
        self._held_back = HeldBack(scenario) if is_held else None
        self._rails, self._gimbals = Squares(), Squares()
        self._lead_s = np.array([axis.lead_s for table in (rig.rails, rig.turntable) for axis in table.axes])
        self._latency = {name: ThinnedSample() for name in LATENCIES}
        self._lateness = ThinnedSample()
        self._late_wakeups = 0
        self._histogram: list[dict[str, Any]] = lateness_histogram(np.empty(0))
        self._times = {name: ThinnedSample() for name in NAMES}
        self._beyond = dict.fromkeys(NAMES, 0)
        self._waiting: list[np.ndarray] = []
        self._last: np.ndarray | None = None

    def add(self, rows: np.ndarray) -> None:
        """Add the next ``rows`` (n,) of CYCLE."""
        begin, waiting = 0, sum(map(len, self._waiting))
        while waiting + len(rows) - begin >= self._block:
            end = begin + self._block - waiting
            self._count(np.concatenate([*self._waiting, rows[begin:end]]) if waiting else rows[begin:end])
            self._waiting, waiting, begin = [], 0, end
            if self.pause_s:
                time.sleep(self.pause_s)
        self._waiting.append(rows[begin:].copy())

    def end(self) -> None:
        """Count the rows of the last block, which may be shorter."""
        if any(map(len, self._waiting)):
            self._count(np.concatenate(self._waiting))
        self._waiting = []

    def _count(self, rows: np.ndarray) -> None:
        """Count a block; what compares successive rows has the last row of the block before as well."""
        run_stats.count_rows(self._params, self.stats, rows.view(np.ndarray))
        joined = rows if self._last is None else np.concatenate([self._last, rows])
        self._abort.add(rows)
        self._view.add(rows)
        self._bound.add(rows)
        self._bench.add(joined)
        if self._held_back is not None:
            self._held_back.add_rows(rows)
        setpoint, feedback = joined["setpoint"][1:], joined["feedback"][1:]  # a row's setpoint is for its own time
        self._rails.add(setpoint["rail_m"] - feedback["rail_m"])
        self._gimbals.add(np.degrees(setpoint["gimbal_rad"] - feedback["gimbal_rad"]))
        self._add_times(rows, joined)
        self._last = rows[-1:].copy()

    def _add_times(self, rows: np.ndarray, joined: np.ndarray) -> None:
        step_s = self._scenario.step_s
        for name, values in measured(rows, joined, step_s, step_s / self._rig.ticks(step_s), self._lead_s).items():
            self._latency[name].add(values)
        lateness_s = rows["lateness_s"]
        self._lateness.add(lateness_s)
        self._late_wakeups += int(np.count_nonzero(lateness_s * 1e6 > self._rig.host.late_wakeup_us))
        for each, part in zip(self._histogram, lateness_histogram(lateness_s), strict=True):
            each["cycles"] += part["cycles"]
        times_s = execution_times_s(rows)
        for name, count in count_beyond(times_s, self._rig, step_s).items():
            self._times[name].add(times_s[name])
            self._beyond[name] += count

    def numbers(self) -> Tallied:
        """Return what the rows give."""
        self.end()
        scenario, stats, step_s = self._scenario, self.stats, self._scenario.step_s
        verdict = verdict_of(stats.ready, scenario.requirements)
        thrusters = thruster_numbers(stats, scenario)
        security = security_part(stats)
        security.abort = self._abort.course()
        times_s = {name: sample.values() for name, sample in self._times.items()}
        latency = {name: Percentiles(**percentiles(1e3 * sample.values())) for name, sample in self._latency.items()}
        results = RunResults(
            verdict=VerdictParts(
                control_precision=control_precision(verdict, scenario),
                security=security,
                energy=energy_part(stats, scenario, thrusters.propellant_kg, self._held_back),
                field_of_view=self._view.part(),
            ),
            navigation=NavigationResults(**navigation_numbers(stats.navigation), **self._bound.rows()),
            thrusters=thrusters,
            orbit={"body": scenario.orbit.body, "eclipse_s": step_s * float(stats.shadow_cycles)},
            bench=BenchResults(
                **self._rails.as_json("rail_error", "m"),
                **self._gimbals.as_json("gimbal_error", "deg"),
                **self._bench.rows(),
            ),
            latency=Latency(**latency),
            timing=Timing(
                cycles=int(stats.cycles),
                late_wakeups=self._late_wakeups,
                lateness_us=LatenessResults(**lateness_percentiles_us(self._lateness.values())),
                lateness_histogram=self._histogram,
                devices=judge_times(times_s, self._beyond, self._rig, step_s),
            ),
        )
        return results, stats, verdict
